"""Examples of all materials of the package, one for each elastic state, and the table of materials.

``table()`` is the table of MATERIALS.md; a test runs every example.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

from ngsolve import Trace

import ngvisco.physics.materials as laws
from ngvisco.physics.material import Material
from ngvisco.physics.tensors import dev, square
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    Variable,
)


@dataclass(frozen=True)
class Example:
    """A row of the table: a material, its energy as text, its convexity, and the paper's label, or None."""

    material: Material
    constructor: str
    energy: str
    convexity: str
    paper: str | None


@cache
def examples() -> tuple[Example, ...]:
    """One example of every material by each elastic state, in the paper's order; moduli are of order 1 to 10
    Pa."""
    return (
        Example(
            laws.LinearElastic(K_e=10.0, G_e=5.0),
            "LinearElastic",
            "3/2 K_e |sph E|² + G_e |dev E|²",
            "strong",
            "St.Venenat-Kirchhoff-linear",
        ),
        Example(
            laws.HardeningElastic(K_e=10.0, G_e=5.0, K_h=20.0, G_h=10.0, s=3.5),
            "HardeningElastic",
            "3/2 K_e |sph E|² + G_e |dev E|² + K_h/s |tr E|^s + 2G_h/s |dev E|^s",
            "strong",
            "rem-general-phi",
        ),
        Example(
            laws.IsotropicStrainEnergy(
                strain_energy=lambda E: 5 * Trace(E) * Trace(E) + 5 * square(dev(E)) * (1 + square(dev(E)))
            ),
            "IsotropicStrainEnergy",
            "the user's φ(E), isotropic",
            "the user's, sampled",
            "Euler-small-ass-phi",
        ),
        *_isotropic("F"),
        *_isotropic("B"),
        *(
            Example(
                laws.Gent(K_e=10.0, G_e=5.0, J_m=30.0, elastic_state=state),
                "Gent" + of,
                f"K_e/2 (J − 2 + 1/J) − G_e J_m ln(1 − ({stretch} − 3)/J_m)",
                "joint, strict in J",
                None,
            )
            for state, of, stretch in (("F", "", "|H|²"), ("B", '(elastic_state="B")', "tr B"))
        ),
        Example(
            laws.Ogden(K_e=10.0, mu=(10.0, 0.5, -0.5), alpha=(1.3, 4.0, -2.0)),
            "Ogden",
            "K_e/2 (J − 2 + 1/J) + Σ μ_p/α_p (Σ σ_i(H)^α_p − 3) + Σ μ_p/α_p (Σ σ_i(N)^(−α_p) − 3)",
            "joint, strict in J",
            None,
        ),
        Example(
            laws.Ogden(K_e=10.0, mu=(2.0, -2.0), alpha=(4.0, -4.0), elastic_state="B"),
            'Ogden(elastic_state="B")',
            "K_e/2 (J − 2 + 1/J) + Σ μ_p/α_p tr(B^(α_p/2) − I) + Σ μ_p/α_p tr(N^(−α_p/2) − I)",
            "joint, strict in J",
            None,
        ),
        Example(
            laws.OldroydB(K_e=10.0, G_e=5.0),
            "OldroydB",
            "K_e/2 (J − 2 + 1/J) + G_e (tr B − ln det B − 3)",
            "strict",
            None,
        ),
        Example(
            laws.FENEP(K_e=10.0, G_e=5.0, b=30.0),
            "FENEP",
            "K_e/2 (J − 2 + 1/J) − G_e ((b − 3) ln((b − tr B)/(b − 3)) + ln det B)",
            "strict",
            None,
        ),
        Example(
            laws.BarotropicFluid(B=10.0, gamma=1.4),
            "BarotropicFluid",
            "B J^(−γ); p = a ρ^γ, a = (γ − 1) B/ρ_R^γ",
            "strict",
            "rem-barotropic-fluids",
        ),
        Example(
            laws.BarotropicFluid(B=10.0, gamma=1.4, form="A"),
            'BarotropicFluid(form="A")',
            "B A^γ, A = 1/J = ρ/ρ_R",
            "strict",
            "rem-barotropic-fluids, DT-det-inverse",
        ),
        Example(
            laws.CustomMaterial(
                transported=(Distortion(), Cofactor("C"), Jacobian()),
                stored_energy=lambda F, C, J: 3 * square(F) + 2 * square(C) + 14 / J + 10 * (J - 1) * (J - 1),
            ),
            "CustomMaterial",
            "the user's φ of any variables",
            "the user's, sampled",
            "rem-behind-polyconvexity",
        ),
    )


_ISOTROPIC = (
    (
        laws.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        "",
        ("K_e/2 (J − 1 + ε/K_e)² + G_e J^(−2/3) |F|² − ε ln J", "joint"),
        ("K_e/2 (J − 1 + ε/K_e)² + G_e tr B − ε ln J", "joint, strict in J"),
        "neo-Hookean-potential-actual",
    ),
    (
        laws.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, kappa=2.0, J_min=0.2),
        "kappa=ϰ",
        ("K_e/2 (J − 1 + ϰε/K_e)² + G_e J^(−2/3) |F|² + ε/J^ϰ", "joint"),
        ("K_e/2 (J − 1 + ϰε/K_e)² + G_e tr B + ε/J^ϰ", "joint, strict in J"),
        "exa-polyconvex-general",
    ),
    (
        laws.MooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1),
        "",
        ("K_e/2 (J − 1 + ε/K_e)² + G_e J^(−2/3) |F|² + 2/(3√3) G_mr J^(−2) |Cof F|³ − ε ln J", "joint"),
        ("K_e/2 (J − 1 + ε/K_e)² + G_e tr B + 2/(3√3) G_mr (tr N)^(3/2) − ε ln J", "joint, strict in J"),
        "rem-polyconvex-general",
    ),
    (
        laws.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
        "",
        ("K_e/2 (J − 2 + 1/J) + G_e |H|²", "joint, strong in H"),
        ("K_e/2 (J − 2 + 1/J) + G_e tr B", "joint, strict in J"),
        "exa-neo-Hookean-ref",
    ),
    (
        laws.ReferentialNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, kappa=2.0, J_min=0.2),
        "epsilon=ε, kappa=ϰ",
        ("K_e/2 (J − 1 + ϰε/K_e)²/J + G_e |H|² + ε/J^(ϰ+1)", "joint, strong in H"),
        ("K_e/2 (J − 1 + ϰε/K_e)²/J + G_e tr B + ε/J^(ϰ+1)", "joint, strict in J"),
        "exa-neo-Hookean-ref",
    ),
    (
        laws.IsochoricNeoHookean(K_e=10.0, G_e=5.0),
        "",
        ("K_e/2 (J − 2 + 1/J) + G_e |H|²/J", "joint"),
        ("K_e/2 (J − 2 + 1/J) + G_e tr B", "joint, strict in J"),
        "exa-neo-Hookean-ref",
    ),
    (
        laws.LogarithmicNeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        "",
        ("K_e/2 (1/A − 2 + 2ε/K_e + (1 − ε/K_e)² A) + G_e |H|² − ε K", "joint, strong in H"),
        ("K_e/2 (1/A − 2 + 2ε/K_e + (1 − ε/K_e)² A) + G_e tr B − ε K", "joint, strict in A"),
        "exa-neo-Hookean-ref, DT-det-inverse",
    ),
    (
        laws.ReferentialMooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0),
        "",
        ("K_e/2 (J − 2 + 1/J) + G_e |H|² + G_mr |N|²", "joint, strong in (H, N)"),
        ("K_e/2 (J − 2 + 1/J) + G_e tr B + G_mr tr N", "joint, strict in J"),
        "exa-Mooney–Rivlin-ref",
    ),
    (
        laws.LogarithmicMooneyRivlin(K_e=10.0, G_e=3.0, G_mr=2.0, epsilon=0.1),
        "",
        ("K_e/2 (1/A − 2 + 2ε/K_e + (1 − ε/K_e)² A) + G_e |H|² + G_mr |N|² − ε K", "joint, strong in (H, N)"),
        ("K_e/2 (1/A − 2 + 2ε/K_e + (1 − ε/K_e)² A) + G_e tr B + G_mr tr N − ε K", "joint, strict in A"),
        "exa-Mooney–Rivlin-ref, DT-det-inverse",
    ),
)
"""Isotropic materials at finite strain: options of the constructor, then energy and convexity, by F and by
B."""


def _isotropic(elastic_state: Literal["F", "B"]) -> Iterator[Example]:
    """Examples of the isotropic materials at finite strain by F or by B = J^a F F^T."""
    for material, options, by_F, by_B, paper in _ISOTROPIC:
        words = [options] if options else []
        words += ['elastic_state="B"'] if elastic_state == "B" else []
        constructor = type(material).__name__ + (f"({', '.join(words)})" if words else "")
        energy, convexity = by_F if elastic_state == "F" else by_B
        yield Example(replace(material, elastic_state=elastic_state), constructor, energy, convexity, paper)


def table() -> str:
    """A Markdown table of all materials: variables, energy per actual volume, convexity, paper's label."""
    head = ("material", "variables", "φ(z), Pa", "convexity", "paper")
    rows = [head, *(("---",) * len(head),)]
    for example in examples():
        names = ", ".join(_describe(v) for v in example.material.variables)
        # a bar would end the cell
        energy = example.energy.replace("|", "\\|")
        label = f"`{example.paper}`" if example.paper else "—"
        rows.append((f"`{example.constructor}`", names, energy, example.convexity, label))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def _describe(variable: Variable) -> str:
    if isinstance(variable, Distortion) and variable.exponent:
        return f"{variable.name} = J^({_fraction(variable.exponent)}) F"
    if isinstance(variable, Cofactor):
        factor = f"J^({_fraction(variable.exponent)}) " if variable.exponent else ""
        return f"{variable.name} = {factor}Cof F"
    if isinstance(variable, (LeftCauchyGreen, CofactorLeftCauchyGreen)):
        factor = f"J^({_fraction(variable.exponent)}) " if variable.exponent else ""
        square = "F Fᵀ" if isinstance(variable, LeftCauchyGreen) else "Cof(F Fᵀ)"
        return f"{variable.name} = {factor}{square}"
    meaning = {"J": "det F", "A": "1/J", "K": "ln J / J"}.get(variable.name)
    return f"{variable.name} = {meaning}" if meaning else variable.name


def _fraction(exponent: float) -> str:
    numerator = round(6 * exponent)
    divisor = math.gcd(numerator, 6)
    return f"{'−' if numerator < 0 else ''}{abs(numerator) // divisor}/{6 // divisor}"

"""The two models of the manufactured solutions, with all the mechanisms asked for."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from ngsolve import CoefficientFunction, x

import ngvisco as nv
from ngvisco.physics.tensors import sqrt, square
from ngvisco.physics.variables import SmallStrain
from tests.verification.differences import Coefficients

KINDS = ("linear", "neo-hookean")
FURTHER = ("by B", "cofactors", "Yosida", "Yosida, quartic", "with heat", "two bodies")
"""Materials of other variables: B = F F^T, of which creep is another law, Cof F beside F and J, Yosida
approximations, of the neo-Hookean energy and of one of E that grows faster than its square, A and the
entropy, and the densities of two bodies that share every point."""
HEAT_CAPACITY, THETA_R, GRUNEISEN, CONDUCTIVITY = 1.5, 1.2, 0.8, 0.25
"""The conductivity is this times theta^1.5."""
DELTA, DELTA_FIELDS, EPSILON = 0.02, 0.03, 1.0
RULES: dict[str, tuple[Callable[..., nv.FlowRule], dict[str, float]]] = {
    "linear": (partial(nv.Creep, G_m=2.0, q=4.0), {"R": 0.5}),
    "Norton": (partial(nv.Norton, A=0.3, n=3.0, q=4.0), {"A": 0.3, "n": 3.0}),
    "Eyring": (partial(nv.Eyring, A=0.1, sigma_0=0.5, q=4.0), {"A": 0.1, "sigma": 0.5}),
    "Perzyna": (
        partial(nv.Perzyna, sigma_Y=0.5, G_m=2.0, n=2.0, q=4.0, rate_floor=1e-4),
        {"R": 0.5, "n": 2.0, "sigma": math.sqrt(2 / 3) * 0.5},
    ),
}
"""Flow rules but for nu, and their constants for the formulas in numpy."""


def material(kind: str) -> nv.Material:
    """The linearised model's or the finite-strain model's material."""
    if kind == "linear":
        return nv.LinearElastic(K_e=2.0, G_e=1.0)
    if kind == "cofactors":
        return nv.MooneyRivlin(K_e=2.0, G_e=0.6, G_mr=0.4, epsilon=0.5, elastic_state="F")
    if kind == "by B":
        return nv.NeoHookean(K_e=2.0, G_e=1.0, epsilon=0.5, elastic_state="B")
    if kind == "Yosida, quartic":
        return nv.Yosida(
            material=nv.CustomMaterial(transported=(SmallStrain(),), stored_energy=_quartic), eps=0.05
        )
    neo_hookean = nv.NeoHookean(K_e=2.0, G_e=1.0, epsilon=0.5, elastic_state="F")
    if kind == "with heat":
        return nv.Thermal(material=neo_hookean, c=HEAT_CAPACITY, theta_R=THETA_R, gruneisen=GRUNEISEN)
    return nv.Yosida(material=neo_hookean, eps=0.05) if kind == "Yosida" else neo_hookean


def _quartic(E: CoefficientFunction) -> CoefficientFunction:
    """E : E + (E : E)^2, Pa."""
    return square(E) + square(E) * square(E)


def hyperviscosity(p: float | None) -> nv.HyperViscosity | None:
    """Of about the size of the Stokes viscosity on these fields."""
    return None if p is None else nv.HyperViscosity(mu=1e-2 if p == 2 else 1e-3, p=p)


def bodies() -> tuple[nv.Body, ...]:
    """Two of other shear modulus, viscosity, creep and density."""
    return (
        nv.Body(
            name="one",
            where=0.5 - x,
            material=nv.ReferentialNeoHookean(K_e=2.0, G_e=1.0),
            viscosity=nv.StokesViscosity(K_v=0.3, G_v=0.2),
            creep=nv.Creep(G_m=2.0),
            density=1.5,
        ),
        nv.Body(
            name="two",
            material=nv.ReferentialNeoHookean(K_e=2.0, G_e=0.4),
            viscosity=nv.StokesViscosity(K_v=0.2, G_v=0.3),
            creep=nv.Creep(G_m=1.0),
            density=1.0,
        ),
    )


def model(
    kind: str,
    dim: int,
    p: float | None,
    regularised: bool = False,
    delta: bool = True,
    nu: float = 0.0,
    rule: str = "linear",
) -> nv.Model:
    """Creep, gravity, viscosity, hyperviscosity with exponent p unless None, delta- and epsilon-terms.

    With nu > 0 creep, by one of ``RULES``, has its gradient term (q = 4), and its rate is a field of its
    own.  With heat there is conduction.
    """
    law = nv.Regularisation(
        delta_density=DELTA if delta else 0.0, delta_fields=DELTA_FIELDS if delta else 0.0, epsilon=EPSILON
    )
    own: dict[str, Any] = {"bodies": bodies()}
    if kind != "two bodies":
        viscosity, creep = nv.StokesViscosity(K_v=0.3, G_v=0.2), RULES[rule][0](nu=nu)
        own = {"material": material(kind), "viscosity": viscosity, "creep": creep}
    return nv.Model(
        **own,
        hyperviscosity=hyperviscosity(p),
        loads=(nv.Gravity((0.0, -0.7, 0.0)[:dim]),),
        regularisation=law if regularised else None,
        heat=nv.Heat(conductivity=_conductivity) if kind == "with heat" else None,
    )


def _conductivity(theta: CoefficientFunction) -> CoefficientFunction:
    return CONDUCTIVITY * theta * sqrt(theta)


def coefficients(
    kind: str, p: float | None, regularised: bool = False, nu: float = 0.0, rule: str = "linear"
) -> Coefficients:
    """The same constants once more, for the formulas in numpy."""
    return Coefficients(
        K_e=2.0,
        G_e=1.0,
        epsilon=0.0 if kind == "linear" else 0.5,
        K_v=0.3,
        G_v=0.2,
        mu=0.0 if p is None else (1e-2 if p == 2 else 1e-3),
        p=2.0 if p is None else p,
        rule=rule,
        **RULES[rule][1],
        nu=nu,
        g=-0.7,
        delta=DELTA if regularised else 0.0,
        delta_fields=DELTA_FIELDS if regularised else 0.0,
        damping=EPSILON if regularised else 0.0,
        c=HEAT_CAPACITY,
        theta_R=THETA_R,
        Gamma=GRUNEISEN,
        kappa=CONDUCTIVITY,
    )

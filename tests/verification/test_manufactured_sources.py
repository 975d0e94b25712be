"""The sources against finite differences of the exact fields in plain numpy, at random points."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ngvisco.geometries import box
from tests.verification.convergence import KINDS, coefficients, model
from tests.verification.differences import FiniteDifferences, mismatch
from tests.verification.manufactured import Sources

T, TAU, TOLERANCE = 0.3, 0.05, 1e-6
CI = (pytest.mark.long, pytest.mark.ci)
TERMS: dict[str, dict[str, Any]] = {
    "Stokes": {"p": None},
    "hyperviscous": {"p": 2.0},
    "all": {"p": 4.0, "regularised": True},
    "with nu": {"p": 4.0, "regularised": True, "nu": 0.1},
}


def found(kind: str, dim: int, terms: str, factor: float = 1.0, *names: str) -> dict[str, float]:
    """The mismatch, with ``factor`` on some coefficients of the differences.  With heat there are no
    delta-terms, since the sources do not count their dissipation as heat."""
    known = coefficients(kind, **TERMS[terms])
    known = replace(known, **{name: factor * getattr(known, name) for name in names})
    if is_warm := kind == "with heat":
        known = replace(known, delta=0.0, delta_fields=0.0)
    sources = Sources(model(kind, dim, **TERMS[terms], delta=not is_warm), dim, TAU)
    return mismatch(known, sources, kind, T, box((1,) * dim, 1.0))


@pytest.mark.parametrize(
    ("kind", "dim", "terms"),
    [
        *((kind, 2, terms) for kind in KINDS for terms in TERMS),
        ("neo-hookean", 3, "all"),
        *(
            pytest.param(kind, 3, terms, marks=CI)
            for kind in KINDS
            for terms in TERMS
            if (kind, terms) != ("neo-hookean", "all")
        ),
        ("with heat", 2, "all"),
        pytest.param("with heat", 3, "all", marks=CI),
    ],
)
def test_sources_are_the_residuals_of_the_strong_equations(kind: str, dim: int, terms: str) -> None:
    errors = found(kind, dim, terms)
    assert ("Pi" in errors, "s" in errors) == (terms == "with nu", kind == "with heat")
    assert max(errors.values()) <= TOLERANCE, errors


@pytest.mark.parametrize(
    ("kind", "terms", "names", "equations"),
    [
        *(
            ("neo-hookean", "all", name, "momentum")
            for name in ("K_e", "epsilon", "K_v", "G_v", "mu", "p", "g")
        ),
        ("neo-hookean", "all", "G_e", "momentum F"),
        ("neo-hookean", "all", "R", "F"),
        ("neo-hookean", "all", "delta", "continuity momentum"),
        ("neo-hookean", "all", "delta_fields", "F J"),
        ("neo-hookean", "all", "damping", "momentum"),
        *(
            ("with heat", "all", name, "momentum s")
            for name in ("c", "theta_R", "Gamma", "K_v", "mu", "damping")
        ),
        ("with heat", "all", "kappa", "s"),
        ("with heat", "all", "R", "F s"),
        *((kind, "with nu", name, "Pi") for kind in KINDS for name in ("nu", "R")),
        ("neo-hookean", "with nu", "G_e", "momentum Pi"),
        ("linear", "with nu", "G_e", "momentum Pi"),
    ],
)
def test_the_check_of_sources_finds_a_coefficient_that_is_one_per_cent_off(
    kind: str, terms: str, names: str, equations: str
) -> None:
    """Negative control: the check must fail in the equations that contain the coefficient."""
    # these terms are a small part of the momentum equation
    errors = found(kind, 2, terms, 1.2 if names in ("delta", "damping") else 1.01, names)
    assert [name for name, error in errors.items() if error > 10 * TOLERANCE] == equations.split(), errors


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_exact_fields_meet_the_natural_conditions_of_the_walls(kind: str, dim: int) -> None:
    """Conditions: v.n = 0; no tangential part of (T + D eps - div S) n; hess v : (n x n) = 0."""
    fields = FiniteDifferences(kind, coefficients(kind, 4.0), dim, T, TAU)
    for axis in range(dim):
        X = np.random.default_rng(axis).uniform(0.1, 0.9, (8, dim))
        X[:, axis] = np.arange(8) % 2
        traction = (fields.stress(X) + fields.viscous_stress(X))[..., :dim, axis]
        S = fields.hyperstress(X)
        div_S = fields.div(fields.hyperstress)(X)[..., axis]
        for i in set(range(dim)) - {axis}:
            assert abs(traction[:, i]).max() <= 1e-8
            assert abs(div_S[:, i]).max() <= 1e-5
            assert abs(S[:, i, :, axis]).max() <= 1e-6
        assert abs(fields.now["v"](X)[:, axis]).max() <= 1e-14
        assert abs(S[:, :, axis, axis]).max() <= 1e-6

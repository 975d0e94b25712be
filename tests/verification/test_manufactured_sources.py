"""The sources against finite differences of the exact fields in plain numpy, at random points."""

from dataclasses import replace

import numpy as np
import pytest

from ngvisco.geometries import box
from tests.verification.differences import FiniteDifferences, difference, mismatch
from tests.verification.models import KINDS, coefficients, model
from tests.verification.sources import Sources

T, TAU = 0.3, 0.05
TOLERANCE = 1e-6


ALL_TERMS = (4.0, True)


@pytest.mark.parametrize(
    ("kind", "dim", "p", "regularised"),
    [
        pytest.param(kind, dim, *terms, marks=marks)
        for kind in KINDS
        for dim in (2, 3)
        for terms in ((None, False), (2.0, False), ALL_TERMS)
        for marks in ([] if dim == 2 or terms == ALL_TERMS else [pytest.mark.long, pytest.mark.ci],)
    ],
)
def test_sources_are_the_residuals_of_the_strong_equations(
    kind: str, dim: int, p: float | None, regularised: bool
) -> None:
    mesh, sources = box((1,) * dim, 1.0), Sources(model(kind, dim, p, regularised), dim, TAU)
    found = mismatch(coefficients(kind, p, regularised), sources, kind, T, mesh)
    assert max(found.values()) <= TOLERANCE, found


@pytest.mark.parametrize(
    ("name", "equations"),
    [
        ("K_e", ["momentum"]),
        ("G_e", ["momentum", "F"]),
        ("epsilon", ["momentum"]),
        ("K_v", ["momentum"]),
        ("G_v", ["momentum"]),
        ("mu", ["momentum"]),
        ("p", ["momentum"]),
        ("R", ["F"]),
        ("g", ["momentum"]),
        ("delta", ["continuity", "momentum"]),
        ("delta_fields", ["F", "J"]),
        ("damping", ["momentum"]),
    ],
)
def test_check_of_the_sources_sees_a_coefficient_that_is_one_per_cent_off(
    name: str, equations: list[str]
) -> None:
    """Negative control: the check above must fail in the equations that contain the coefficient."""
    kind, dim, p = "neo-hookean", 2, 4.0
    right = coefficients(kind, p, regularised=True)
    # these are a small part of the momentum equation
    factor = 1.2 if name in ("delta", "damping") else 1.01
    wrong = replace(right, **{name: factor * getattr(right, name)})
    mesh, sources = box((1, 1), 1.0), Sources(model(kind, dim, p, regularised=True), dim, TAU)
    found = mismatch(wrong, sources, kind, T, mesh)
    for equation, error in found.items():
        assert (error > 10 * TOLERANCE) == (equation in equations), found


def with_heat(dim: int, **changed: float) -> dict[str, float]:
    """The mismatch of all terms but the delta ones, whose dissipation the sources do not have as heat."""
    right = coefficients("with heat", 4.0, regularised=True)
    known = replace(right, delta=0.0, delta_fields=0.0, **changed)
    sources = Sources(model("with heat", dim, 4.0, regularised=True, delta=False), dim, TAU)
    return mismatch(known, sources, "with heat", T, box((1,) * dim, 1.0))


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=[pytest.mark.long, pytest.mark.ci])])
def test_sources_of_heat_are_the_residuals_of_the_strong_equations(dim: int) -> None:
    found = with_heat(dim)
    assert "s" in found and max(found.values()) <= TOLERANCE, found


@pytest.mark.parametrize(
    ("name", "equations"),
    [
        ("c", ["momentum", "s"]),
        ("theta_R", ["momentum", "s"]),
        ("Gamma", ["momentum", "s"]),
        ("kappa", ["s"]),
        ("K_v", ["momentum", "s"]),
        ("mu", ["momentum", "s"]),
        ("R", ["F", "s"]),
        ("damping", ["momentum", "s"]),
    ],
)
def test_check_of_heat_sees_a_coefficient_that_is_one_per_cent_off(name: str, equations: list[str]) -> None:
    right = coefficients("with heat", 4.0, regularised=True)
    found = with_heat(2, **{name: (1.2 if name == "damping" else 1.01) * getattr(right, name)})
    for equation, error in found.items():
        assert (error > 10 * TOLERANCE) == (equation in equations), found


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_exact_fields_meet_the_natural_conditions_of_the_walls(kind: str, dim: int) -> None:
    """v.n = 0; no tangential part of (T + D eps - div S) n; hess v : (n x n) = 0."""
    fields = FiniteDifferences(kind, coefficients(kind, 4.0), dim, T, TAU)
    for axis in range(dim):
        X = np.random.default_rng(axis).uniform(0.1, 0.9, (8, dim))
        X[:, axis] = np.arange(8) % 2
        traction = (fields.stress(X) + fields.viscous_stress(X))[..., :dim, axis]
        S = fields.hyperstress(X)
        div_S = sum(difference(fields.hyperstress, k)(X)[..., k] for k in range(dim))[..., axis]
        for i in range(dim):
            if i != axis:
                assert abs(traction[:, i]).max() <= 1e-8
                assert abs(div_S[:, i]).max() <= 1e-5
                assert abs(S[:, i, :, axis]).max() <= 1e-6
        assert abs(fields.vector(T)(X)[:, axis]).max() <= 1e-14
        assert abs(S[:, :, axis, axis]).max() <= 1e-6

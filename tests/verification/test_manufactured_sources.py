"""The sources against finite differences of the exact fields in plain numpy, at random points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cases import KINDS, coefficients, model
from manufactured import Coefficients, FiniteDifferences, Sources, at_points, difference
from ngsolve import Mesh

from ngvisco import time
from ngvisco.geometries import box
from ngvisco.physics.material import tensors_of

T, TAU = 0.3, 0.05
TOLERANCE = 1e-6


def mismatch(
    kind: str, dim: int, p: float | None, c: Coefficients, sources: Sources, mesh: Mesh
) -> dict[str, float]:
    """Largest difference of each equation's source, relative to its largest value."""
    X = np.random.default_rng(7).uniform(0.1, 0.9, (8, dim))
    time.Set(T)
    independent = FiniteDifferences(kind, c, dim, T, TAU)
    expected = {
        "continuity": independent.continuity(X),
        "momentum": independent.momentum(X),
        **independent.kinematics(X),
    }
    rates = tensors_of(sources.model.material, sources.kinematics, dim)
    given = {"continuity": sources.continuity, "momentum": sources.momentum, **rates}
    result = {}
    for name, values in expected.items():
        found = at_points(given[name], mesh, X).reshape(values.shape)
        result[name] = float(abs(found - values).max() / abs(values).max())
    return result


@pytest.mark.parametrize("p", [None, 2.0, 4.0])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_sources_are_the_residuals_of_the_strong_equations(kind: str, dim: int, p: float | None) -> None:
    mesh, sources = box((1,) * dim, 1.0), Sources(model(kind, dim, p), dim, TAU)
    found = mismatch(kind, dim, p, coefficients(kind, p), sources, mesh)
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
    ],
)
def test_check_of_the_sources_sees_a_coefficient_that_is_one_per_cent_off(
    name: str, equations: list[str]
) -> None:
    """Negative control: the check above must fail in the equations that contain the coefficient."""
    kind, dim, p = "neo-hookean", 2, 4.0
    right = coefficients(kind, p)
    wrong = replace(right, **{name: 1.01 * getattr(right, name)})
    mesh, sources = box((1, 1), 1.0), Sources(model(kind, dim, p), dim, TAU)
    found = mismatch(kind, dim, p, wrong, sources, mesh)
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

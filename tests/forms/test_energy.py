"""An energy whose values at quadrature points are stored: the residual and its Jacobian."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support import (
    NEO_HOOKEAN,
    Case,
    central_difference,
    jacobian_times,
    random_direction,
    randomise,
    residual,
    small_box,
    uncondensed,
)

import ngvisco as nv
from ngvisco.forms.system import Step

EPS = 0.05
REFERENTIAL = nv.ReferentialMooneyRivlin(K_e=3.0, G_e=1.3, G_mr=0.7)


@cache
def step_with(dim: int, material: nv.Material, k: int = 2, m: int = 1) -> Step:
    step = Step(small_box(dim), replace(Case(dim=dim).model, material=material), nv.Discretisation(k=k, m=m))
    step.context.tau.Set(0.3)
    step.context.set_loads(0.2, 0.3)
    step.context.curvature.Set(0.2)
    return step


def mismatch(step: Step, *, refreshed: bool = True) -> float:
    """Largest error of the Jacobian times a direction, against differences of the residual. The energies at
    points are updated before each residual."""
    randomise(step, 3)
    if refreshed:
        step.local_unknowns.update_stored()
    form, direction = uncondensed(step), random_direction(step, 103)
    base = step.state.vec.CreateVector()
    base.data = step.state.vec
    assembled = jacobian_times(form, step.state.vec, direction)

    def shifted(s: float) -> np.ndarray:
        step.state.vec.data = base + s * direction
        step.local_unknowns.update_stored()
        return residual(form, step.state.vec)

    # the increment is smaller than the distance to the kinks of |v . n|
    difference = central_difference(shifted, 1e-6)
    step.state.vec.data = base
    return float(np.abs(assembled - difference).max() / np.abs(difference).max())


@pytest.mark.parametrize(
    ("dim", "material", "k", "m"),
    [
        (2, NEO_HOOKEAN, 2, 1),
        (2, REFERENTIAL, 3, 2),  # the degree of the energy's rule is odd, and is not rounded up
        (3, NEO_HOOKEAN, 2, 0),
        (3, NEO_HOOKEAN, 2, 1),
    ],
    ids=["2d", "2d-k3-m2", "3d-m0", "3d"],
)
def test_the_jacobian_equals_differences_of_the_residual_with_updated_energies(dim, material, k, m) -> None:
    assert mismatch(step_with(dim, nv.Yosida(material=material, eps=EPS), k, m)) < 1e-8

"""A stored energy that is kept at the quadrature points, in the residual and in its Jacobian."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from ngsolve import CF
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
from ngvisco.forms.terms.transport import Kinematics

EPS = 0.05
REFERENTIAL = nv.ReferentialMooneyRivlin(K_e=3.0, G_e=1.3, G_mr=0.7)


@cache
def step_with(dim: int, material: nv.Material, k: int = 2, m: int = 1) -> Step:
    step = Step(small_box(dim), replace(Case(dim=dim).model, material=material), nv.Discretisation(k=k, m=m))
    step.context.tau.Set(0.3)
    step.context.set_loads(0.2, 0.3)
    step.context.eta.Set(0.3)
    step.context.curvature.Set(0.2)
    return step


def mismatch(step: Step, *, refreshed: bool = True) -> float:
    """Largest error of Jacobian times direction, against differences of the refreshed residual."""
    randomise(step, 3)
    if refreshed:
        step.eliminate.refresh()
    form, direction = uncondensed(step), random_direction(step, 103)
    base = step.state.vec.CreateVector()
    base.data = step.state.vec
    assembled = jacobian_times(form, step.state.vec, direction)

    def shifted(s: float) -> np.ndarray:
        step.state.vec.data = base + s * direction
        step.eliminate.refresh()
        return residual(form, step.state.vec)

    difference = central_difference(shifted, 1e-3)
    step.state.vec.data = base
    return float(np.abs(assembled - difference).max() / np.abs(difference).max())


@pytest.mark.parametrize(
    ("dim", "material", "k", "m"),
    [
        (2, NEO_HOOKEAN, 2, 1),
        (2, REFERENTIAL, 3, 2),  # of an odd degree without rounding up
        (3, NEO_HOOKEAN, 2, 0),
        (3, NEO_HOOKEAN, 2, 1),
    ],
    ids=["2d", "2d-k3-m2", "3d-m0", "3d"],
)
def test_jacobian_is_the_difference_of_the_refreshed_residual(dim, material, k, m) -> None:
    assert mismatch(step_with(dim, nv.Yosida(material=material, eps=EPS), k, m)) < 1e-8


def test_a_jacobian_of_another_state_is_seen() -> None:
    """Negative control: without a refresh the kept derivative belongs to the last state."""
    step = step_with(2, nv.Yosida(material=NEO_HOOKEAN, eps=EPS))
    randomise(step, 4)
    step.eliminate.refresh()
    assert mismatch(step, refreshed=False) > 1e-4


def test_residual_is_that_of_the_closed_form() -> None:
    """LinearElastic becomes LinearElastic with softer moduli; also density, projection and old energy."""
    linear = nv.LinearElastic(K_e=3.0, G_e=1.3)
    softer = nv.LinearElastic(K_e=3 / (1 + 9 * EPS), G_e=1.3 / (1 + 2.6 * EPS))
    step, closed = step_with(2, nv.Yosida(material=linear, eps=EPS)), step_with(2, softer)
    found = []
    for one in (step, closed):
        randomise(one, 7)
        one.eliminate()
        row = [residual(uncondensed(one), one.state.vec)]
        u, old, rule = one.now, one.context.old, one.quadrature
        one.energy.follow(old)
        one.energy.refresh(old)
        row.append(rule.integrate_cells(CF((one.energy.density(u), one.energy.density(old)))))
        row.append(rule.integrate_cells(one.energy.anywhere(u)))
        (bregman,) = (t.distance(old, u) for t in one.terms if isinstance(t, Kinematics))
        row.append(rule.integrate_cells(bregman.integrand.cells))
        found.append(row)
    for mine, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-11, atol=1e-12)


def test_refresh_follows_the_state_and_only_the_state() -> None:
    step = step_with(2, nv.Yosida(material=NEO_HOOKEAN, eps=EPS))
    randomise(step, 10)
    calls = []
    respond = step.energy.response
    step.energy.response = lambda z: calls.append(len(z)) or respond(z)
    now = step.energy._values[step.now]
    try:
        randomise(step, 11)
        step.eliminate.refresh()
        first = now.slope.vec.FV().NumPy().copy()
        assert len(calls) == 1
        step.eliminate.refresh()
        assert len(calls) == 1
        randomise(step, 12)
        step.eliminate.refresh()
        assert len(calls) == 2 and not np.array_equal(first, now.slope.vec.FV().NumPy())
        randomise(step, 11)
        step.eliminate.refresh()
        assert np.array_equal(first, now.slope.vec.FV().NumPy())  # bit for bit
        step.state_old.vec.data = step.state.vec
        step.energy.follow(step.old)
        step.energy.refresh(step.old)
        assert len(calls) == 3  # the old energy is the new one's
        old = step.energy._values[step.old]
        assert np.array_equal(old.energy.vec.FV().NumPy(), now.energy.vec.FV().NumPy())
        assert np.array_equal(old.slope.vec.FV().NumPy(), now.slope.vec.FV().NumPy())
    finally:
        step.energy.response = respond

"""Tableaux: orders, the affine combinations behind a step, the remainder on a scalar problem, refusals."""

import math

import numpy as np
import pytest

from ngvisco.timestepping.scheme import SCHEMES, TimeScheme, scheme_of

ALL = [scheme_of(name, 0.7 if name == "theta" else None) for name in SCHEMES]
CROUZEIX = (3 + math.sqrt(3)) / 6
THIRD = TimeScheme("crouzeix", ((CROUZEIX, 0.0), (1 - 2 * CROUZEIX, CROUZEIX)), (0.5, 0.5))
"""Crouzeix' two-stage scheme of order three, an example of a user's tableau."""


def taken(scheme, f, u, tau, newton):
    """One step of u' = f(u) by Rothe steps, in the form of the module's docstring, with all stages."""
    states = [u]
    for i in range(scheme.stages):
        start = scheme.starts[i][: i + 1] @ np.array(states)
        states.append(newton(f, start, scheme.A[i][i] * tau))
    return scheme.end @ np.array(states), states


@pytest.mark.parametrize("scheme", [*ALL, THIRD], ids=str)
def test_stages_take_the_whole_impulse_of_a_load(scheme):
    """A scheme with one stage takes the plain mean of a load over the step. For a load linear in time, a
    scheme of order 2 takes the value at the time of the stage."""
    tilts = np.array(scheme.tilts)
    assert abs(tilts @ scheme.b) <= 1e-15
    assert scheme.stages > 1 or tilts == 0
    if scheme.order > 1:
        assert tilts == pytest.approx(np.array(scheme.c) - 0.5, abs=1e-15)


def solve(f, start, s):
    """Solve U = start + s f(U) for a scalar U, by the secant method."""
    u = start
    for _ in range(200):
        u = start + s * f(u)
    return u


@pytest.mark.parametrize(
    ("scheme", "order"), [*zip(ALL, (1, 2, 1, 2), strict=True), (THIRD, 3)], ids=lambda v: str(v)
)
def test_the_stated_order_is_the_order_of_the_tableau_and_of_runs(scheme, order):
    """The equation u' = -u^2, u(0) = 1 has the solution u(t) = 1/(1 + t)."""
    assert scheme.order == order
    errors = []
    for steps in (8, 16, 32):
        u = 1.0
        for _ in range(steps):
            u, _ = taken(scheme, lambda v: -v * v, u, 0.4 / steps, solve)
        errors.append(abs(u - 1 / 1.4))
    assert math.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.1)

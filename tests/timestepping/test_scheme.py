"""Tableaux: orders, the affine combinations behind a step, the remainder on a scalar problem, refusals."""

import math

import numpy as np
import pytest

import ngvisco as nv
from ngvisco.timestepping.scheme import SCHEMES, TimeScheme, scheme_of

ALL = [scheme_of(name, 0.7 if name == "theta" else None) for name in SCHEMES]
CROUZEIX = (3 + math.sqrt(3)) / 6
THIRD = TimeScheme("crouzeix", ((CROUZEIX, 0.0), (1 - 2 * CROUZEIX, CROUZEIX)), (0.5, 0.5))
"""Crouzeix' two-stage scheme of order three, as one that a user might give."""

by_scheme = pytest.mark.parametrize("scheme", [*ALL, THIRD], ids=str)


def taken(scheme, f, u, tau, newton):
    """One step of u' = f(u) by Rothe steps, in the form of the module's docstring; all stages too."""
    states = [u]
    for i in range(scheme.stages):
        start = scheme.starts[i][: i + 1] @ np.array(states)
        states.append(newton(f, start, scheme.A[i][i] * tau))
    return scheme.end @ np.array(states), states


def solve(f, start, s):
    """U = start + s f(U) of scalars, by the secant's limit."""
    u = start
    for _ in range(200):
        u = start + s * f(u)
    return u


@pytest.mark.parametrize(
    ("scheme", "order"), [*zip(ALL, (1, 2, 1, 2), strict=True), (THIRD, 3)], ids=lambda v: str(v)
)
def test_order_is_that_of_the_tableau_and_of_runs(scheme, order):
    """u' = -u^2, u(0) = 1, u(t) = 1/(1 + t)."""
    assert scheme.order == order
    errors = []
    for steps in (8, 16, 32):
        u = 1.0
        for _ in range(steps):
            u, _ = taken(scheme, lambda v: -v * v, u, 0.4 / steps, solve)
        errors.append(abs(u - 1 / 1.4))
    assert math.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.1)


@by_scheme
def test_error_constant_is_that_of_a_short_step(scheme):
    tau, p = 0.01, scheme.order
    u, _ = taken(scheme, lambda v: -v, 1.0, tau, solve)
    exact = math.exp(-tau)
    found = (u - exact) / (tau ** (p + 1) * (-1) ** (p + 1))
    assert found == pytest.approx(scheme.error_constant, rel=0.1)


@by_scheme
def test_remainder_closes_the_identity_of_a_convex_energy(scheme):
    """E(u) = u^4/4 + u^2/2, u' = -E'(u): E_1 - E_0 + tau sum b_i |f_i|^2 + R = 0, R by distances alone."""
    tau = 0.3

    def energy(u):
        return u**4 / 4 + u**2 / 2

    def slope(u):
        return u**3 + u

    def distance(a, b):
        return energy(a) - energy(b) - slope(b) * (a - b)

    end, states = taken(scheme, lambda u: -slope(u), 0.9, tau, solve)
    dissipated = tau * sum(b * slope(U) ** 2 for b, U in zip(scheme.b, states[1:], strict=True))
    remainder = sum(
        weight * distance(states[k], states[i + 1])
        for i, row in enumerate(scheme.distances)
        for k, weight in enumerate(row)
        if weight
    )
    if not scheme.ends_at_last_stage:
        remainder -= distance(end, states[-1])
    assert energy(end) - energy(0.9) + dissipated + remainder == pytest.approx(0, abs=1e-15)
    assert abs(remainder) > 1e-6  # it is needed


def test_schemes_are_what_their_names_say():
    by_name = {scheme.name: scheme for scheme in ALL}
    assert by_name["backward-euler"].ends_at_last_stage and by_name["sdirk2"].ends_at_last_stage
    assert not by_name["midpoint"].ends_at_last_stage
    growth = {name: _growth(scheme, -1e8) for name, scheme in by_name.items()}
    assert growth["backward-euler"] == pytest.approx(0, abs=1e-7)
    assert growth["sdirk2"] == pytest.approx(0, abs=1e-7)  # L-stable
    assert growth["midpoint"] == pytest.approx(-1, abs=1e-7)  # reflects
    assert growth["theta"] == pytest.approx(1 - 1 / 0.7, abs=1e-7)


def _growth(scheme, z):
    s = scheme.stages
    return 1 + z * np.array(scheme.b) @ np.linalg.solve(np.eye(s) - z * np.array(scheme.A), np.ones(s))


@pytest.mark.parametrize(
    ("A", "b", "field"),
    [
        (((0.0,),), (1.0,), "A"),
        (((1.0,),), (0.9,), "b"),
        (((0.5, 0.5), (0.0, 0.5)), (0.5, 0.5), "A"),
        (((1.0,),), (0.5, 0.5), "A"),
        ((), (), "A"),
        (((float("nan"),),), (1.0,), "A"),
    ],
)
def test_a_tableau_that_is_none_is_refused(A, b, field):
    with pytest.raises(nv.ParameterError, match=f"TimeScheme.{field}"):
        TimeScheme("mine", A, b)


@pytest.mark.parametrize("theta", [0.49, 1.01, -1, math.nan, "half", True, None])
def test_a_theta_outside_its_range_is_refused(theta):
    with pytest.raises(nv.ParameterError, match="theta"):
        scheme_of("theta", theta)


def test_an_unknown_scheme_and_a_theta_without_use_are_refused():
    with pytest.raises(nv.UnknownNameError, match=r"unknown time scheme 'midpont'; did you mean 'midpoint'"):
        scheme_of("midpont")
    with pytest.raises(nv.ParameterError, match="it belongs to 'theta'"):
        scheme_of("midpoint", 0.5)
    with pytest.raises(nv.ParameterError, match="it belongs to"):
        scheme_of(THIRD, 0.5)
    with pytest.raises(nv.ParameterError, match="a TimeScheme"):
        scheme_of(2)


@pytest.mark.parametrize(
    ("name", "A", "b", "field"),
    [
        (3, ((0.5,),), (1.0,), "name"),
        ("mine", 3, (1.0,), "A"),
        ("mine", (0.5,), (1.0,), "A"),
        ("mine", ((0.5,),), 2, "b"),
        ("mine", ((0.5,),), ("a",), "b"),
    ],
)
def test_what_is_no_tableau_at_all_is_named(name, A, b, field):
    with pytest.raises(nv.ParameterError, match=rf"TimeScheme\.{field} "):
        TimeScheme(name, A, b)

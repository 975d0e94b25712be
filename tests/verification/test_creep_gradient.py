"""Creep with nu > 0: its manufactured source, an independent creep rate on a disc, and that reference."""

import numpy as np
import pytest
from ngsolve import CF, x, y
from scipy.special import jn_zeros, jv, spherical_jn

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import VerificationError, collected
from tests.verification.cases.manufactured import independent
from tests.verification.radial_creep import RadialCreep

T, TAU = 0.3, 0.05


def test_creep_rate_on_a_disc_is_that_of_the_radial_problem():
    values = collected(independent(2, (0.5, 0.25))).values
    assert values["relative L2 error of Pi on the finest mesh"] < 6e-3
    assert values["rate of Pi"] > 1.7
    assert values["relative L2 distance of M/G_m from the reference"] > 0.2


def test_radial_reference_has_the_closed_forms_of_the_linear_problem():
    """q = 2: an eigenfunction of the Laplacian with zero slope at the wall is divided by G_m + nu k^2."""
    k = jn_zeros(1, 1)[0]
    r, a = RadialCreep(2, 1.0, 2.0, 0.3, 2.0, lambda s: jv(0, k * s)).solve(2000)
    assert a == pytest.approx(jv(0, k * r) / (2.0 + 0.3 * k * k), abs=1e-6)
    k = 4.493409457909064  # tan k = k
    r, a = RadialCreep(3, 1.0, 2.0, 0.3, 2.0, lambda s: spherical_jn(0, k * s)).solve(2000)
    assert a == pytest.approx(spherical_jn(0, k * r) / (2.0 + 0.3 * k * k), abs=1e-6)


def test_radial_reference_satisfies_the_nonlinear_equation():
    """The flux through a ball of radius r is what G_m a - m leaves inside of it."""

    def driving(s):
        return np.cos(2 * s)

    r, a = RadialCreep(3, 1.0, 1.0, 0.5, 4.0, driving).solve(4000)
    middle, slope = 0.5 * (r[1:] + r[:-1]), np.diff(a) / np.diff(r)
    flux = middle**2 * 0.5 * np.abs(slope) ** 2 * slope
    density = (0.5 * (a[1:] + a[:-1]) - driving(middle)) * middle**2
    inside = np.cumsum(density * np.diff(r)) - 0.5 * density * np.diff(r)
    assert flux == pytest.approx(inside, abs=1e-6) and np.abs(inside).max() > 0.02


def test_radial_reference_says_where_it_has_no_end():
    with pytest.raises(VerificationError, match="has not converged"):
        RadialCreep(2, 1.0, 1.0, 0.5, 4.0, lambda s: np.nan * s).solve(10)


@pytest.mark.parametrize("tau", [1e-10, 1e-8, 1e-2])
def test_both_solvers_find_the_creep_rate_in_short_and_in_long_steps(tau):
    """In a step of 1e-8 s the strain hardly sees Pi: where that alone is measured, Pi is 4 % off."""
    rates = []
    for solver in ("coupled", "split"):
        strain = (0.5 - x * x - y * y) * CF((1.0, 0.5, 0.0, 0.5, -0.4, 0.0, 0.0, 0.0, -0.6))
        run = nv.Simulation(
            box((1, 1), maxh=0.4),
            nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0), creep=nv.Creep(G_m=2.0, nu=0.3, q=4.0)),
            dt=tau,
            initial=nv.Initial(values={"E": CF(strain, dims=(3, 3))}),
            solver=solver,
        )
        run.advance()
        state, where = run.rothe_step.state.vec.FV().NumPy(), run.rothe_step.layout.ranges["Pi"]
        rates.append(state[where].copy())
    assert np.linalg.norm(rates[0] - rates[1]) <= 1e-5 * np.linalg.norm(rates[0])

"""Tests of runs in other units, and of a case's theory in its known limits."""

import numpy as np
import pytest
from ngsolve import x
from scipy.special import jn_zeros, jv, spherical_jn

from ngvisco import (
    Creep,
    Gravity,
    HyperViscosity,
    Initial,
    LinearElastic,
    Model,
    NeoHookean,
    Simulation,
    StokesViscosity,
)
from ngvisco.geometries import box
from tests.verification.cases.bands import growth
from tests.verification.cases.manufactured import radial_creep
from tests.verification.cases.shear import MYR
from tests.verification.convergence import KINDS


def driven_run(kind: str, length: float, density: float, seconds: float) -> Simulation:
    """Three steps of a block under gravity, with all data as multiples of the three given units."""
    stress = density * (length / seconds) ** 2
    K_e, G_e = 2.0 * stress, 1.0 * stress
    linear = LinearElastic(K_e=K_e, G_e=G_e)
    model = Model(
        material=linear if kind == "linear" else NeoHookean(K_e=K_e, G_e=G_e, epsilon=0.1 * stress),
        viscosity=StokesViscosity(K_v=0.2 * stress * seconds, G_v=0.3 * stress * seconds),
        # mu |hess v|^4 is a power per volume
        hyperviscosity=HyperViscosity(mu=1e-3 * stress * seconds**3 * length**4, p=4.0),
        creep=Creep(G_m=2.0 * stress * seconds),
        loads=(Gravity((0.3 * length / seconds**2, -0.8 * length / seconds**2)),),
    )
    rho_0 = density * (1 + 0.3 * x / length)
    simulation = Simulation(
        box((length, length), 0.5 * length), model, dt=0.1 * seconds, initial=Initial(density=rho_0)
    )
    simulation.run(0.3 * seconds)
    return simulation


@pytest.mark.parametrize("kind", KINDS)
def test_runs_do_not_depend_on_the_units(kind: str) -> None:
    """One run has units of one; the other is a block of rock of 100 km in SI units."""
    length, density, seconds = 1e5, 3300.0, 57.0
    one, rock = driven_run(kind, 1.0, 1.0, 1.0), driven_run(kind, length, density, seconds)
    for name, unit in {"velocity": length / seconds, "density": density}.items():
        for point in [(0.2, 0.3), (0.7, 0.6)]:
            here = np.array(one.fields[name](one.mesh(*point)))
            there = np.array(rock.fields[name](rock.mesh(*(length * s for s in point)))) / unit
            assert np.allclose(here, there, rtol=1e-8, atol=1e-10)
    assert abs(rock.ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.parametrize("kind", KINDS)
def test_creeping_rock_in_si_units_keeps_its_ledger(kind: str) -> None:
    """Rock of 100 km and 1e22 Pa s, in steps of 1,000 years, moves at 1e-8 m/s, 1e-11 of the speed of free
    fall."""
    linear = LinearElastic(K_e=2e10, G_e=1e10)
    model = Model(
        material=linear if kind == "linear" else NeoHookean(K_e=2e10, G_e=1e10, epsilon=1e9),
        viscosity=StokesViscosity(K_v=1e19, G_v=1e19),
        creep=Creep(G_m=2e22),
        loads=(Gravity((0.0, -9.81)),),
    )
    initial = Initial(density=3300 * (1 - 0.1 * x / 1e5))
    simulation = Simulation(box((1e5, 1e5), 5e4), model, dt=1e-3 * MYR, initial=initial)
    simulation.run(3e-3 * MYR)
    ledger = simulation.ledger
    assert abs(ledger.column("closure_relative")).max() <= 1e-10
    assert abs(ledger.column("mass_drift")).max() <= 1e-12


def test_the_theory_of_necks_has_its_known_limits() -> None:
    """The limits are a thin layer without a medium, which does not neck for n = 1, and folds of stiff layers
    (Biot 1961)."""
    for n in (1.0, 3.0, 10.0):
        assert growth(n, 1e7, 0.01, 800.0) == pytest.approx(n - 1, abs=2e-3)
    ratio, waves = 1e4, np.geomspace(0.05, 0.14, 40)
    rates = [growth(1, ratio, k, 8 / k, -1.0, fold=True) - 1 for k in waves]
    assert waves[np.argmax(rates)] == pytest.approx((6 / ratio) ** (1 / 3), rel=0.03)
    assert max(rates) == pytest.approx((4 * ratio / 3) ** (2 / 3), rel=0.01)


def test_the_reference_of_radial_creep_has_the_closed_form_if_linear_and_the_right_flux_if_not():
    """For q = 2 an eigenfunction of the Laplacian with zero slope at the wall is divided by G_m + nu k^2."""
    # the number is the first k > 0 with tan k = k
    for dim, k, f in ((2, jn_zeros(1, 1)[0], jv), (3, 4.493409457909064, spherical_jn)):
        r, a = radial_creep(dim, 0.3, 2.0, lambda s, k=k, f=f: f(0, k * s), 2000)
        assert a == pytest.approx(f(0, k * r) / (2.0 + 0.3 * k * k), abs=1e-6)
    r, a = radial_creep(3, 1.0, 4.0, lambda s: 2 * np.cos(2 * s))
    middle, slope = 0.5 * (r[1:] + r[:-1]), np.diff(a) / np.diff(r)
    density = (a[1:] + a[:-1] - 2 * np.cos(2 * middle)) * middle**2  # integral: the flux at r
    inside = np.cumsum(density * np.diff(r)) - 0.5 * density * np.diff(r)
    assert middle**2 * slope**3 == pytest.approx(inside, abs=2e-6) and np.abs(inside).max() > 0.04

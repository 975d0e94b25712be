"""Reference solutions: relaxation of a Maxwell body, units, and formulas of cases by other ways."""

import numpy as np
import pytest
from ngsolve import x
from numpy.polynomial import Legendre
from scipy.linalg import eigh

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
from tests.verification.cases.layers import DEPTH, GRAVITY, SHEARS, K, mode
from tests.verification.cases.shear import MYR, ROCK, relaxed_stress
from tests.verification.models import KINDS

SCALED = {"G": 1.0, "eta": 1.0, "tau_0": 2e-3, "duration": 7.9, "size": 1.0, "rho": 1.0}
UNITS = {"scaled": SCALED, "SI": ROCK}


@pytest.mark.parametrize("units", UNITS.values(), ids=UNITS)
def test_maxwell_relaxation_is_that_of_the_implicit_euler_formula(units: dict[str, float]) -> None:
    steps = 10
    stresses, run = relaxed_stress(**units, steps=steps)
    assert abs(run.ledger.column("closure_relative")).max() <= 1e-10
    E, size = run.fields["E"], units["size"]
    here, there = (E(run.mesh(a * size, b * size))[0] for a, b in [(0.2, 0.3), (0.8, 0.6)])
    assert here == pytest.approx(there, rel=1e-11)
    decay = 1 / (1 + units["duration"] / steps * units["G"] / units["eta"])
    exact = units["tau_0"] * decay ** np.arange(1, steps + 1)
    assert np.allclose(stresses, exact, rtol=1e-10, atol=0)


def driven_run(kind: str, length: float, density: float, seconds: float) -> Simulation:
    """Three steps of a block under gravity, all data given as multiples of these three units."""
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
    """Once in units of one, once for a block of rock of 100 km in SI units."""
    length, density, seconds = 1e5, 3300.0, 57.0
    one, rock = driven_run(kind, 1.0, 1.0, 1.0), driven_run(kind, length, density, seconds)
    for name, unit in {"velocity": length / seconds, "density": density}.items():
        for point in [(0.2, 0.3), (0.7, 0.6)]:
            here = np.array(one.fields[name](one.mesh(*point)))
            there = np.array(rock.fields[name](rock.mesh(*(length * s for s in point)))) / unit
            assert np.allclose(here, there, rtol=1e-8, atol=1e-10)
    assert abs(rock.ledger.column("closure_relative")).max() <= 1e-10


@pytest.mark.parametrize("kind", KINDS)
def test_creeping_rock_in_si_units_keeps_its_ledger_and_its_upwinding(kind: str) -> None:
    """100 km of rock, 1e22 Pa s, 1,000 years a step: 1e-8 m/s, 1e-11 of what free fall would be."""
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
    # with the width of free fall, 0.1 m/s, jumps of density would be spread over the whole block
    width = simulation.rothe_step.context.eta.Get()
    assert width * simulation.dt <= 2e-4 * 1e5
    assert width <= 0.1 * ledger.column("v_max").max()


@pytest.mark.parametrize("shear", SHEARS)
def test_the_frequency_of_a_gel_s_layer_is_the_least_of_its_polynomials(shear: float) -> None:
    """Rayleigh and Ritz: elastic energy and weight over the mass, of a gel that is hardly compressible."""
    ratio, bulk, count = 1e-3, 1e5, 12
    q, weights = np.polynomial.legendre.leggauss(2 * count)
    y, weights = DEPTH * (q + 1) / 2, weights * DEPTH / 2
    functions = [Legendre.basis(n, [0, DEPTH]) for n in range(count)]
    of_v = [Legendre([DEPTH / 2, DEPTH / 2], [0, DEPTH]) * f for f in functions]  # 0 at the bed
    zero = np.zeros((count, len(y)))
    u, du, v, dv = (
        np.concatenate(parts)
        for parts in (
            ([f(y) for f in functions], zero),
            ([f.deriv()(y) for f in functions], zero),
            (zero, [f(y) for f in of_v]),
            (zero, [f.deriv()(y) for f in of_v]),
        )
    )
    top = np.append(np.zeros(count), [f(DEPTH) for f in of_v])

    def product(a: np.ndarray) -> np.ndarray:
        return (a * weights) @ a.T

    stiffness = (bulk - 2 * shear / 3) * product(K * u + dv) + shear * product(du - K * v)
    stiffness += 2 * shear * (product(K * u) + product(dv)) + GRAVITY * (1 - ratio) * np.outer(top, top)
    mass = product(u) + product(v) + ratio / (K * np.tanh(K * (1 - DEPTH))) * np.outer(top, top)
    least = eigh(stiffness, mass, eigvals_only=True)[0] ** 0.5
    assert mode(ratio, shear)[0] == pytest.approx(least, rel=1e-4)


def test_the_theory_of_necks_has_the_limits_that_are_known() -> None:
    """A thin layer in nothing, of n = 1 too, which does not neck; Biot's folds, 1961, of a stiff layer."""
    for n in (1.0, 3.0, 10.0):
        assert growth(n, 1e7, 0.01, 800.0) == pytest.approx(n - 1, abs=2e-3)
    ratio, waves = 1e4, np.geomspace(0.05, 0.14, 40)
    rates = [growth(1, ratio, k, 8 / k, -1.0, fold=True) - 1 for k in waves]
    assert waves[np.argmax(rates)] == pytest.approx((6 / ratio) ** (1 / 3), rel=0.03)
    assert max(rates) == pytest.approx((4 * ratio / 3) ** (2 / 3), rel=0.01)

"""Runs with carried parameters: the ledger, both solvers, another observer, ranges, start values."""

import numpy as np
import pytest
from ngsolve import CF, IfPos, cos, pi, sin, x, y
from scipy.optimize import brentq
from support import SWIRL, by_both_solvers

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian

theta = nv.Parameter("theta", start=0.5 + 0.4 * sin(3 * x) * cos(2 * y))


def heterogeneous(**options):
    """All laws with moduli that differ from place to place."""
    material = nv.NeoHookean(K_e=20 * (1 + theta), G_e=1 + 4 * theta, epsilon=0.1 + 0.05 * x)
    return nv.Model(
        material=material,
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.02 + 0.1 * theta * theta),
        hyperviscosity=nv.HyperViscosity(mu=1e-4 * (1 + y)),
        creep=nv.Creep(G_m=1 + theta),
        loads=[nv.Gravity((0.0, -1.0))],
        **options,
    )


DIFFUSING = nv.Regularisation(delta_fields=1e-3)


@pytest.mark.parametrize(
    ("scheme", "regularisation"),
    [
        ("backward-euler", DIFFUSING),
        ("midpoint", None),
        pytest.param("backward-euler", None, marks=pytest.mark.long),
        pytest.param("midpoint", DIFFUSING, marks=pytest.mark.long),
    ],
)
def test_ledger_closes_to_rounding_and_both_solvers_agree(scheme, regularisation):
    options = {"dt": 0.01, "initial": nv.Initial(velocity=SWIRL), "scheme": scheme}
    mesh, model = box((1, 1), maxh=0.5), heterogeneous(regularisation=regularisation)
    by_both_solvers(lambda solver: nv.Simulation(mesh, model, solver=solver, **options), 0.03)


def test_parameters_do_not_diffuse():
    """delta Laplace z is of the strains: at rest a parameter stays as it is."""
    viscosity = nv.StokesViscosity(K_v=1e3, G_v=1e3 * (1 + theta))
    material = nv.ReferentialNeoHookean(K_e=10.0, G_e=1.0, elastic_state="F")
    law = nv.Regularisation(delta_fields=0.05)
    model = nv.Model(material=material, viscosity=viscosity, regularisation=law)
    F = CF((1 + 1e-6 * sin(3 * x), 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    for solver in ("split", "coupled"):
        run = nv.Simulation(
            box((1, 1), 0.4),
            model,
            time=nv.TimeSteps(dt=0.1, limiter=False),
            initial=nv.Initial(F=F),
            solver=solver,
        )
        before = run.rothe_step.state.vec.FV().NumPy()[run.rothe_step.layout.ranges["z"]].copy()
        run.run(0.1)
        after = run.rothe_step.state.vec.FV().NumPy()[run.rothe_step.layout.ranges["z"]]
        size = run.rothe_step.layout.states.size
        moved = np.abs(after - before).reshape(size, -1).max(axis=1)
        assert moved[-1] < 0.1 * moved[0]


def test_three_dimensions():
    """The same in space, one step."""
    G_e = nv.Parameter("theta", start=1 + x * y)
    material = nv.NeoHookean(K_e=10.0, G_e=G_e, epsilon=0.1)
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1 * G_e))
    mesh, start = box((1, 1, 1), maxh=1.0), nv.Initial(velocity=(*SWIRL, 0.0))
    by_both_solvers(lambda solver: nv.Simulation(mesh, model, dt=0.02, solver=solver, initial=start), 0.02)


def in_uniform_flow(speed):
    """A body in uniaxial stress across layers of different stiffness, that flows across these.

    All moduli are multiples of theta(y), and the stress has only T_11 = theta tau_11: div T = 0 wherever the
    layers are.  Gives the largest |v - (0, speed)| over that by the force -d phi/dx alone, and the largest
    error of T_11 over T_11.
    """
    theta = nv.Parameter("theta", start=1 + 0.5 * sin(2 * pi * y))
    material = nv.CustomMaterial(
        transported=(Distortion(), Jacobian(), theta),
        stored_energy=lambda F, J, theta: theta * (square(F) / J + 10 * (J - 2 + 1 / J)),
    )
    a, c, until = 1.1, 1.0, 0.05
    b = float(brentq(lambda b: _t22(a, b, c), 0.5, 1.5))
    F = CF((a, 0, 0, 0, b, 0, 0, 0, c), dims=(3, 3))
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1))
    initial = nv.Initial(F=F, velocity=(0.0, speed))
    mesh = box((1, 1), maxh=0.2, periodic="xy")
    run = nv.Simulation(mesh, model, time=nv.TimeSteps(dt=0.01, velocity_scale=1.0), initial=initial)
    run.run(until)
    unbalanced = until * np.pi * _energy(a, b, c)
    off = run.fields["velocity"] - CF((0.0, speed))
    exact = _t11(a, b, c) * (1 + 0.5 * sin(2 * pi * (y - speed * until)))
    wrong = run.fields["cauchy_stress"][0, 0] - exact
    velocity, stress = (run.sampler.extrema(part)[1] ** 0.5 for part in (off * off, wrong * wrong))
    return velocity / unbalanced, stress / abs(_t11(a, b, c))


def _energy(a, b, c):
    J = a * b * c
    return (a * a + b * b + c * c) / J + 10 * (J - 2 + 1 / J)


def _t11(a, b, c):
    h = 1e-6
    return a * (_energy(a + h, b, c) - _energy(a - h, b, c)) / (2 * h) + _energy(a, b, c)


def _t22(a, b, c):
    h = 1e-6
    return b * (_energy(a, b + h, c) - _energy(a, b - h, c)) / (2 * h) + _energy(a, b, c)


@pytest.mark.parametrize("speed", [-1.0, pytest.param(2.0, marks=pytest.mark.long)])
def test_a_heterogeneous_body_in_uniform_flow_keeps_its_stress(speed):
    """Galilean invariance: the stress of the layers is theirs where they have come to."""
    velocity, stress = in_uniform_flow(speed)
    assert velocity < 0.02 and stress < 0.2


def test_a_parameter_stays_within_the_range_of_its_start():
    """A step of theta from 0 to 1 is turned round; without a limiter it overshoots by more than 5 %."""
    extremes = {}
    for limiter in (True, False):
        theta = nv.Parameter("theta", start=IfPos(x - 0.45, 1.0, 0.0))
        model = nv.Model(
            material=nv.LinearElastic(K_e=10.0, G_e=1 + theta), viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1)
        )
        mesh, initial = box((1, 1), maxh=0.25), nv.Initial(velocity=SWIRL)
        run = nv.Simulation(mesh, model, time=nv.TimeSteps(dt=0.05, limiter=limiter), initial=initial)
        run.run(0.2)
        assert np.abs(run.ledger.column("closure_relative")).max() <= 1e-12
        extremes[limiter] = run.sampler.extrema(run.fields["theta"])
    assert extremes[True][0] >= -1e-8 and extremes[True][1] <= 1 + 1e-8
    assert extremes[False][0] < -0.05 and extremes[False][1] > 1.05


def test_start_values_are_asked_for_and_checked():
    mesh, material = box((1, 1), maxh=0.5), nv.NeoHookean(K_e=1.0, G_e=nv.Parameter("stiff"), epsilon=0.1)
    with pytest.raises(nv.InitialDataError, match="parameter stiff: no start value"):
        nv.Simulation(mesh, nv.Model(material=material), dt=0.1)
    with pytest.raises(nv.InitialDataError, match=r"NeoHookean.G_e: minimum -1.*expected > 0"):
        initial = nv.Initial(values={"stiff": 2 * x - 1})
        nv.Simulation(mesh, nv.Model(material=material), dt=0.1, initial=initial)
    with pytest.raises(nv.InitialDataError, match=r"StokesViscosity.G_v: minimum -0.5"):
        law = nv.StokesViscosity(K_v=0.1, G_v=x - 0.5)
        nv.Simulation(mesh, nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0), viscosity=law), dt=0.1)
    run = nv.Simulation(
        mesh, nv.Model(material=material), dt=0.1, initial=nv.Initial(values={"stiff": 2 + CF(x)})
    )
    assert run.fields["stiff"](mesh(0.3, 0.4)) == pytest.approx(2.3)


def test_density_follows_from_a_referential_density_that_differs_from_place_to_place():
    material = nv.BarotropicFluid(B=1.0, gamma=1.4, rho_R=2 + x)
    mesh = box((1, 1), maxh=0.5)
    run = nv.Simulation(mesh, nv.Model(material=material), dt=0.1, initial=nv.Initial(values={"J": CF(1.25)}))
    assert run.fields["density"](mesh(0.3, 0.4)) == pytest.approx(2.3 / 1.25)


@pytest.mark.filterwarnings("error::ngvisco.errors.InputWarning")
def test_a_parameter_is_not_warned_of_where_it_is_not_told_by_the_distortion():
    """F tells nothing of a parameter, which may have any value."""
    material = nv.NeoHookean(K_e=5 + x, G_e=1.0, epsilon=0.1)
    initial = nv.Initial(F=CF((1.1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3)))
    mesh = box((1, 1), maxh=0.5)
    run = nv.Simulation(mesh, nv.Model(material=material), dt=0.1, initial=initial)
    assert run.fields["K_e"](mesh(0.3, 0.4)) == pytest.approx(5.3)


def test_a_parameter_named_like_a_field_is_refused():
    """It would stand in the results in place of that field."""
    for name in ("density", "pressure", "viscous_stress"):
        material = nv.NeoHookean(K_e=1.0, G_e=nv.Parameter(name, start=2.0), epsilon=0.1)
        with pytest.raises(nv.ParameterError, match=f"Variable.name = '{name}': expected another name"):
            nv.Simulation(box((1, 1), maxh=1.0), nv.Model(material=material), dt=0.1)

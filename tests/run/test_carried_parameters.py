"""Runs with carried parameters: the ledger, both solvers, another observer, ranges, start values."""

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y
from support import SWIRL, by_both_solvers, small_run

import ngvisco as nv
from ngvisco.geometries import box

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


def test_start_values_may_be_given():
    mesh, material = box((1, 1), maxh=0.5), nv.NeoHookean(K_e=1.0, G_e=nv.Parameter("stiff"), epsilon=0.1)
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


def test_a_heterogeneous_body_in_uniform_flow_keeps_its_stress():
    """Galilean invariance: layers of 3 K_e = 2 G_e under T_11 alone flow across themselves."""
    theta, speed, until = nv.Parameter("theta", start=1 + 0.5 * sin(2 * pi * y)), 2.0, 0.05
    material, mesh = nv.LinearElastic(K_e=theta / 1.5, G_e=theta), box((1, 1), maxh=0.2, periodic="xy")
    stretch = {"E": CF((1e-3, 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))}
    run = small_run(mesh, 0.01, material=material, velocity=(0.0, speed), values=stretch, velocity_scale=1.0)
    run.run(until)
    moved = run.fields["velocity"] - CF((0.0, speed))
    assert run.sampler.extrema(moved * moved)[1] ** 0.5 < 0.2 * until * pi * 2e-3
    for way, is_gone in ((speed * until, True), (0.0, False)):
        missed = run.fields["cauchy_stress"][0, 0] / 2e-3 - (1 + 0.5 * sin(2 * pi * (y - way)))
        assert (Integrate(missed * missed, mesh, order=6) < 0.1**2) == is_gone

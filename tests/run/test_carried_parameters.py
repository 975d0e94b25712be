"""Runs with carried parameters: the ledger, both solvers, another observer, ranges, start values."""

import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y
from support import SWIRL, by_both_solvers, by_ci, small_run

import ngvisco as nv
from ngvisco.geometries import box, structured_box

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
        by_ci("backward-euler", DIFFUSING),
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
    """delta Laplace z acts on strains only: at rest a parameter stays as it is."""
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
    """A step of theta from 0 to 1 is rotated; without a limiter theta overshoots by more than 5 %."""
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


def test_start_values_of_parameters_may_be_given():
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
def test_a_start_parameter_beside_a_given_distortion_brings_no_warning():
    """F does not determine a parameter, which may have any value."""
    material = nv.NeoHookean(K_e=5 + x, G_e=1.0, epsilon=0.1)
    initial = nv.Initial(F=CF((1.1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3)))
    mesh = box((1, 1), maxh=0.5)
    run = nv.Simulation(mesh, nv.Model(material=material), dt=0.1, initial=initial)
    # the logarithm of the modulus is linear
    assert run.fields["K_e"](mesh(0.3, 0.4)) == pytest.approx(5.3, rel=1e-3)


def test_a_heterogeneous_body_in_uniform_flow_keeps_its_stress():
    """Galilean invariance: layers with 3 K_e = 2 G_e under T_11 alone are carried by a flow across them."""
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


SOFT, UPPER = 1.0, IfPos(y - 0.5, 1.0, 0.0)
"""Creep modulus of the lower half, Pa s, and the indicator of the upper half; the face between both consists
of sides of cells."""


def sagging(stiff, force=1e-4):
    """Stresses over the load, in a box whose lower half creeps and whose upper half has the creep modulus
    ``stiff``, Pa s, after two Maxwell times of the lower half. The load moves the face between both halves by
    at least 1e-5 of a cell."""
    model = nv.Model(
        material=nv.LinearElastic(K_e=2.0, G_e=0.5),
        viscosity=nv.StokesViscosity(K_v=1e-3, G_v=1e-3),
        creep=nv.Creep(G_m=SOFT + (stiff - SOFT) * UPPER),
        loads=[nv.BodyForce((0.0, force * cos(pi * x)))],
    )
    mesh, initial = structured_box((1, 1), (4, 4)), nv.Initial(density=1e-3)
    run = nv.Simulation(mesh, model, dt=0.5, initial=initial, solver="split")
    run.run(2.0)
    places = ((0.07, 0.45), (0.07, 0.41), (0.47, 0.43), (0.07, 0.55))
    stresses = (np.reshape(run.fields["cauchy_stress"](mesh(*place)), (3, 3)) for place in places)
    return np.array([(T[0, 0], T[1, 1], T[0, 1]) for T in stresses]) / force


def test_a_small_inflow_of_stiff_material_does_not_change_the_stress():
    """The upper half is elastic on this time scale, with 1e4, 1e6 and 1e11 times the creep modulus. The right
    stresses come from a run in which nothing moves into other cells."""
    right = sagging(1e4, force=1e-10)
    assert np.abs(right).max() > 0.05
    for stiff in (1e4, 1e6, 1e11):
        assert np.abs(sagging(stiff) - right).max() <= 0.03 * np.abs(right).max()


@pytest.mark.long
@pytest.mark.ci
def test_creep_that_gives_energy_by_an_overshooting_modulus_is_warned_of():
    """The modulus has the arithmetic mean and no limiter; the rule itself is admissible."""
    soft = nv.Parameter("soft", start=IfPos(x - 0.45, 1.0, 0.0))
    model = nv.Model(
        material=nv.LinearElastic(K_e=10.0, G_e=1.0),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        creep=nv.Creep(G_m=0.01 + soft),
    )
    mesh, time = box((1, 1), maxh=0.5), nv.TimeSteps(dt=0.02, limiter=False)
    run = nv.Simulation(mesh, model, time=time, initial=nv.Initial(velocity=SWIRL), solver="coupled")
    with pytest.warns(
        nv.CreepPowerWarning, match=r"Creep\.G_m is -.* at a point, since a parameter .* arithmetic"
    ):
        run.run(0.06)


@pytest.mark.parametrize("density", [False, True])
def test_a_start_field_that_jumps_between_cells_stays_constant_in_the_cells(density):
    """Some quadrature rules have points on the sides."""
    start = SOFT + 9 * UPPER
    model = nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0), creep=nv.Creep(G_m=start))
    initial = nv.Initial(density=start if density else 1.0)
    run = nv.Simulation(structured_box((1, 1), (2, 2)), model, dt=0.1, initial=initial)
    field = run.fields["density" if density else "G_m"]
    for place, expected in (((0.1, 0.49), 1.0), ((0.1, 0.51), 10.0), ((0.4, 0.9), 10.0), ((0.7, 0.1), 1.0)):
        assert field(run.mesh(*place)) == pytest.approx(expected, rel=1e-12)

"""Walls: each condition's linearisation, power and ledger, and the conditions that are refused."""

import numpy as np
import pytest
from ngsolve import BND, CF, Id, IfPos, Integrate, cos, pi, sin, sqrt, x, y
from support import ROTATION, WALLS, assert_balanced, by_ci, difference_times, jacobian_times, uncondensed

import ngvisco as nv
from ngvisco.forms.projections import set_traces
from ngvisco.forms.system import Step
from ngvisco.geometries import block_with_hole, box, disc, sphere, spherical_shell


def model(loads=()):
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        creep=nv.Creep(G_m=5.0),
        loads=loads,
    )


CASES = {
    **WALLS,
    "slip, disc": (lambda: disc(1, 0.7), {}, nv.Initial(velocity=ROTATION), ()),
    "slip, disc, pre-stretched": (
        lambda: disc(1, 0.7),
        {},
        nv.Initial(F=CF((1.3, 0.2 * y, 0, 0, 1 / 1.3, 0, 0, 0, 1), dims=(3, 3))),
        (),
    ),
    "slip, hole": (
        lambda: block_with_hole((1, 1), 0.25, 0.5),
        {},
        nv.Initial(velocity=(sin(pi * x), 0.3)),
        (),
    ),
    "periodic twice": (
        lambda: box((1, 1), 0.5, periodic="xy"),
        {},
        nv.Initial(velocity=(sin(2 * pi * y), cos(2 * pi * x))),
        (nv.Gravity((1.0, 0.5)),),
    ),
    "in and out": (
        lambda: box((1, 1), 0.5),
        {
            "left": nv.Inflow(
                velocity=(0.3 * y * (1 - y) * sin(10 * nv.time), 0),
                density=1.2,
                values={"J": 1 + 0.1 * nv.time},
            ),
            "right": nv.Open(
                pressure=-15 + sin(10 * nv.time),
                traction=(y, 0.5),
                impedance=(0.3, 0.1),
                density=0.9,
                stiffness=(9, 4),
            ),
            "top": nv.NoSlip(),
        },
        nv.Initial(density=1 + 0.1 * x),
        (nv.Gravity((0.0, -1.0)),),
    ),
    "piston": (
        lambda: box((1, 1), 0.5),
        {"right": nv.PrescribedNormal(velocity=0.3 * y * sin(10 * nv.time))},
        nv.Initial(density=1 + 0.1 * x),
        (nv.Gravity((0.0, -1.0)),),
    ),
    "open disc": (
        lambda: disc(1, 0.7),
        {"wall": nv.Open(pressure=-15.0 + x, density=1 + 0.1 * y, backflow=False, stiffness=(30, 5))},
        nv.Initial(density=1 + 0.1 * x, velocity=ROTATION),
        (),
    ),
}


OF_CI = (
    "slip, hole",
    "slip, disc",
    "slip, disc, pre-stretched",
    "accelerated rotating wall",
    "traction with friction",
)
"""Schemes that CI tries here. In the default suite, test_ledger_of_schemes tries all schemes with walls that
change in time."""


@pytest.mark.parametrize("name", [by_ci(name) if name in OF_CI else name for name in CASES])
def test_ledger_closes_and_mass_is_conserved_with_every_wall(name):
    mesh, walls, initial, loads = CASES[name]
    run = nv.Simulation(mesh(), model(loads), dt=0.02, initial=initial, walls=walls)
    ledger = run.run(0.06)
    assert_balanced(ledger, 1e-12, 1e-13)
    assert ledger.column("v_max")[-1] > 1e-3
    if name == "slip, disc":  # the wall exerts no friction, so that only matter dissipates
        assert ledger.column("kinetic")[-1] > 0.99 * ledger.column("kinetic")[0]
    of_walls = ("power_wall", "power_traction", "power_kinetic", "power_stored", "dissipation_friction")
    for entry in ledger.entries:
        if entry.name.startswith((*of_walls, "dissipation_impedance", "dissipation_backflow", "inflow")):
            value = ledger.column(entry.name)[-1]
            assert (abs(value) if any(run.rothe_step.walls.crossed) else value) > 1e-6


@pytest.mark.parametrize(
    "name", ["slip, hole", "traction with friction", "friction", "two lids, periodic", "in and out"]
)
def test_linearisation_of_wall_terms_equals_differences(name):
    make_mesh, walls, _, loads = CASES[name]
    mesh = make_mesh()
    step = Step(mesh, model(loads), conditions=walls)
    step.context.tau.Set(0.1)
    rng = np.random.default_rng(1)
    state, direction = step.state.vec, step.state.vec.CreateVector()
    free = np.array(list(step.layout.space.FreeDofs()), dtype=bool)
    parts = dict(zip(step.layout.names, step.state.components, strict=True))
    parts["rho"].Set(1.0)
    rest = {v.name: v.from_distortion(Id(3)) for v in step.model.material.variables}
    parts["z"].Set(step.model.material.states(mesh.dim).components(rest))
    set_traces(step.layout, step.state, step.context, step.quadrature)
    for vector, size in ((state, 0.02), (direction, 1.0)):
        old = vector.FV().NumPy().copy() if vector is state else 0.0
        vector.FV().NumPy()[:] = old + size * free * rng.standard_normal(len(free))
    step.local_unknowns.update_stored()  # the stress at which creep is linearised
    full = uncondensed(step)
    product, difference = (
        jacobian_times(full, state, direction),
        difference_times(full, state, direction, 1e-5),
    )
    defect = np.abs(product - difference)[free].max()
    assert defect <= 1e-6 * np.abs(difference[free]).max()


@pytest.mark.long
def test_ledger_closes_on_a_sphere_and_a_shell():
    for mesh, loads in (
        (sphere(1, 1.2, order=2), ()),
        (spherical_shell(0.5, 1, 1, order=2), (nv.CentralGravity(strength=1.0, centre=(0, 0, 0)),)),
    ):
        initial = nv.Initial(density=1 + 0.1 * x, velocity=(-y, x, 0 * x))
        ledger = nv.Simulation(mesh, model(loads), dt=0.02, initial=initial).run(0.04)
        assert_balanced(ledger, 1e-12, 1e-13)


def test_the_normal_part_of_a_traction_has_no_power():
    walls = {"top": nv.Traction(f=(0.0, 7.0))}
    with pytest.warns(nv.InputWarning, match=r"walls\['top'\].f: 100% of the traction .* left out"):
        run = nv.Simulation(box((1, 1), 0.5), model(), dt=0.01, walls=walls)
    assert run.run(0.01).column("v_max")[-1] < 1e-12


def test_a_start_velocity_through_walls_is_projected_with_one_warning():
    initial = nv.Initial(velocity=(x, 0.0))
    with pytest.warns(
        nv.InputWarning,
        match=r"impenetrable walls right \(100% of the velocity there, 2 times the mean inside\)",
    ) as said:
        run = nv.Simulation(box((1, 1), 0.5), model(), dt=0.01, initial=initial)
    assert len(said) == 1
    through = run.fields["velocity"][0]
    assert Integrate(through * through, run.mesh, BND, definedon=run.mesh.Boundaries("right")) < 1e-20


@pytest.mark.parametrize(
    "wall",
    [
        nv.NavierFriction(0.3 - nv.time),
        nv.Traction(f=(sqrt(0.3 - nv.time), 0)),
        nv.PrescribedTangential((0, IfPos(nv.time - 0.3, 1, 0))),
    ],
)
def test_wall_data_are_checked_over_the_time_of_the_run(wall):
    run = nv.Simulation(box((1, 1), 0.5), model(), dt=0.1, walls={"top": wall})
    with pytest.raises(nv.ParameterError, match=r"walls\['top'\]"):
        run.run(0.4)
    assert run.number == 0

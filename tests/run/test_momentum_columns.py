"""Columns of the momentum: every cause of a change has a column, and the rest is a defect."""

import warnings

import h5py
import numpy as np
import pytest
from ngsolve import CF, IfPos, Integrate, cos, pi, sin, x, y
from support import each_once

import ngvisco as nv
from ngvisco.forms.impulses import DEFECTS
from ngvisco.geometries import box, channel, disc, structured_box
from ngvisco.run.ledger import Ledger, unit
from ngvisco.run.momentum import LOST, MomentumWarning, _Totals, column

pytestmark = pytest.mark.filterwarnings("ignore::ngvisco.run.momentum.MomentumWarning")

SOLID = nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0)
STOKES = nv.StokesViscosity(K_v=0.2, G_v=0.1)
SWIRL = nv.Initial(velocity=(sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y)))
SCHEMES = ("backward-euler", "midpoint", "sdirk2")


def momenta(run: nv.Simulation) -> np.ndarray:
    """Momentum and angular momentum about the origin, by NGSolve's own integrals."""
    rho, v = run.fields["density"], run.fields["velocity"]
    along = [rho * v[i] for i in range(run.mesh.dim)]
    if run.mesh.dim == 2:
        along.append(rho * (x * v[1] - y * v[0]))
    return np.array([Integrate(each, run.mesh, order=9) for each in along])


def of(ledger: Ledger, quantity: str) -> np.ndarray:
    """A quantity's columns, (rows, motions)."""
    names = [column(quantity, motion) for motion in ledger.momentum.motions]
    return np.array([ledger.column(name) for name in names]).T


def impulses(ledger: Ledger) -> np.ndarray:
    names = ledger.momentum.impulses.names
    return sum(of(ledger, f"impulse_{name}") for name in names)


def left(ledger: Ledger) -> np.ndarray:
    """Part of the defect that no column contains."""
    return of(ledger, "momentum_defect") - sum(of(ledger, f"defect_{where}") for where in DEFECTS)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("solver", ["coupled", "split"])
@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.long)])
def test_gravity_gives_a_periodic_body_its_weight_times_the_time(scheme, solver, dim):
    g = (0.5, -2.0, 0.3)[:dim]
    model = nv.Model(material=SOLID, viscosity=STOKES, loads=[nv.Gravity(g)])
    mesh = box((1,) * dim, maxh=0.5, periodic="xyz"[:dim])
    run = nv.Simulation(mesh, model, dt=0.1, scheme=scheme, solver=solver, initial=nv.Initial(density=3.0))
    ledger = run.run(until=0.2)
    assert not any(name.startswith("angular") for name in ledger.columns)  # a periodic box has no rotation
    np.testing.assert_allclose(of(ledger, "momentum")[-1], 3.0 * 0.2 * np.array(g), rtol=1e-12)
    np.testing.assert_allclose(of(ledger, "impulse_gravity")[1:], 2 * [0.3 * np.array(g)], rtol=1e-12)
    assert abs(of(ledger, "momentum_defect")).max() < 1e-13


WALLS = {
    "slip": {},
    "a moving lid": {"top": nv.PrescribedTangential((0.5 * sin(9 * nv.time), 0)), "left": nv.NoSlip()},
    "friction and traction": {
        "top": nv.Traction(f=(0.3, 0), friction=0.2),
        "bottom": nv.NavierFriction(0.4),
    },
    "open": {
        "right": nv.Open(pressure=0.2, traction=(0.0, 0.1), impedance=(1.0, 0.5), density=1.0),
        "left": nv.Inflow(velocity=(0.2 * y, 0.0), density=1.2),
    },
    "springs": {"bottom": nv.Open(stiffness=(4.0, 1.0), density=1.0), "top": nv.Open(density=1.0)},
}


def run_between(walls, scheme="backward-euler", solver="coupled", **options) -> nv.Simulation:
    model = nv.Model(
        material=SOLID,
        viscosity=STOKES,
        hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4),
        loads=[nv.Gravity((0.3, -1.0)), nv.BodyForce((0.1 * y, 0.0))],
    )
    return nv.Simulation(
        box((1, 1), maxh=0.5),
        model,
        dt=0.05,
        walls=walls,
        initial=SWIRL,
        scheme=scheme,
        solver=solver,
        **options,
    )


@pytest.mark.parametrize(("between", "scheme"), each_once(WALLS, SCHEMES))
def test_momentum_changes_by_the_impulses_and_defects_of_the_ledger(between, scheme):
    run = run_between(WALLS[between], scheme)
    before = momenta(run)
    ledger = run.run(until=0.15)
    after = momenta(run)
    # the ledger's momentum equals independent integrals, and columns name its changes
    np.testing.assert_allclose(of(ledger, "momentum")[[0, -1]], [before, after], rtol=1e-10, atol=1e-12)
    named = impulses(ledger) + of(ledger, "momentum_defect")
    np.testing.assert_allclose(after - before, named.sum(axis=0), rtol=1e-10, atol=1e-12)
    size = ledger.column("momentum_size").max()
    assert 1e-2 < size < 2
    assert abs(left(ledger)).max() < 1e-11 * size
    assert abs(of(ledger, "momentum_defect")).max() < 0.02 * size


@pytest.mark.parametrize(("between", "scheme"), each_once(["slip", "a moving lid"], SCHEMES))
def test_the_impulse_of_a_wall_equals_its_reaction_times_the_step(between, scheme):
    """The impulse is compared with ``WallForces``, which reads the residual in the rows of prescribed
    unknowns."""
    forces = nv.WallForces()
    run = run_between(WALLS[between], scheme, observers=[forces])
    ledger = run.run(until=0.1)
    rows = np.array(forces.rows)[:, 2:].reshape(2, -1, 3)
    on_body = -0.05 * rows.sum(axis=1)
    assert abs(on_body).max() > 1e-2
    np.testing.assert_allclose(of(ledger, "impulse_walls")[1:], on_body, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("as_bodies", [False, True])
def test_a_floor_bears_the_weight(as_bodies):
    """The momentum flux of bodies contributes, because B_h contains the stress without phi - z : zeta."""
    weight = 1.5
    loads = [nv.Gravity((0.0, -1.0))]
    model = nv.Model(material=SOLID, viscosity=nv.StokesViscosity(K_v=2, G_v=2), loads=loads)
    start = nv.Initial(density=weight)
    if as_bodies:
        of_body = {"material": SOLID, "viscosity": nv.StokesViscosity(K_v=2, G_v=2), "density": weight}
        model, start = nv.Model(bodies=[nv.Body(name="all", **of_body)], loads=loads), nv.Initial()
    forces = nv.WallForces()
    run = nv.Simulation(box((1, 1), maxh=0.5), model, dt=1.0, initial=start, observers=[forces])
    ledger = run.run(until=12.0)
    by_wall = dict(zip(forces.columns, forces.rows[-1], strict=True))
    assert by_wall["bottom.force_2"] + by_wall["top.force_2"] == pytest.approx(-weight, rel=1e-6)
    assert ledger.column("impulse_walls_2")[-1] == pytest.approx(weight * 1.0, rel=1e-6)
    # of walls with slip, one bears pressure and one bears equal tension: half of the weight each
    assert by_wall["bottom.force_2"] == pytest.approx(-weight / 2, rel=0.02)


def test_curved_walls_turn_a_body_by_friction_alone():
    model = nv.Model(material=SOLID, viscosity=STOKES)
    spin = nv.Initial(velocity=(-y, x))
    for wall, braked in ((nv.Slip(), False), (nv.NavierFriction(0.5), True)):
        mesh = disc(1, maxh=0.7)
        name = mesh.GetBoundaries()[0]
        run = nv.Simulation(mesh, model, dt=0.02, walls={name: wall}, initial=spin, solver="split")
        ledger = run.run(until=0.04)
        assert abs(left(ledger)[:, :2]).max() < 1e-10
        assert (
            abs(left(ledger)).max() < 1e-5
        )  # cells of a higher order than v, whose space then contains no rotation
        about = ledger.column("angular_momentum")
        # the angular momentum is int rho r^2 with omega = 1
        assert about[0] == pytest.approx(pi / 2, rel=5e-3)
        walls = ledger.column("angular_impulse_walls")
        assert abs(walls).max() < 2e-4 * about[0]  # the pressure of these walls has no torque
        if braked:  # the impulse is 2 pi c R^3 omega dt; omega decreases slowly
            torque = -ledger.column(f"angular_impulse_friction_{name}")[1:] / (2 * pi * 0.5 * 0.02)
            assert (torque < 1.0).all() and (torque > 0.7).all()


def test_momentum_of_bodies_of_different_mass_is_balanced():
    def body(name, density, **where):
        material = nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0)
        return nv.Body(name=name, material=material, viscosity=STOKES, density=density, **where)

    bodies = [body("light", 1.0), body("heavy", 5.0, where=nv.Ball((0.6, 0.5), 0.25))]
    model = nv.Model(bodies=bodies, loads=[nv.Gravity((0.0, -1.0))])
    run = nv.Simulation(channel(1, 1, maxh=0.4), model, dt=0.05, initial=nv.Initial(velocity=(0.3, 0.0)))
    before = momenta(run)
    ledger = run.run(until=0.1)
    assert not any(name.startswith("angular") for name in ledger.columns)
    np.testing.assert_allclose(of(ledger, "momentum")[-1], momenta(run)[:2], rtol=1e-10, atol=1e-12)
    assert abs(left(ledger)).max() < 1e-10 * before[0]


def test_momentum_created_at_a_jump_is_a_defect_in_the_ledger():
    """A body with a jump of the strain is thrown in a periodic box without load: all change of momentum is a
    defect."""

    jump = IfPos(0.6 - x, IfPos(x - 0.3, 0.3, 0.0), 0.0)
    zero = CF(0.0)
    E = CF((jump, zero, zero, zero, zero, zero, zero, zero, zero), dims=(3, 3))
    model = nv.Model(material=nv.LinearElastic(K_e=1.0, G_e=1.0), viscosity=STOKES)
    start = nv.Initial(velocity=(0.05, 0.0), values={"E": E})
    run = nv.Simulation(box((1, 1), maxh=0.4, periodic="xy"), model, dt=0.05, initial=start)
    before = momenta(run)
    ledger = run.run(until=0.2)
    change = momenta(run) - before
    np.testing.assert_allclose(of(ledger, "momentum_defect").sum(axis=0), change[:2], rtol=1e-8, atol=1e-13)
    assert abs(left(ledger)).max() < 1e-12
    assert ledger.column("dissipation_upwinding")[1:].min() > 1e-6  # the jump travels with the body
    total = abs(change[:2]).max()
    # the defect is relative to the largest momentum plus the mass times the velocity scale; no load acts
    moving = ledger.column("momentum_size").max() + ledger.column("mass")[0] * run.velocity_scale
    assert ledger.column("momentum_defect_relative")[-1] == pytest.approx(total / moving, rel=1e-6, abs=1e-14)


def test_a_loss_of_momentum_is_warned_of_once_with_its_cause():
    run = run_between(WALLS["slip"])
    ledger = run.run(until=0.05)
    row = ledger.rows[-1] | {"momentum_defect_relative": 2 * LOST, "defect_inertia_1": 1.0}
    with pytest.warns(MomentumWarning, match=r"10\.0% of the present momentum.*skew form of inertia"):
        ledger.momentum.check(row)
    with pytest.raises(pytest.fail.Exception), pytest.warns(MomentumWarning):
        ledger.momentum.check(row)  # the second call warns of nothing, so that pytest.warns fails


def test_columns_are_written_with_units_and_continued_by_a_resumed_run(tmp_path):
    path = tmp_path / "run.h5"
    whole = run_between(WALLS["slip"], observers=[nv.Checkpoints(path, every=1, keep=9)])
    whole.run(until=0.15)
    again = run_between(WALLS["slip"])
    again.restore(path, step=1)
    again.run(until=0.15)
    for name in ("momentum_1", "angular_momentum", "momentum_defect_2", "momentum_defect_relative"):
        np.testing.assert_allclose(
            again.ledger.column(name), whole.ledger.column(name), rtol=1e-9, atol=1e-15
        )
    with h5py.File(path) as file:
        assert file["ledger/momentum_1"].attrs["unit"] == "kg m/s"
        assert file["ledger/angular_impulse_gravity"].attrs["unit"] == "kg m^2/s"
    units = {"momentum_size": "kg m/s", "momentum_defect_relative": "1", "defect_facets_2": "kg m/s"}
    assert {name: unit(name) for name in units} == units
    assert unit("defect_rms") == "1" and unit("angular_defect_cells") == "kg m^2/s"


def thrown(**options) -> nv.Simulation:
    """A smooth swirl of a fluid whose density varies by a third, thrown through a periodic box."""
    density = 1 + 0.3 * sin(2 * pi * x) * sin(2 * pi * y)
    start = nv.Initial(density=density, velocity=(1 + 0.5 * sin(2 * pi * y), 0.5 * sin(2 * pi * x)))
    fluid = nv.BarotropicFluid(B=20.0, gamma=2.0)
    model = nv.Model(material=fluid, viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01))
    return nv.Simulation(box((1, 1), 0.35, periodic="xy"), model, dt=0.02, initial=start, **options)


def test_inertia_keeps_momentum_and_its_loss_of_angular_momentum_is_a_ledger_column():
    """A velocity's component is not in the space of rho. The skew form alone would therefore lose up to 3e-4
    of the momentum."""
    ledger = thrown(scheme="midpoint").run(until=0.1)
    size = ledger.column("momentum_size").max()
    assert abs(of(ledger, "defect_inertia")).max() < 1e-12 * size
    run = run_between(WALLS["slip"])
    run.run(until=0.1)
    lost = abs(run.ledger.column("angular_defect_inertia")).max() / run.ledger.column("momentum_size").max()
    assert 1e-10 < lost < 1e-3


def test_jumps_of_smooth_states_create_no_momentum():
    """The trace at which the tangents of the energy on both sides of a facet meet exerts no net force. A
    quadrature that resolves the energy exerts no net force in cells."""
    ledger = thrown().run(until=0.1)
    size = ledger.column("momentum_size").max()
    assert abs(of(ledger, "defect_cells")).max() < 1e-9 * size
    assert abs(of(ledger, "defect_facets")).max() < 1e-9 * size


def test_a_clamped_body_under_stress_rests_without_warnings():
    """The reactions of the walls cancel and the motion decays, so that both are rounding errors in the
    end."""
    model = nv.Model(material=nv.LinearElastic(K_e=1e9, G_e=1e9))
    walls = {"left": nv.NoSlip(), "right": nv.NoSlip()}
    strain = CF((1e-3 * (1 + x * y), 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))
    mesh = structured_box((1, 0.1), (8, 1))
    run = nv.Simulation(
        mesh,
        model,
        dt=10.0,
        walls=walls,
        initial=nv.Initial(density=1000.0, values={"E": strain}),
        passive=["reference_map"],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ledger = run.run(80.0)
    assert ledger.column("v_max")[-1] < 1e-17  # m/s
    assert ledger.column("momentum_defect_relative").max() < 1e-3
    assert not ledger.column("passive_unsolved").any()


@pytest.mark.long
@pytest.mark.ci
def test_walls_bear_the_torque_of_a_heated_block_that_they_clamp():
    """In a row of cells with one diagonal, jumps of the thermal stress exert a torque of 1e-6.

    Nothing moves, since the walls bear this torque. Neither the momentum nor the impulses of walls give a
    scale of this torque.
    """
    metal = nv.Thermal(
        material=nv.LinearElastic(K_e=160e9, G_e=80e9), c=3.6e6, theta_R=293.0, expansion=3.6e-5
    )
    hot, cold = (nv.WallHeat(temperature=T, coefficient=1e6) for T in (400.0, 300.0))
    run = nv.Simulation(
        structured_box((0.01, 0.001), (10, 1)),
        nv.Model(material=metal, heat=nv.Heat(conductivity=50.0)),
        dt=2.0,
        walls={"left": nv.NoSlip(heat=hot), "right": nv.NoSlip(heat=cold)},
        initial=nv.Initial(density=7800.0),
    )
    ledger = run.run(8.0)
    torques = ledger.column("angular_momentum_defect")
    assert abs(torques).max() > 1e3 * abs(ledger.column("angular_momentum")).max()
    assert ledger.column("momentum_defect_relative").max() < 1e-3


@pytest.mark.parametrize("bodies", [0, 2])
def test_walls_bear_the_momentum_defect_if_one_material_fills_the_domain(bodies, monkeypatch):
    """The defect is a hundredth of the impulse of the stress, and much larger than the momentum. Walls bear
    the defect if one material fills the domain. A body in a medium may drift against viscosity, so that its
    whole defect counts."""
    parts = [
        nv.Body(name="block", where=0.5 - x, material=SOLID, viscosity=STOKES, density=1.0),
        nv.Body(name="rest", material=SOLID, viscosity=STOKES, density=1.0),
    ]
    model = nv.Model(bodies=parts) if bodies else nv.Model(material=SOLID, viscosity=STOKES)
    run = nv.Simulation(structured_box((1, 1), (2, 2)), model, dt=0.1)
    momentum, borne = run.ledger.momentum, np.ones(len(run.ledger.momentum.motions))
    nothing = 0 * borne
    monkeypatch.setattr(momentum, "_velocity", lambda: 0.0)
    monkeypatch.setattr(momentum, "_added", lambda row: _Totals(borne, nothing, 0.1, 100.0, nothing))
    relative = run.run(0.1).column("momentum_defect_relative")[-1]
    assert 8 < relative < 12 if bodies else 0.005 < relative < 0.02

"""Probes, integrals and wall forces agree with the fields, the ledger and the momentum balance."""

import math

import numpy as np
import pytest
from ngsolve import CF, x, y

import ngvisco as nv
from ngvisco.geometries import box, disc, half_disc, structured_box

MATERIAL = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
VISCOSITY = nv.StokesViscosity(K_v=1.0, G_v=1.0)


def small(observers=(), **options):
    model = nv.Model(material=MATERIAL, viscosity=VISCOSITY, loads=[nv.Gravity((0.3, -1.0))])
    options = {"dt": 0.01, "initial": nv.Initial(density=1 + 0.2 * x)} | options
    return nv.Simulation(box((1, 1), maxh=0.5), model, observers=list(observers), **options)


def test_probes_and_lines_have_the_values_of_the_fields():
    probes = nv.Probes({"in": (0.3, 0.4), "corner": (1, 1)}, ["velocity", "J", "F_12"], every=2)
    line = nv.LineSamples((0, 0.5), (1, 0.5), 5, ["density"])
    run = small([probes, line])
    run.run(0.03)
    assert probes.column("step").tolist() == [0, 2, 3]  # the last state is written too
    at = run.mesh(0.3, 0.4)
    for name, value in (("velocity_1", run.fields["velocity"](at)[0]), ("J", run.fields["J"](at))):
        assert probes.column(f"in.{name}")[-1] == pytest.approx(value, rel=1e-14)
    assert probes.column("corner.velocity_1") == pytest.approx(0, abs=1e-15)
    assert line.column("x")[:5].tolist() == [0, 0.25, 0.5, 0.75, 1] and len(line.rows) == 4 * 5
    assert line.column("density")[:5] == pytest.approx(1 + 0.2 * line.column("x")[:5])
    assert line.column("s")[-1] == 1


def test_probes_on_straight_and_curved_walls_have_values():
    angles = np.linspace(0, 6, 9)
    probes = nv.Probes([(math.cos(a), math.sin(a)) for a in angles], ["J"])
    model = nv.Model(material=MATERIAL)
    run = nv.Simulation(disc(1, 0.7), model, dt=0.1, observers=[probes])
    probes.start(run)
    assert probes.rows[0][2:] == pytest.approx([1.0] * 9)


def test_integrals_of_densities_equal_the_ledger():
    given = {"mass": "density", "kinetic": "0.5*density*(velocity_1**2 + velocity_2**2)", "area": CF(1.0)}
    integrals = nv.Integrals(given | {"moment": "density*x if x < 2 else 0"})
    run = small([integrals])
    ledger = run.run(0.02)
    assert integrals.column("mass") == pytest.approx(ledger.column("mass"), rel=1e-14)
    assert integrals.column("kinetic") == pytest.approx(ledger.column("kinetic"), rel=1e-12)
    assert integrals.column("area") == pytest.approx(1) and integrals.column("moment")[0] == pytest.approx(
        17 / 30
    )


FRICTION = {"left": nv.NoSlip(), "bottom": nv.NoSlip(), "top": nv.NavierFriction(0.7)}
MOVING = FRICTION | {"bottom": nv.PrescribedTangential((nv.time, 0))}


@pytest.mark.parametrize(
    ("walls", "options", "bound"),
    [
        *((walls, {"solver": of}, 1e-5) for walls in ({}, FRICTION) for of in ("coupled", "split")),
        *((MOVING, {"scheme": scheme}, 5e-5) for scheme in ("midpoint", "sdirk2")),
        (MOVING, {"scheme": "theta", "theta": 0.6}, 5e-5),
    ],
)
def test_forces_on_walls_balance_weight_and_momentum(walls, options, bound):
    """The scheme keeps momentum up to the projection of v in the convection. The change of momentum in a step
    equals the mean force over the stages times dt, plus the impulse at the end.
    """
    forces = nv.WallForces()
    integrals = nv.Integrals({"1": "density*velocity_1", "2": "density*velocity_2", "m": "density"})
    small([forces, integrals], walls=walls, **options).run(0.03)
    for i, g in (("1", 0.3), ("2", -1.0)):
        total = sum(forces.column(f"{wall}.force_{i}") for wall in ("left", "right", "bottom", "top"))
        rate = np.diff(integrals.column(i)) / 0.01
        assert abs(rate).max() > 1e-2
        assert total + rate == pytest.approx(integrals.column("m")[0] * g, abs=bound)
    assert forces.column("step").tolist() == [1, 2, 3]


def test_torque_on_a_curved_wall_balances_the_angular_momentum():
    """A spinning disc is braked by the friction of its wall, where v.n = 0 is held by a multiplier."""
    model = nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), viscosity=VISCOSITY)
    forces = nv.WallForces(about=(0, 0))
    spin = nv.Integrals({"L": "density*(x*velocity_2 - y*velocity_1)"})
    run = nv.Simulation(
        disc(1, 0.4),
        model,
        dt=0.01,
        initial=nv.Initial(velocity=(-0.1 * y, 0.1 * x)),
        walls={"wall": nv.NavierFriction(0.5)},
        observers=[forces, spin],
    )
    run.run(0.02)
    rate = np.diff(spin.column("L")) / 0.01
    assert forces.column("wall.torque") == pytest.approx(-rate, rel=1e-3)
    assert forces.column("wall.torque")[0] == pytest.approx(0.5 * 0.1 * 2 * math.pi, rel=0.1)


@pytest.mark.parametrize("axis", [nv.Slip(), nv.NoSlip()])
def test_a_straight_wall_bears_the_pressure_of_a_body_at_rest_up_to_its_ends_at_a_curved_wall(axis):
    """The axis of the half disc is 2 m long. The curved wall ends at both ends of the axis."""
    forces, K_e = nv.WallForces(), 10.0
    run = nv.Simulation(
        half_disc(1, 0.7),
        nv.Model(material=MATERIAL, viscosity=VISCOSITY, loads=[nv.Gravity((-1.0, 0.5))]),
        dt=0.02,
        walls={"axis": axis},
        initial=nv.Initial(density=1.0),
        observers=[forces],
    )
    ledger = run.run(0.04)
    for i in ("1", "2"):
        total = forces.column(f"axis.force_{i}") + forces.column(f"wall.force_{i}")
        impulse = -ledger.column(f"impulse_walls_{i}")[1:] / 0.02
        assert total == pytest.approx(impulse, abs=1e-6) and abs(impulse).min() > 1e-2
    at_rest = nv.Simulation(
        half_disc(1, 0.7), nv.Model(material=MATERIAL), dt=0.02, walls={"axis": axis}, observers=[forces]
    )
    at_rest.run(0.02)
    # epsilon adds 5e-4 Pa to the pressure of 1.5 K_e
    assert abs(forces.column("axis.force_1")[-1]) == pytest.approx(2 * 1.5 * K_e, rel=1e-4)


def test_forces_of_a_periodic_strip_of_one_cell_balance_its_momentum():
    """A cell that meets its own periodic image has one vertex twice. The shear stress does not depend on the
    length of the strip."""
    found = []
    for cells in (1, 2):
        forces = nv.WallForces(["top"])
        run = nv.Simulation(
            structured_box((0.5, 1), (cells, 2), periodic="x"),
            nv.Model(material=nv.LinearElastic(K_e=10.0, G_e=5.0), viscosity=VISCOSITY),
            dt=0.1,
            initial=nv.Initial(velocity=(0.1 * y, 0.0)),
            walls={"bottom": nv.NoSlip(), "top": nv.PrescribedTangential((0.1, 0.0))},
            observers=[forces],
        )
        ledger = run.run(0.2)
        found.append(forces.column("top.force_1"))
        assert abs(ledger.column("momentum_defect_1")).max() < 1e-14
        assert ledger.column("momentum_1")[-1] == pytest.approx(0.5 * 0.1 / 2, rel=1e-6)
    assert found[0] == pytest.approx(found[1], rel=1e-6)


def test_wall_forces_without_walls_are_refused():
    mesh = structured_box((1, 1), (2, 2), periodic=("x", "y"))
    with pytest.raises(nv.ParameterError, match=r"WallForces\.walls = 'no walls'"):
        nv.Simulation(mesh, nv.Model(material=MATERIAL), dt=0.01, observers=[nv.WallForces()]).run(0.01)


@pytest.mark.parametrize("size", [(1, 1), (1, 1, 1)])
def test_walls_have_their_own_pressures_up_to_corners(size):
    """A body is at rest between walls without slip: each wall bears T = phi I along its normal."""
    forces = nv.WallForces()
    mesh = box(size, 0.6)
    walls = dict.fromkeys(sorted(set(mesh.GetBoundaries())), nv.NoSlip())
    model = nv.Model(material=MATERIAL, viscosity=VISCOSITY)
    nv.Simulation(mesh, model, dt=0.01, walls=walls, observers=[forces]).run(0.01)
    tension = 3 * 5.0 + 0.1**2 / 20
    normals = {"left": (0, 1), "right": (0, -1), "bottom": (len(size) - 1, 1), "top": (len(size) - 1, -1)}
    for wall, (axis, sign) in normals.items():
        for i in range(len(size)):
            expected = sign * tension if i == axis else 0.0
            assert forces.column(f"{wall}.force_{i + 1}")[0] == pytest.approx(expected, abs=1e-11)
    assert all(abs(forces.column(name)[0]) < 8 for name in forces.columns if name.startswith("left.torque"))


def test_a_resumed_table_is_that_of_the_uninterrupted_run(tmp_path):
    def observed(place):
        return [
            nv.Probes({"p": (0.5, 0.5)}, ["velocity"], place / "p.csv", every=2),
            nv.WallForces(path=place / "f.csv"),
            nv.Checkpoints(place / "run.h5", every=1),
        ]

    small(observed(tmp_path / "whole")).run(0.04)
    small(observed(tmp_path / "parts")).run(0.03)
    # the header and the rows of steps 0, 2 and 3
    assert (tmp_path / "parts" / "p.csv").read_text().count("\n") == 4
    again = small(observed(tmp_path / "parts"))
    again.restore(tmp_path / "parts" / "run.h5")
    again.run(0.04)
    for name in ("p.csv", "f.csv"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_resuming_a_finished_run_keeps_the_forces_of_the_last_step(tmp_path, scheme):
    """The resumed run cannot compute these forces again, but the table has them."""

    def run():
        observers = [nv.WallForces(path=tmp_path / "f.csv", every=3), nv.Checkpoints(tmp_path / "run.h5")]
        return small(observers, scheme=scheme)

    run().run(0.02)
    before = (tmp_path / "f.csv").read_bytes()
    assert before.count(b"\n") == 2
    again = run()
    again.restore(tmp_path / "run.h5")
    again.run(0.02)
    assert (tmp_path / "f.csv").read_bytes() == before


@pytest.mark.parametrize(
    "text", ["step,time,p.J\n0,0,1\n", "step,time\nx\n", "", "step,time,p.velocity_1\n1,2\n"]
)
def test_a_foreign_or_damaged_table_is_refused(tmp_path, text):
    (tmp_path / "p.csv").write_text(text)
    run = small([nv.Probes({"p": (0.5, 0.5)}, ["velocity_1"], tmp_path / "p.csv")])
    run.set_time(0.01, 1)
    with pytest.raises(nv.CheckpointError, match=r"p\.csv"):
        run.run(0.02)

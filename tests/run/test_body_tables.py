"""Measures and pictures of bodies: sums equal the ledger, and resumed tables equal uninterrupted ones."""

import csv
import json
import re

import h5py
import numpy as np
import pytest
from ngsolve import Integrate, pi, sin, y

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.run.frames import outlined
from ngvisco.run.pictures import plot_fields
from ngvisco.run.scene import write_scene, write_scene_of_series

pytestmark = pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses")

STOKES = nv.StokesViscosity(K_v=0.02, G_v=0.01)


def bodies():
    return [
        nv.Body(
            name="fluid",
            material=nv.ReferentialNeoHookean(K_e=10.0, G_e=0.2),
            viscosity=STOKES,
            creep=nv.Creep(G_m=0.05),
            density=1.0,
        ),
        nv.Body(
            name="disc",
            where=nv.Ball((0.6, 0.5), 0.2),
            material=nv.ReferentialNeoHookean(K_e=10.0, G_e=2.0),
            viscosity=STOKES,
            density=2.0,
        ),
    ]


def simulation(*observers, maxh=0.25, m=1):
    model = nv.Model(bodies=bodies(), loads=[nv.Gravity((0, -1))])
    walls = {"top": nv.PrescribedTangential((0.5, 0))}
    return nv.Simulation(
        box((1, 1), maxh=maxh),
        model,
        dt=0.02,
        walls=walls,
        observers=observers,
        discretisation=nv.Discretisation(m=m),
    )


def rows_of(path):
    with path.open() as file:
        head, *rows = csv.reader(file)
    return head, np.array(rows, dtype=float)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    table = nv.Bodies(out / "bodies.csv")
    observers = [table, nv.VTKSeries(out / "vtk", every=2), nv.Checkpoints(out / "run.h5", every=2)]
    run = simulation(*observers)
    run.run(0.08)
    return out, table, run


def test_table_has_the_columns_of_each_body(whole):
    out, table, _ = whole
    head, rows = rows_of(out / "bodies.csv")
    assert head[:2] == ["step", "time"]
    wanted = ["mass", "volume", "x", "y", "momentum_x", "momentum_y", "kinetic", "stored", "dissipation"]
    wanted += ["x_min", "x_max", "y_min", "y_max", "smeared"]
    assert head[2:] == [f"{name}_{column}" for name in ("fluid", "disc") for column in wanted]
    assert rows[:, 1] == pytest.approx([0, 0.02, 0.04, 0.06, 0.08])
    assert rows == pytest.approx(np.array(table.rows), rel=1e-15)


def test_a_disc_starts_at_its_given_place(whole):
    _, table, _ = whole
    assert table.column("disc_volume")[0] == pytest.approx(0.04 * np.pi, rel=1e-3)
    assert table.column("disc_mass")[0] == pytest.approx(0.08 * np.pi, rel=1e-3)
    assert table.column("disc_x")[0] == pytest.approx(0.6, abs=0.01)
    assert table.column("disc_y")[0] == pytest.approx(0.5, abs=0.01)
    for end, exact in (("x_min", 0.4), ("x_max", 0.8), ("y_min", 0.3), ("y_max", 0.7)):
        assert table.column(f"disc_{end}")[0] == pytest.approx(exact, abs=0.07)  # cells are 0.25 m long
    assert table.column("disc_y")[-1] < 0.5 - 1e-4  # the disc is the heavier body


def test_mass_of_each_body_is_constant_and_volumes_fill_the_domain(whole):
    _, table, _ = whole
    for name in ("fluid", "disc"):
        mass = table.column(f"{name}_mass")
        assert abs(mass / mass[0] - 1).max() < 1e-12
    assert table.column("fluid_volume") + table.column("disc_volume") == pytest.approx(1, rel=1e-12)


def test_sums_over_bodies_equal_the_ledger(whole):
    _, table, run = whole
    ledger = run.ledger

    def total(quantity):
        return table.column(f"fluid_{quantity}") + table.column(f"disc_{quantity}")

    assert total("mass") == pytest.approx(ledger.column("mass"), rel=1e-12)
    assert total("kinetic") == pytest.approx(ledger.column("kinetic"), rel=1e-8, abs=1e-12)
    assert total("stored") == pytest.approx(ledger.column("stored"), rel=1e-10)
    assert (table.column("disc_dissipation")[1:] > 0).all()
    # m = 0: the limiter, which changes the state at the end of a step, changes constants by rounding only
    table = nv.Bodies()
    ledger = simulation(table, m=0).run(0.04)
    parts = ("stokes_bulk", "stokes_shear", "creep")
    lost = sum(ledger.column(f"dissipation_{of}") for of in parts)
    assert total("dissipation")[1:] == pytest.approx(lost[1:], rel=1e-6)


@pytest.mark.long
@pytest.mark.ci
def test_the_table_of_a_resumed_run_equals_that_of_the_whole_run(whole, tmp_path):
    out, _, _ = whole
    observers = [nv.Bodies(tmp_path / "bodies.csv"), nv.Checkpoints(tmp_path / "run.h5", every=2)]
    simulation(*observers).run(0.04)
    again = simulation(nv.Bodies(tmp_path / "bodies.csv"), nv.Checkpoints(tmp_path / "run.h5", every=2))
    again.restore(tmp_path / "run.h5")
    again.run(0.08)
    assert (tmp_path / "bodies.csv").read_bytes() == (out / "bodies.csv").read_bytes()


def test_run_file_has_the_table_with_units(whole):
    out, table, _ = whole
    with h5py.File(out / "run.h5") as file:
        group = file["bodies"]
        assert set(group) == set(table.columns)
        assert group["disc_x"][:] == pytest.approx(table.column("disc_x"))
        units = {name: data.attrs["unit"] for name, data in group.items()}
    assert units["disc_mass"] == "kg" and units["fluid_dissipation"] == "W" and units["time"] == "s"
    assert units["disc_momentum_x"] == "kg m/s" and units["disc_x_min"] == "m"


def test_fractions_and_numbers_of_bodies_are_fields(whole):
    _, table, run = whole
    fields, mesh = run.fields, run.mesh
    assert Integrate(fields["disc_fraction"], mesh) == pytest.approx(
        table.column("disc_volume")[-1], rel=1e-3
    )
    assert fields["body"](mesh(0.6, 0.45)) == 2
    assert fields["body"](mesh(0.1, 0.1)) == 1
    assert outlined(list(fields)) == ["fluid_fraction"]


def test_surfaces_are_drawn_in_pictures_and_scenes(whole, tmp_path):
    out, _, run = whole
    fields = run.fields
    lines = [fields[name] for name in outlined(list(fields))]
    for name, of in (("with", lines), ("without", [])):
        plot_fields(run.mesh, [("density", fields["density"])], tmp_path / f"{name}.png", outlines=of)
    assert (tmp_path / "with.png").read_bytes() != (tmp_path / "without.png").read_bytes()
    write_scene(run.mesh, {"density": fields["density"]}, tmp_path / "one.html", outlines=lines)
    write_scene_of_series(out / "vtk", tmp_path / "series.html")
    for name, states in (("one", 1), ("series", 3)):
        text = (tmp_path / f"{name}.html").read_text()
        data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])
        assert len(data["times"]) == states and len(data["outlines"]) == 1
        assert len(data["outlines"][0]["values"]) == len(data["fields"][0]["values"])


def test_a_passive_field_named_like_a_body_is_not_taken_for_a_body():
    """A passive field may have a name like a body's fraction. In lists of fields, fractions stand before the
    field ``body``."""
    passive, of_bodies = ["density", "dye_fraction", "pressure"], ["fluid_fraction", "disc_fraction", "body"]
    assert outlined([*passive, *of_bodies, "salt_fraction"]) == ["fluid_fraction"]
    assert outlined(passive) == []


def test_tractions_in_a_periodic_strip_are_the_same_on_one_cell_and_on_two():
    """Each cell of the narrow strip meets its own periodic image. The force does not depend on the length of
    the strip."""
    forces = []
    for cells in (1, 2):
        light, heavy = (nv.IsochoricNeoHookean(K_e=10.0, G_e=G_e) for G_e in (1.0, 2.0))
        bodies = [
            nv.Body(name="light", where=0.5 - y, material=light, density=1.0),
            nv.Body(name="heavy", material=heavy, density=2.0),
        ]
        table = nv.Bodies(None, measures=["traction"])
        run = nv.Simulation(
            structured_box((0.25 * cells, 1), (cells, 4), periodic="x"),
            nv.Model(bodies=bodies),
            dt=0.02,
            initial=nv.Initial(velocity=(0.1 * sin(pi * y), 0.02 * sin(pi * y))),
            observers=[table],
        )
        run.run(0.04)
        forces.append([table.column(f"light_force_{axis}")[-1] for axis in "xy"])
    assert 2 * np.array(forces[0]) == pytest.approx(np.array(forces[1]), rel=1e-9)

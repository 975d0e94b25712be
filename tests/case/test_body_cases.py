"""Bodies and varying moduli in case files: admitted values, refused values with their keys, and files of the
run."""

from pathlib import Path

import numpy as np
import pytest
from ngsolve import Integrate, pi
from support import by_ci

import ngvisco as nv
from ngvisco.case import reference, runs
from ngvisco.case.build import parse_case
from ngvisco.case.directory import RunDirectory
from ngvisco.case.faults import CaseError
from ngvisco.cli.main import main
from ngvisco.geometries import box
from ngvisco.physics.arrays import Array
from ngvisco.run.series import read_columns
from ngvisco.shapes.fractions import volumes
from ngvisco.sweep.study import Outcome

pytestmark = pytest.mark.filterwarnings("ignore:bodies .* meet with different stresses")

HEAD = """
[domain]
geometry = "box"
size = [1, 1]
maxh = 0.3
[time]
dt = 0.02
until = 0.04
"""
GRAVITY = """
[[loads]]
kind = "Gravity"
g = [0, -1]
[solver]
method = "split"
"""
BODIES = """
[[bodies]]
name = "fluid"
density = 1.0
material = { kind = "ReferentialNeoHookean", K_e = 10, G_e = 0.1, epsilon = 0.1 }
viscosity = { K_v = 0.0, G_v = 0.01 }
creep = { G_m = 0.01 }
[[bodies]]
name = "disc"
where = { kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }
density = 2.0
order = 1
viscosity = { K_v = 0.0, G_v = 0.01 }
[bodies.material]
kind = "ReferentialNeoHookean"
K_e = 10
G_e = 5
epsilon = 0.1
"""


def case(text=HEAD + BODIES, place=Path(".")):
    return parse_case(text, "case.toml", place)


def where_of(text):
    """The volume of the second body's place in the unit square."""
    given = BODIES.replace('{ kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }', text)
    place = case(HEAD + given).model(2).bodies[1].where
    return volumes(box((1, 1), maxh=0.1), [place])[0]


@pytest.mark.parametrize(
    ("text", "volume"),
    [
        ('"(x - 0.6)**2 + (y - 0.5)**2 < 0.04"', 0.04 * pi),
        ('"x < 0.25 or (x > 0.75 and y < 0.5)"', 0.375),
        ('{ kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }', 0.04 * pi),
        ('{ kind = "Block", low = [0, 0.5], high = [0.5, 1] }', 0.25),
        ('{ kind = "HalfSpace", point = [0, 0.3], normal = [0, 1] }', 0.3),
        ('{ kind = "Polygon", points = [[0.2, 0.2], [0.8, 0.2], [0.2, 0.8]] }', 0.18),
        (
            '[{ kind = "Block", low = [0, 0], high = [0.5, 1] }, { kind = "Block", low = [0.25, 0], '
            "high = [0.75, 1] }]",
            0.75,
        ),
        ('{ kind = "Subdomain", names = "default" }', 1.0),
    ],
)
def test_the_place_of_a_body_may_be_a_condition_a_shape_or_several_shapes(text, volume):
    assert where_of(text) == pytest.approx(volume, rel=1e-3)


def test_places_of_bodies_may_be_given_in_any_unit_of_length():
    text = HEAD.replace("[1, 1]", "[1e-3, 1e-3]").replace("0.3", "3e-4") + '[units]\nlength = "km"\n'
    for given in (
        '{ kind = "Ball", centre = [6e-4, 5e-4], radius = 2e-4 }',
        '{ kind = "Ball", centre = ["0.6 m", "0.5 m"], radius = "20 cm" }',
        '"(x - 6e-4)**2 + (y - 5e-4)**2 < 4e-8"',
    ):
        bodies = BODIES.replace('{ kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }', given)
        place = case(text + bodies).model(2).bodies[1].where
        assert volumes(box((1, 1), maxh=0.1), [place])[0] == pytest.approx(0.04 * pi, rel=1e-3)


def test_a_modulus_that_depends_on_place_is_carried_and_the_ledger_closes():
    material = '[material]\nkind = "ReferentialNeoHookean"\nK_e = "10 + 5*x"\nG_e = 1\nepsilon = 1\n'
    loaded = case(HEAD + material + '[units]\npressure = "kPa"\n[[loads]]\nkind = "Gravity"\ng = [0, -1]\n')
    mesh = loaded.mesh()
    run = loaded.simulation(mesh)
    (carried,) = [v for v in run.model.material.variables if v.name == "K_e"]
    # the modulus is carried by its logarithm, so that the mean is the geometric one
    assert Integrate(run.fields[carried.name], mesh) == pytest.approx(12_500, rel=1e-5)
    ledger = run.run(0.04)
    assert abs(ledger.column("closure_relative")).max() < 1e-12


def test_a_modulus_that_depends_on_z_is_refused_in_two_dimensions():
    material = '[material]\nkind = "ReferentialNeoHookean"\nK_e = "10 + 5*z"\nG_e = 1\nepsilon = 1\n'
    bodies = BODIES.replace("where = {", 'where = "z < 1" #')
    for text, fault in ((material, r"material.K_e: '10 \+ 5\*z'"), (bodies, r"bodies.1.where: 'z < 1'")):
        made = case(HEAD + text)
        with pytest.raises(CaseError, match=f"{fault}: expected a function of x and y, since .* has no z"):
            made.simulation(made.mesh())


@pytest.mark.long
@pytest.mark.ci
def test_a_run_directory_is_resumed_without_the_file_of_the_shape(tmp_path):
    """The directory has a copy of the file; mass, table and ledger continue from the checkpoint."""
    from matplotlib.image import imsave

    X, Y = np.meshgrid(np.linspace(0, 1, 100), np.linspace(1, 0, 100))
    dark = (X - 0.6) ** 2 + (Y - 0.5) ** 2 < 0.04
    imsave(tmp_path / "disc.png", np.where(dark, 0.0, 1.0)[..., None].repeat(3, axis=2))
    picture = 'where = { kind = "Image", path = "disc.png", low = [0, 0], high = [1, 1] } #'
    text = HEAD + BODIES.replace("where = {", picture) + GRAVITY
    loaded = case(text.replace("until = 0.04", "until = 0.02"), tmp_path)
    runs.run(loaded, tmp_path / "run")
    (tmp_path / "disc.png").unlink()
    for setting, message in [("bodies.1.density=3.0", "cannot change"), ("bodies.1.where='x < 1'", "cannot")]:
        with pytest.raises(CaseError, match=message):
            runs.resume(tmp_path / "run", until=0.04, settings=[setting])
    runs.resume(tmp_path / "run", until=0.04, settings=["bodies.1.viscosity.G_v=0.02"])
    rows = np.genfromtxt(tmp_path / "run" / "bodies.csv", delimiter=",", names=True)
    assert (np.diff(rows["time"]) > 0).all()
    assert rows["time"][[0, 1, -1]] == pytest.approx([0, 0.02, 0.04])
    assert rows["disc_mass"] == pytest.approx(rows["disc_mass"][0], rel=1e-12)
    assert rows["disc_y"][-1] < rows["disc_y"][0]
    results = nv.load(tmp_path / "run")
    assert abs(results.ledger["closure_relative"]).max() < 1e-10
    assert {"disc_fraction", "fluid_fraction", "body"} <= set(results.fields)


@pytest.mark.parametrize(
    "fields", [["density"], by_ci(["density", "fluid_fraction", "disc_fraction", "body"])]
)
def test_a_scene_has_outlines_of_bodies_whatever_fields_are_written(tmp_path, capsys, fields):
    output = f"[output.vtk]\nfields = {fields}\nsubdivision = 0\n"
    text = HEAD.replace("until = 0.04", "until = 0.02").replace("maxh = 0.3", "maxh = 0.5")
    runs.run(case(text + BODIES + output), tmp_path / "run")
    assert main(["scene", str(tmp_path / "run")]) == 0
    assert "no outlines of bodies" not in capsys.readouterr().err
    assert '"outlines": []' not in (tmp_path / "run" / "scene.html").read_text()


@pytest.mark.parametrize(
    ("where", "key", "message"),
    [
        (
            '{ kind = "Ball", centre = [6, 5], radius = 0.2 }',
            "bodies.1.where",
            "no cell has a part of this place",
        ),
        ('{ kind = "Ball", centre = [6, 5, 1], radius = 0.2 }', "bodies.1.where.centre", "2 coordinates"),
        (
            '{ kind = "Subdomain", names = "inclusion" }',
            "case.toml:18: bodies.1.where.names",
            "unknown subdomain 'inclusion'",
        ),
        (
            '[{ kind = "Ball", centre = [0, 0], radius = 1 }, { kind = "Subdomain", names = "a" }]',
            "case.toml:18: bodies.1.where.1.names",
            "unknown subdomain 'a'",
        ),
        (
            '{ kind = "ClosedSurface", path = "part.stl" }',
            "bodies.1.where.path: 'part.stl'",
            "closed surface",
        ),
        (
            '{ kind = "Image", path = "none.png", low = [0, 0], high = [1, 1] }',
            "bodies.1.where.path: 'none.png'",
            "readable",
        ),
    ],
)
def test_a_wrong_place_is_refused_before_anything_is_written(tmp_path, where, key, message):
    triangle = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    (tmp_path / "part.stl").write_text(
        f"solid a\nfacet\nouter loop\n{triangle}endloop\nendfacet\nendsolid a\n"
    )
    text = BODIES.replace('{ kind = "Ball", centre = [0.6, 0.5], radius = 0.2 }', where)
    with pytest.raises(CaseError) as caught:
        runs.run(case(HEAD + text, tmp_path), tmp_path / "run")
    assert key in str(caught.value)
    assert message in str(caught.value)
    assert not (tmp_path / "run").exists()


def test_a_fault_of_one_of_several_shapes_is_reported_with_the_line_of_this_shape():
    where = "".join(
        f'\n[[bodies.where]]\nkind = "Subdomain"\nnames = "{n}"' for n in ("default", "inclusion")
    )
    disc = HEAD + f'[[bodies]]\nname = "disc"\ndensity = 1.0{where}\n'
    loaded = case(
        disc + '[bodies.material]\nkind = "ReferentialNeoHookean"\nK_e = 1\nG_e = 1\nepsilon = 0.1\n'
    )
    line = 1 + disc.splitlines().index('names = "inclusion"')
    with pytest.raises(CaseError, match=rf"toml:{line}: bodies.0.where.1.names: unknown subdomain"):
        loaded.simulation(loaded.mesh())


def test_bodies_that_overlap_without_order_are_refused():
    third = '[[bodies]]\nname = "block"\nwhere = { kind = "Block", low = [0.5, 0.5], high = [0.9, 0.9] }\n'
    third += 'density = 1.0\norder = 1\nmaterial = { kind = "ReferentialNeoHookean", K_e = 9, G_e = 1 }\n'
    loaded = case(HEAD + BODIES + third)
    with pytest.raises(CaseError, match=r"bodies.2.order: 1: expected an order other than 1"):
        loaded.simulation(loaded.mesh())
    ordered = case(HEAD + BODIES + third.replace("order = 1", "order = 2"))
    assert ordered.simulation(ordered.mesh()).model.bodies[2].name == "block"


def test_keys_of_bodies_are_explained():
    assert "shear" in reference.explain("bodies.0.material.G_e")
    assert "condition" in reference.explain("bodies.0.where")
    assert "Centre" in reference.explain("bodies.1.where.centre")
    assert "kg/m^3" in reference.explain("bodies.N.density")
    with pytest.raises(nv.ParameterError, match="such as"):
        reference.explain("bodies.0.densty")


def test_each_body_of_a_case_has_heat_by_its_own_material_and_law():
    cold = '{ kind = "ReferentialNeoHookean", K_e = 10, G_e = 0.1, epsilon = 0.1 }'
    warm = cold[:-2] + ", thermal = { c = 3.0, theta_R = 300.0, expansion = 0.001 } }"
    text, disc = BODIES.replace(cold, warm).split("[bodies.material]\n")
    disc = (
        '[bodies.heat]\nconductivity = "0.5*theta"\nsource = "1 + x"\n[bodies.material]\n'
        "thermal = { c = 1.0, theta_R = 300.0 }\n" + disc
    )
    heat = '[rheology.heat]\nconductivity = 0.1\n[initial]\ntemperature = "310 + x"\n'
    model = case(HEAD + heat + text + disc).model(2)
    assert [body.material.c for body in model.bodies] == [3.0, 1.0]
    fluid, disc_alone = ({"n_fluid": a, "n_disc": b} for a, b in ((1.0, 0.0), (0.0, 1.0)))
    z = [{name: Array(np.array([value]), None) for name, value in one.items()} for one in (fluid, disc_alone)]
    theta = Array(np.array([300.0]), None)
    assert [float(model.heat_law.size(theta, one).value[0]) for one in z] == pytest.approx([0.1, 150.1])
    with pytest.raises(CaseError, match=r"bodies\.1\.heat\.conductivity: -1"):
        case(HEAD + heat + text + disc.replace('"0.5*theta"', "-1.0")).model(2)
    with pytest.raises(CaseError, match=r"bodies\.0\.material.*all bodies have one temperature"):
        case(HEAD + heat + text.replace(warm, cold) + disc).model(2)


@pytest.mark.long
@pytest.mark.ci
def test_keys_request_measures_and_contours_of_bodies(tmp_path):
    """The test checks columns of bodies.csv and of a study, outlines that a resumed run continues, and
    faults by their keys."""
    tables = '[output.bodies]\nmeasures = ["deformation"]\n[output.contours]\nbodies = ["disc"]\nevery = 1\n'
    text = HEAD + BODIES + tables
    runs.run(case(text), tmp_path / "whole")
    runs.run(case(text.replace("until = 0.04", "until = 0.02")), tmp_path / "parts")
    runs.resume(tmp_path / "parts", until=0.04)
    for name in (
        "bodies.csv",
        "contours/contours.csv",
        "contours/contours.pvd",
        "contours/contours_000002.vtu",
    ):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    runs.run(case(text.replace("every = 1", "every = 2")), tmp_path / "second")
    for run, count in (("whole", 3), ("second", 2)):
        assert len(list((tmp_path / run / "contours").glob("*.vtu"))) == count
    columns = read_columns(tmp_path / "whole" / "bodies.csv")
    assert abs(columns["disc_D"]).max() < 0.1 and "disc_perimeter" not in columns
    outcome = Outcome("whole", {})
    outcome.read(RunDirectory(tmp_path / "whole"), case(text))
    assert outcome.last["disc_D"] == columns["disc_D"][-1] and outcome.last["time"] == pytest.approx(0.04)
    for wrong, said in (
        (text.replace('"disc"]', '"disk"]'), "output.contours.bodies: .*'disk'.*'disc'"),
        (text.replace('"deformation"', '"gap"'), "output.bodies.measures: .*two bodies"),
        (text.replace('"deformation"', '"deform"'), "output.bodies.measures"),
    ):
        with pytest.raises(CaseError, match=said):
            case(wrong).simulation(box((1, 1), 0.5))

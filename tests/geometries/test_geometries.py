"""Geometries: their measure, walls and cells, and faulty files."""

import math

import numpy as np
import pytest
from netgen.occ import Axis, Box, Circle, Pnt, Rectangle, X
from ngsolve import BND, CF, ET, VERTEX, Integrate, IntegrationRule, x, y, z

from ngvisco import MeshError, ParameterError
from ngvisco import geometries as g

CASES = {
    "box": (lambda: g.box((1, 2), 0.5), 2.0, {"left", "right", "bottom", "top"}),
    "channel": (lambda: g.channel(2, 1, 0.5), 2.0, {"left", "right", "bottom", "top"}),
    "bar3d": (lambda: g.bar(2, 0.5, 0.5, dim=3), 0.5, {"left", "right", "front", "back", "bottom", "top"}),
    "hole": (
        lambda: g.block_with_hole((2, 1), 0.25, 0.3),
        2 - math.pi / 16,
        {"left", "right", "bottom", "top", "hole"},
    ),
    "hole3d": (
        lambda: g.block_with_hole((2, 0.5, 1), 0.25, 0.5),
        1 - math.pi / 32,
        {"left", "right", "front", "back", "bottom", "top", "hole"},
    ),
    "disc": (lambda: g.disc(2, 0.8), 4 * math.pi, {"wall"}),
    "half": (lambda: g.half_disc(2, 0.8), 2 * math.pi, {"wall", "axis"}),
    "annulus": (lambda: g.annulus(1, 2, 0.5), 3 * math.pi, {"inner", "outer"}),
    "cylinder": (lambda: g.cylinder(1, 2, 0.8), 2 * math.pi, {"side", "bottom", "top"}),
    "sphere": (lambda: g.sphere(1, 0.6), 4 / 3 * math.pi, {"wall"}),
    "shell": (lambda: g.spherical_shell(0.5, 1, 0.5), 7 / 6 * math.pi, {"inner", "outer"}),
}


@pytest.mark.parametrize("name", CASES)
def test_measure_and_walls_are_those_of_the_domain(name):
    """Polygons and polyhedra miss the measure of round domains by per cents, so that the cells must be
    curved."""
    make, measure, walls = CASES[name]
    mesh = make()
    assert Integrate(CF(1.0), mesh) == pytest.approx(measure, rel=2e-3)
    assert set(mesh.GetBoundaries()) == walls
    for wall in walls:
        assert Integrate(CF(1.0), mesh, BND, definedon=mesh.Boundaries(wall)) > 0


SIZES = [1e-12, 2e-3, 6e5, 1e12]
SCALED = {
    "box": lambda L: g.box((L, 2 * L), L / 2, periodic="x", refine={"top": L / 4}),
    "channel3d": lambda L: g.channel(L, L, L, width=L),
    "bar": lambda L: g.bar(2 * L, L / 2, L / 2),
    "hole": lambda L: g.block_with_hole((2 * L, L), L / 4, L / 3, fillet=L / 10),
    "annulus": lambda L: g.annulus(L, 2 * L, L / 2),
    "shell": lambda L: g.spherical_shell(L, 2 * L, 2 * L),
}


@pytest.mark.parametrize("name", SCALED)
def test_a_domain_is_the_same_in_every_unit_of_length(name):
    """Netgen ended the process for squares of 6e5 m, and small squares lost their walls."""
    unit = SCALED[name](1.0)
    straight = name in ("box", "channel3d", "bar")
    sizes = SIZES if straight else SIZES[1:]
    for size in sizes if unit.dim == 2 else (sizes[0], sizes[-1]):
        mesh = SCALED[name](size)
        assert sorted(mesh.GetBoundaries()) == sorted(unit.GetBoundaries())
        volume = Integrate(CF(1.0), mesh) / size**mesh.dim
        assert volume == pytest.approx(Integrate(CF(1.0), unit), rel=1e-12 if straight else 3e-3)
        g.refine_walls(mesh, [mesh.GetBoundaries()[0]])
        refined = Integrate(CF(1.0), mesh) / size**mesh.dim
        assert refined == pytest.approx(volume, rel=1e-12 if straight else 3e-3)


def test_a_mesh_that_may_crash_netgen_is_made_in_another_process():
    mesh = g.box((1, 5e-4), 0.5)
    assert Integrate(CF(1.0), mesh) == pytest.approx(5e-4, rel=1e-10)
    from ngvisco.geometries import meshing

    with pytest.raises(MeshError, match="Netgen cannot mesh the shape"):
        shape = Circle((0, 0), 1).Face() - Circle((0, 0), 2).Face()  # the larger circle leaves no shape
        meshing.try_shape("shape", shape, 2, 0.5)


@pytest.mark.parametrize("periodic", ["x", "y", "xy", "xyz"])
def test_boundaries_of_a_periodic_box_are_identified_in_pairs(periodic):
    from ngvisco.forms.boundary.boundaries import periodic_boundaries

    mesh = g.box((1, 1, 1) if "z" in periodic else (1, 1), 0.6, periodic=periodic)
    planes = {"x": {"left", "right"}, "y": {"bottom", "top"}}
    if mesh.dim == 3:
        planes |= {"y": {"front", "back"}, "z": {"bottom", "top"}}
    assert periodic_boundaries(mesh) == set().union(*(planes[axis] for axis in periodic))


def test_refinement_is_local():
    coarse, fine = g.annulus(1, 2, 0.5), g.annulus(1, 2, 0.5, refine={"inner": 0.1})
    edges = [
        sum(e.mat == name for e in m.Elements(BND)) for m in (coarse, fine) for name in ("inner", "outer")
    ]
    assert edges[2] > 2.5 * edges[0] and edges[3] < 1.5 * edges[1]


@pytest.mark.parametrize(
    ("make", "wall"),
    [(lambda: g.disc(1, 0.5), "wall"), (lambda: g.box((1, 1, 1), 1.0), "bottom")],
    ids=["2D", "3D"],
)
def test_boundary_layer_is_bisected_towards_the_wall(make, wall):
    """Each bisection halves the height of the cells at the wall, with fewer new cells than a bisection of all
    cells."""

    def height(mesh):
        """Mean height over the wall of the cells that have a facet on it."""
        areas = np.array(Integrate(CF(1.0), mesh, BND, element_wise=True))
        volumes = np.array(Integrate(CF(1.0), mesh, element_wise=True))
        kind = (lambda e: e.edges) if mesh.dim == 2 else (lambda e: e.faces)
        owner = {f.nr: e.nr for e in mesh.Elements() for f in kind(e)}
        on_wall = [e for e in mesh.Elements(BND) if e.mat == wall]
        return np.mean([mesh.dim * volumes[owner[kind(e)[0].nr]] / areas[e.nr] for e in on_wall])

    meshes = [make() for _ in range(3)]
    for times, mesh in enumerate(meshes[1:], start=1):
        g.refine_walls(mesh, wall, times=times)
    heights = [height(mesh) for mesh in meshes]
    assert heights[1] == pytest.approx(heights[0] / 2, rel=0.1)
    assert heights[2] == pytest.approx(heights[0] / 4, rel=0.15)
    assert meshes[2].ne < 0.75 * meshes[0].ne * 4 ** meshes[0].dim


def test_boundary_layer_stays_round():
    mesh = g.disc(1, 0.5)
    before = mesh.ne
    assert g.refine_walls(mesh, "wall", times=2).ne > 3 * before
    assert Integrate(CF(1.0), mesh) == pytest.approx(math.pi, rel=1e-5)


MSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
2
1 1 "wall"
2 2 "body"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
$EndNodes
$Elements
6
1 1 2 1 1 1 2
2 1 2 1 1 2 3
3 1 2 1 1 3 4
4 1 2 1 1 4 1
5 2 2 2 1 1 2 3
6 2 2 2 1 1 3 4
$EndElements
"""


def test_meshes_and_shapes_are_read_from_files(tmp_path):
    mesh = g.box((1, 2), 0.5)
    mesh.ngmesh.Save(str(tmp_path / "box.vol"))
    loaded = g.load(tmp_path / "box.vol")
    assert loaded.ne == mesh.ne and set(loaded.GetBoundaries()) == set(mesh.GetBoundaries())
    (tmp_path / "square.msh").write_text(MSH)
    assert Integrate(CF(1.0), g.load(tmp_path / "square.msh")) == pytest.approx(1.0)
    solid = Box(Pnt(0, 0, 0), Pnt(1, 1, 2))
    solid.WriteStep(str(tmp_path / "part.step"))
    assert Integrate(CF(1.0), g.load(tmp_path / "part.step", maxh=1.0)) == pytest.approx(2.0)


@pytest.mark.parametrize("name", ["box.vol", "square.msh", "part.step", "part.brep"])
def test_files_missing_or_cut_short_raise(name, tmp_path):
    path = tmp_path / name
    with pytest.raises(MeshError, match="this file does not exist"):
        g.load(path, maxh=1.0)
    path.write_text("")
    with pytest.raises(MeshError, match="cut short"):
        g.load(path, maxh=1.0)
    whole = tmp_path / ("whole" + path.suffix)
    if name == "box.vol":
        g.box((1, 2), 0.5).ngmesh.Save(str(whole))
    elif name == "square.msh":
        whole.write_text(MSH)
    else:
        solid = Box(Pnt(0, 0, 0), Pnt(1, 1, 2))
        (solid.WriteStep if name.endswith("step") else solid.WriteBrep)(str(whole))
    text = whole.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(MeshError):
        g.load(path, maxh=1.0)


def test_a_sheet_in_the_plane_gives_a_curved_mesh_in_2d(tmp_path):
    sheet = Rectangle(2, 1).Face() - Circle((1, 0.5), 0.3).Face()
    path = tmp_path / "sheet.brep"
    sheet.WriteBrep(str(path))
    mesh = g.load(path, maxh=0.3)
    assert mesh.dim == 2
    assert Integrate(CF(1.0), mesh) == pytest.approx(2 - 0.09 * math.pi, rel=5e-5)


def test_a_surface_outside_the_plane_is_refused_as_a_geometry(tmp_path):
    Rectangle(1, 1).Face().Rotate(Axis(Pnt(0, 0, 0), X), 30).WriteStep(str(tmp_path / "tilted.step"))
    with pytest.raises(MeshError, match="faces in the plane z = 0"):
        g.load(tmp_path / "tilted.step", maxh=0.5)
    with pytest.raises(ParameterError, match="maxh"):
        g.load(tmp_path / "tilted.step")


@pytest.mark.parametrize("size", [(2.0, 0.5), (2.0, 0.5, 0.25)])
def test_structured_box_has_graded_rows_and_the_walls_of_a_box(size):
    cells = (8, 2, 2)[: len(size)]
    mesh = g.structured_box(size, cells, grading={"x": 4.0})
    assert mesh.ne == 32 * (1 if len(size) == 2 else 6)
    assert pytest.approx(math.prod(size)) == Integrate(CF(1.0), mesh)
    walls = dict(zip(("left", "right", "front", "back", "bottom", "top"), range(6), strict=True))
    if len(size) == 2:
        walls = dict(zip(("left", "right", "bottom", "top"), range(4), strict=True))
    assert set(mesh.GetBoundaries()) == set(walls)
    place = CF((x, y, z))
    for name, number in walls.items():
        axis, end = number // 2, number % 2
        assert np.ptp(_on(mesh, name, place)[:, axis]) < 1e-12
        assert _on(mesh, name, place)[0, axis] == pytest.approx(end * size[axis])
    lines = np.unique(np.round([v.point[0] for v in mesh.vertices], 9))
    rows = np.diff(lines)
    assert len(rows) == 8 and rows[-1] / rows[0] == pytest.approx(4.0)
    assert rows[1:] / rows[:-1] == pytest.approx(np.full(7, 4 ** (1 / 7)))


def _on(mesh, name, place):
    """Values at points of a wall."""
    shape = ET.SEGM if mesh.dim == 2 else ET.TRIG
    region = mesh.Boundaries(name)
    return np.asarray(place(mesh.MapToAllElements({shape: IntegrationRule(shape, 2)}, region)))


@pytest.mark.parametrize("periodic", [(), ("x",), ("x", "y")])
def test_crossed_rectangles_are_four_triangles_of_one_area(periodic):
    mesh = g.structured_box((2, 1), (4, 3), periodic=periodic, crossed=True)
    areas = np.array(Integrate(CF(1.0), mesh, element_wise=True))
    assert mesh.ne == 48 and mesh.nv == 20 + 12 and np.allclose(areas, 2 / 48)
    assert set(mesh.GetBoundaries()) == {"left", "right", "top", "bottom"}
    assert len(mesh.GetPeriodicNodePairs(VERTEX)) == 4 * ("x" in periodic) + 5 * ("y" in periodic)


def test_crossed_cuboids_are_refused():
    with pytest.raises(ParameterError, match="crossed"):
        g.structured_box((1, 1, 1), (2, 2, 2), crossed=True)

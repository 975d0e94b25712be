"""Cells in corners are found and divided, and no other cell changes."""

from itertools import pairwise

import pytest
from netgen.occ import Circle, Glue, OCCGeometry, Rectangle
from ngsolve import CF, VERTEX, Integrate, Mesh
from ngsolve.meshes import MakeStructured2DMesh

from ngvisco import ParameterError
from ngvisco import geometries as g
from ngvisco.errors import NgviscoError
from ngvisco.geometries.meshing import corner_cells


def of_two_parts():
    face = Rectangle(1, 1).Face()
    face.edges.name = "wall"
    inner = Circle((0.5, 0.5), 0.3).Face()
    inner.faces.name, rest = "inner", face - inner
    rest.faces.name = "outer"
    return Mesh(OCCGeometry(Glue([inner, rest]), dim=2).GenerateMesh(maxh=0.2)).Curve(3)


MESHES = {
    "box": lambda: g.box((1, 1), 0.3),
    "box3d": lambda: g.box((1, 1, 1), 0.5),
    "rows": lambda: g.structured_box((1, 1), (3, 3)),
    "rows3d": lambda: g.structured_box((1, 1, 1), (2, 2, 2), periodic="x"),
    "hole": lambda: g.block_with_hole((2, 1), 0.25, 0.4),
    "cylinder": lambda: g.cylinder(1, 1, 0.8),
    "parts": of_two_parts,
}


def walls_of(mesh):
    return {name: Integrate(CF(1.0), mesh.Boundaries(name)) for name in set(mesh.GetBoundaries())}


@pytest.mark.parametrize("name", MESHES)
def test_division_leaves_no_cell_in_a_corner_and_keeps_the_domain(name):
    mesh = MESHES[name]()
    cells, count, order = corner_cells(mesh), mesh.ne, mesh.GetCurveOrder()
    parts = {part: Integrate(CF(1.0), mesh.Materials(part)) for part in mesh.GetMaterials()}
    walls, pairs = walls_of(mesh), len(mesh.GetPeriodicNodePairs(VERTEX))
    assert cells
    divided = g.split_corner_cells(mesh)
    assert not corner_cells(divided)
    assert divided.ne == count + mesh.dim * len(cells)
    assert divided.GetCurveOrder() == order
    assert len(divided.GetPeriodicNodePairs(VERTEX)) == pairs
    assert walls_of(divided) == pytest.approx(walls)
    now = {part: Integrate(CF(1.0), divided.Materials(part)) for part in divided.GetMaterials()}
    assert now == pytest.approx(parts)


def test_identified_boundaries_are_not_walls():
    assert len(corner_cells(g.structured_box((1, 1), (3, 3)))) == 2
    assert not corner_cells(g.structured_box((1, 1), (3, 3), periodic="x"))


def test_quadrilaterals_become_triangles():
    divided = g.split_corner_cells(MakeStructured2DMesh(quads=True, nx=3, ny=3))
    assert divided.ne == 9 + 4 * 3
    assert Integrate(CF(1.0), divided) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda split: g.box((1, 1), 0.3, split_corners=split),
        lambda split: g.channel(1, 1, 0.5, split_corners=split),
        lambda split: g.bar(1, 0.5, 0.3, split_corners=split),
        lambda split: g.block_with_hole((2, 1), 0.25, 0.4, split_corners=split),
        lambda split: g.cylinder(1, 1, 0.8, split_corners=split),
        lambda split: g.structured_box((1, 1), (3, 3), split_corners=split),
        lambda split: g.structured_box((1, 1, 1), (2, 2, 2), split_corners=split),
    ],
)
def test_geometries_divide_corner_cells_on_request(make):
    assert not corner_cells(make(True))
    with pytest.raises(ParameterError, match="split_corners"):
        make("yes")


def test_corner_cells_of_a_mesh_file_are_divided_on_request(tmp_path):
    g.box((1, 1), 0.3).ngmesh.Save(str(tmp_path / "box.vol"))
    assert corner_cells(g.load(tmp_path / "box.vol"))
    assert not corner_cells(g.load(tmp_path / "box.vol", split_corners=True))


def spans(mesh, wall):
    """Lengths of the edges on a wall of the unit box, along x, m."""
    at = sorted({mesh[v].point[0] for e in mesh.Boundaries(wall).Elements() for v in e.vertices})
    return [b - a for a, b in pairwise(at)]


def test_cells_at_the_corners_of_a_lid_are_halved_and_others_stay():
    plain = g.structured_box((1, 1), (4, 4), split_corners=True)
    fine = g.structured_box((1, 1), (4, 4), split_corners=True, refine_corners={"top": 3})
    assert spans(fine, "top")[0] == spans(fine, "top")[-1] == pytest.approx(0.25 / 2**3)
    assert spans(fine, "bottom") == pytest.approx([0.25] * 4)
    assert walls_of(fine) == pytest.approx(walls_of(plain))
    assert plain.ne < fine.ne < plain.ne + 80 and not corner_cells(fine)


def test_identified_boundaries_make_no_corners():
    periodic = {"cells": (4, 4), "periodic": "x"}
    fine = g.structured_box((1, 1), **periodic, refine_corners={"top": 2})
    assert fine.ne == g.structured_box((1, 1), **periodic).ne


@pytest.mark.parametrize(
    ("walls", "said"),
    [(["top"], "mapping"), ({"top": -1}, "top.*>= 0"), ({"top": 1.5}, "top.*>= 0"), ({"lid": 1}, "lid")],
)
def test_corners_of_an_unknown_wall_are_refused(walls, said):
    with pytest.raises(NgviscoError, match=said):
        g.refine_corners(g.structured_box((1, 1), (2, 2)), walls)

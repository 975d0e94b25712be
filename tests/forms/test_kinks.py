"""Straight facets on curved slip walls are refused; curved cells, corners and declared polyhedra pass."""

import netgen.occ as occ
import numpy as np
import pytest
from ngsolve import Mesh, x, y
from ngsolve.meshes import MakeStructured2DMesh

import ngvisco as nv
from ngvisco.forms.boundary.boundaries import require_curved_cells, walls_of
from ngvisco.forms.boundary.walls import Walls
from ngvisco.geometries import annulus, block_with_hole, box, cylinder, disc, load, sphere, spherical_shell


def polygon(corners: int, maxh: float) -> Mesh:
    """A regular polygon in the unit circle, all of whose sides are ``wall``."""
    angles = 2 * np.pi * np.arange(corners) / corners
    path = occ.WorkPlane().MoveTo(1, 0)
    for angle in angles[1:]:
        path = path.LineTo(np.cos(angle), np.sin(angle))
    face = path.LineTo(1, 0).Face()
    face.edges.name = "wall"
    return Mesh(occ.OCCGeometry(face, dim=2).GenerateMesh(maxh=maxh))


def one_name(mesh: Mesh) -> Mesh:
    for nr in range(len(set(mesh.ngmesh.GetBCName(i) for i in range(len(mesh.GetBoundaries()))))):
        mesh.ngmesh.SetBCName(nr, "wall")
    return Mesh(mesh.ngmesh)


UNCURVED = {
    "disc": (lambda: disc(1, 0.5, order=1), "wall"),
    "fine disc": (lambda: disc(1, 0.05, order=1), "wall"),
    "annulus": (lambda: annulus(1, 2, 1, order=1), "inner"),
    "hole": (lambda: block_with_hole((1, 1), 0.25, 0.5, order=1), "hole"),
    "sphere": (lambda: sphere(1, 1, order=1), "wall"),
    "shell": (lambda: spherical_shell(0.5, 1, 1, order=1), "inner"),
    "cylinder": (lambda: cylinder(1, 1, 1, order=1), "side"),
}


@pytest.mark.parametrize("name", UNCURVED)
def test_straight_facets_of_a_curved_wall_are_refused(name):
    mesh, wall = UNCURVED[name][0](), UNCURVED[name][1]
    with pytest.raises(nv.MeshError, match=rf"wall '{wall}' is bent by .*straight"):
        Walls(mesh)


def test_a_fixed_wall_may_be_a_polygon():
    """v = 0 has no wrong limit."""
    Walls(disc(1, 0.5, order=1), {"wall": nv.NoSlip()})
    Walls(annulus(1, 2, 1, order=1), {"inner": nv.NoSlip(), "outer": nv.PrescribedTangential((-y, x))})


@pytest.mark.parametrize(
    "wall", [nv.Slip(), nv.NavierFriction(1.0), nv.Traction(f=(-y, x))], ids=lambda wall: type(wall).__name__
)
def test_a_polygon_has_to_be_declared(wall):
    mesh = polygon(8, 0.3)
    with pytest.raises(nv.MeshError, match="45 degrees"):
        Walls(mesh, {"wall": wall})
    declared = {"Slip": nv.Slip(straight=True), "NavierFriction": nv.NavierFriction(1.0, straight=True)}
    traction = nv.Traction(f=(-y, x), straight=True)
    Walls(mesh, {"wall": declared.get(type(wall).__name__, traction)})


@pytest.mark.parametrize("mesh", [lambda: polygon(5, 0.5), lambda: polygon(6, 2.0)], ids=["5", "6"])
def test_corners_of_60_degrees_and_more_pass(mesh):
    Walls(mesh())


@pytest.mark.parametrize(("order", "refined"), [(2, 0), (3, 0), (3, 1)])
@pytest.mark.parametrize("name", [n for n in UNCURVED if n != "fine disc"])
def test_curved_cells_pass(name, order, refined):
    """Also on a mesh that was refined, whose facets have other numbers as edges or faces."""
    make, wall = UNCURVED[name]
    mesh = make()
    for _ in range(refined):
        mesh.Refine()
    mesh.Curve(order)
    require_curved_cells(mesh, {wall: walls_of(mesh, [wall])})


def test_a_box_whose_sides_have_one_name_passes():
    for mesh in (box((1, 2), 0.5), box((1, 2, 1), 1)):
        renamed = one_name(mesh)
        require_curved_cells(renamed, {"wall": walls_of(renamed, ["wall"])})


def test_curving_without_a_geometry_does_not_help():
    """The order of the cells says nothing: they stay straight where no geometry is known."""
    mesh = MakeStructured2DMesh(
        quads=False, nx=8, ny=4, mapping=lambda s, t: (s, t * (1 + 0.2 * np.sin(3 * s)))
    )
    mesh.Curve(3)
    with pytest.raises(nv.MeshError, match="'top'"):
        Walls(mesh)


def test_a_mesh_file_keeps_what_it_is(tmp_path):
    for order in (1, 3):
        disc(1, 0.5, order=order).ngmesh.Save(str(tmp_path / f"{order}.vol"))
    Walls(load(tmp_path / "3.vol"))
    with pytest.raises(nv.MeshError, match="'wall' is bent"):
        Walls(load(tmp_path / "1.vol"))

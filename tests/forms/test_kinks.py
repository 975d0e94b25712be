"""Corners and bends of walls: slip on straight facets, div v of corner cells, refused walls."""

import warnings

import netgen.occ as occ
import numpy as np
import pytest
from ngsolve import Mesh, x, y

import ngvisco as nv
from ngvisco.forms.boundary.boundaries import require_curved_cells, walls_of
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.start.data_checks import warn_of_corners
from ngvisco.geometries import (
    annulus,
    block_with_hole,
    box,
    cylinder,
    disc,
    sphere,
    spherical_shell,
    split_corner_cells,
    structured_box,
)
from tests.verification.setups import lid_driven


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
    """The condition v = 0 does not depend on normals, so that polygons have the right limit."""
    Walls(disc(1, 0.5, order=1), {"wall": nv.NoSlip()})
    Walls(annulus(1, 2, 1, order=1), {"inner": nv.NoSlip(), "outer": nv.PrescribedTangential((-y, x))})


@pytest.mark.parametrize(
    "wall", [nv.Slip(), nv.NavierFriction(1.0), nv.Traction(f=(-y, x))], ids=lambda wall: type(wall).__name__
)
def test_a_polygonal_wall_has_to_be_declared(wall):
    mesh = polygon(8, 0.3)
    with pytest.raises(nv.MeshError, match="45 degrees"):
        Walls(mesh, {"wall": wall})
    declared = {"Slip": nv.Slip(straight=True), "NavierFriction": nv.NavierFriction(1.0, straight=True)}
    traction = nv.Traction(f=(-y, x), straight=True)
    Walls(mesh, {"wall": declared.get(type(wall).__name__, traction)})


@pytest.mark.parametrize("wall", [nv.Slip(straight=True), nv.Traction(f=(-y, x), straight=True)])
@pytest.mark.parametrize("mesh", [lambda: polygon(5, 0.5), lambda: disc(1, 0.5)], ids=["corners", "curved"])
def test_a_wall_declared_as_a_polygon_that_is_none_is_refused(mesh, wall):
    """On such a wall, the declaration would have no effect."""
    with pytest.raises(
        nv.ParameterError, match=r"walls\['wall'\]\.straight = True: expected False, .* not bent"
    ):
        Walls(mesh(), {"wall": wall})


@pytest.mark.parametrize("mesh", [lambda: polygon(5, 0.5), lambda: polygon(6, 2.0)], ids=["5", "6"])
def test_corners_of_60_degrees_and_more_are_accepted(mesh):
    Walls(mesh())


@pytest.mark.parametrize(("order", "refined"), [(2, 0), (3, 0), (3, 1)])
@pytest.mark.parametrize("name", [n for n in UNCURVED if n != "fine disc"])
def test_curved_cells_are_accepted(name, order, refined):
    """Curved cells pass also on a refined mesh, whose facets have other numbers than edges or faces."""
    make, wall = UNCURVED[name]
    mesh = make()
    for _ in range(refined):
        mesh.Refine()
    mesh.Curve(order)
    require_curved_cells(mesh, {wall: walls_of(mesh, [wall])})


def test_a_box_whose_sides_have_one_name_is_accepted():
    for mesh in (box((1, 2), 0.5), box((1, 2, 1), 1)):
        renamed = one_name(mesh)
        require_curved_cells(renamed, {"wall": walls_of(renamed, ["wall"])})


def cavity(mesh, lid, **options):
    fluid, velocity = nv.BarotropicFluid(B=20.0, gamma=1.4), (lid, 0.0, 0.0)[: mesh.dim]
    return lid_driven(mesh, fluid, lid=velocity, mu=0.0, dt=0.05, **options)


def warnings_of(run, until):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        run.run(until)
    return [str(one.message) for one in said if one.category is nv.InputWarning]


def test_a_fast_lid_in_a_corner_cell_is_reported_with_its_rate():
    """In cells of 0.25 m, the lid's velocity falls from 1 m/s to 0 along one cell."""
    (said,) = warnings_of(cavity(structured_box((1, 1), (4, 4)), 1.0), 0.3)
    assert "div v = -4 1/s at (1, 1) m" in said or "div v = 4 1/s at (0, 1) m" in said
    assert "split_corners" in said


def test_short_runs_slow_corners_and_divided_cells_bring_no_warning():
    mesh = structured_box((1, 1), (4, 4))
    assert not warnings_of(cavity(mesh, 1.0), 0.1)  # the density grows by less than the factor e
    assert not warnings_of(cavity(mesh, 0.1 * 16 * x**2 * (1 - x) ** 2), 0.1)
    assert not warnings_of(cavity(split_corner_cells(mesh), 1.0), 0.3)


def test_corners_of_tetrahedra_are_reported():
    mesh = structured_box((1, 1, 1), (2, 2, 2))
    run = cavity(mesh, 1.0)
    with pytest.warns(nv.InputWarning, match="div v"):
        warn_of_corners(run.rothe_step, [0.0, 1.0])
    run = cavity(split_corner_cells(mesh), 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_corners(run.rothe_step, [0.0, 1.0])


@pytest.mark.long
@pytest.mark.ci
def test_split_corner_cells_bound_the_density_under_a_lid():
    """In the corner cell of 0.33 m under the lid, the density grows by the factor e in 0.33 s."""
    change = {}
    for split in (False, True):
        run = cavity(structured_box((1, 1), (3, 3), split_corners=split), 1.0)
        run.run(0.5)
        density = run.sampler.values(run.fields["density"])
        change[split] = np.abs(density - 1).max()
        assert np.abs(run.ledger.column("closure_relative")).max() < 1e-10
    assert change[False] > 1 > 0.4 > change[True]

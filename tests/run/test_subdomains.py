"""Meshes with subdomains: an interface between cells changes nothing, whatever its name is."""

import netgen.occ as occ
import numpy as np
import pytest
from netgen.meshing import Element1D, Element2D, Element3D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import BND, VOL, Mesh

import ngvisco as nv
from ngvisco.forms.boundary.boundaries import interior_boundaries, walls_of

SIDES = {
    2: {"left": -occ.X, "right": occ.X, "bottom": -occ.Y, "top": occ.Y},
    3: dict(left=-occ.X, right=occ.X, front=-occ.Y, back=occ.Y, bottom=-occ.Z, top=occ.Z),
}


def with_inclusion(dim, interface, maxh):
    """A box with a smaller one in it, at a wall in the plane, whose sides are called ``interface``."""
    if dim == 2:
        whole, inner = occ.Rectangle(1, 1).Face(), occ.MoveTo(0.3, 0).Rectangle(0.4, 0.5).Face()
    else:
        whole = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(1, 1, 1))
        inner = occ.Box(occ.Pnt(0.3, 0.3, 0.3), occ.Pnt(0.7, 0.7, 0.7))
    sides = (whole.edges, inner.edges) if dim == 2 else (whole.faces, inner.faces)
    for name, direction in SIDES[dim].items():
        sides[0].Max(direction).name = name
    sides[1].name = interface
    if dim == 2:
        inner.edges.Min(occ.Y).name = "bottom"
    (inner.faces if dim == 2 else inner.solids).name = "inclusion"
    outer = whole - inner
    (outer.faces if dim == 2 else outer.solids).name = "matrix"
    geometry = occ.OCCGeometry(occ.Glue([outer, inner]), dim=dim)
    return Mesh(geometry.GenerateMesh(maxh=maxh, parallel_meshing=False))


def without_interfaces(mesh):
    """The same cells in one domain, with the outer walls only."""
    plain = NetgenMesh(dim=mesh.dim)
    points = [(*v.point, 0.0)[:3] for v in mesh.vertices]
    numbers = [plain.Add(MeshPoint(Pnt(*point))) for point in points]
    names = sorted(SIDES[mesh.dim])
    for i, name in enumerate(names):
        if mesh.dim == 3:
            plain.Add(FaceDescriptor(surfnr=i + 1, domin=1, domout=0, bc=i + 1))
        plain.SetBCName(i, name)
    if mesh.dim == 2:
        plain.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    for cell in mesh.Elements(VOL):
        corners = [numbers[v.nr] for v in cell.vertices]
        plain.Add(Element2D(1, corners) if mesh.dim == 2 else Element3D(1, corners))
    for name in names:
        for facet in walls_of(mesh, [name]).Elements():
            corners = [numbers[v.nr] for v in facet.vertices]
            index = names.index(name) + 1
            plain.Add(Element1D(corners, index=index) if mesh.dim == 2 else Element2D(index, corners))
    return Mesh(plain)


@pytest.mark.parametrize(
    ("dim", "interface", "solver"),
    [
        (2, "interface", "coupled"),
        (2, "top", "coupled"),
        (2, "interface", "split"),
        (2, "top", "split"),
        (3, "top", "split"),
        pytest.param(3, "interface", "split", marks=pytest.mark.long),
        pytest.param(3, "top", "coupled", marks=pytest.mark.long),
    ],
)
def test_run_with_an_interface_is_that_on_the_same_cells_without(dim, interface, solver):
    """Also where the interface has the name of a wall, on which nothing slips and which is pulled along."""
    mesh = with_inclusion(dim, interface, 0.4 if dim == 2 else 0.8)
    plain = without_interfaces(mesh)
    assert plain.ne == mesh.ne
    assert len(list(plain.Elements(BND))) < len(list(mesh.Elements(BND)))
    gravity, moving = [0.0] * dim, [0.0] * dim
    gravity[-1], moving[0] = -1.0, 0.1
    model = nv.Model(material=nv.NeoHookean(K_e=1, G_e=1, epsilon=0.1), loads=[nv.Gravity(gravity)])
    walls = {"left": nv.NoSlip(), "top": nv.PrescribedTangential(tuple(moving))}
    ledgers = [nv.Simulation(m, model, dt=0.05, walls=walls, solver=solver).run(0.05) for m in (mesh, plain)]
    for ledger in ledgers:
        assert abs(ledger.column("closure_relative")).max() < 1e-12
    for name in ("kinetic", "stored", "mass", "rho_min", "J_min", "v_max", "power_wall_top"):
        a, b = (ledger.column(name) for ledger in ledgers)
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12), name


@pytest.mark.parametrize(("dim", "maxh"), [(2, 0.4), (3, 0.8)])
def test_interface_of_a_wall_s_name_is_told_from_the_wall(dim, maxh):
    mesh = with_inclusion(dim, "top", maxh)
    assert interior_boundaries(mesh) == set()
    heights = [mesh[v].point[-1] for e in walls_of(mesh, ["top"]).Elements() for v in e.vertices]
    assert np.array(heights) == pytest.approx(1.0)
    every = [e for e in mesh.Elements(BND) if e.mat == "top"]
    assert 0 < len(list(walls_of(mesh, ["top"]).Elements())) < len(every)


def test_glued_shapes_without_names_make_a_run():
    """What Netgen calls ``default`` are then the walls and the interface alike."""
    whole, disc = occ.Rectangle(1, 1).Face(), occ.Circle((0.6, 0.5), 0.2).Face()
    mesh = Mesh(occ.OCCGeometry(occ.Glue([whole - disc, disc]), dim=2).GenerateMesh(maxh=0.3)).Curve(3)
    model = nv.Model(material=nv.NeoHookean(K_e=1, G_e=1, epsilon=0.1), loads=[nv.Gravity((0, -1))])
    run = nv.Simulation(mesh, model, dt=0.05)
    assert set(run.rothe_step.walls.conditions) == {"default"}
    ledger = run.run(0.05)
    assert abs(ledger.column("closure_relative")).max() < 1e-12
    assert run.fields["velocity"](mesh(0.6, 0.3))[1] < -0.001  # across the disc's lowest point


def test_part_of_a_boundary_that_is_wall_and_interface_is_refused():
    """One edge of the file's geometry that goes on from the wall into the body."""
    plain = NetgenMesh(dim=2)
    points = [(0, 0), (1, 0), (1, 1), (0, 1)]
    a, b, c, d = (plain.Add(MeshPoint(Pnt(*point, 0))) for point in points)
    plain.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    for corners in ((a, b, c), (a, c, d)):
        plain.Add(Element2D(1, list(corners)))
    for ends in ((a, b), (b, c), (c, d), (d, a), (a, c)):
        plain.Add(Element1D(list(ends), index=1))
    model = nv.Model(material=nv.NeoHookean(K_e=1, G_e=1, epsilon=0.1))
    with pytest.raises(nv.MeshError, match="divide it"):
        nv.Simulation(Mesh(plain), model, dt=0.05)

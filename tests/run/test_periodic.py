"""Meshes of all kinds: periodic cells, parts with fillets and a hole, subdomains; energy and mass exact."""

import netgen.occ as occ
import numpy as np
import pytest
from netgen.meshing import Element1D, Element2D, Element3D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import BND, CF, VOL, Integrate, Mesh, cos, pi, sin, specialcf, x, y, z
from support import assert_balanced, by_ci

import ngvisco as nv
from ngvisco.forms.boundary.boundaries import walls_of
from ngvisco.geometries import block_with_hole, box


def model(p=None, loads=()):
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=p) if p else None,
        creep=nv.Creep(G_m=5.0),
        loads=loads,
    )


@pytest.mark.parametrize("periodic", ["x", "xy", "xyz"])
def test_a_box_periodic_in_some_directions_conserves_energy_and_mass(periodic):
    """Material is carried through the identified walls, at which both sides share their unknowns."""
    mesh = box((1, 1, 1), 0.6, periodic=periodic)
    through = [1.0 if name in periodic else 0.0 for name in "xyz"]
    v = CF(tuple(c * (1 + 0.3 * sin(2 * pi * s)) for c, s in zip(through, (y, z, x), strict=True)))
    initial = nv.Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=v)
    loads = (nv.BodyForce((0.2 * through[0], 0.1 * sin(2 * pi * x) * through[1], 0.0)),)
    run = nv.Simulation(
        mesh, model(2.0, loads), dt=0.05, initial=initial, discretisation=nv.Discretisation(m=0)
    )
    assert len(run.rothe_step.walls.periodic) == 2 * len(periodic)
    run.run(0.1)
    assert_balanced(run.ledger)
    velocity = run.fields["velocity"]
    for i, name in enumerate("xyz"):
        sides = []
        for s in (0.0, 1.0):
            point = [0.37, 0.21, 0.46]
            point[i] = s
            sides.append(np.array(velocity(mesh(*point))))
        if name in periodic:
            assert np.allclose(*sides, rtol=0, atol=1e-12) and abs(sides[0][i]) > 0.1
        else:
            assert abs(sides[0][i]) < 1e-14 and abs(sides[1][i]) < 1e-14


def falling(dim, **options):
    gravity = nv.Gravity((0.3, -1.0) if dim == 2 else (0.3, 0.0, -1.0))
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        creep=nv.Creep(G_m=5.0),
        loads=(gravity,),
        **options,
    )


def assert_exact_balance(run):
    assert_balanced(run.ledger)
    assert run.ledger.column("v_max")[-1] > 0.1


def assert_no_flux(run):
    """Assert that v.n vanishes on plane walls, and that its mean vanishes on every facet of curved walls."""
    v, n = run.fields["velocity"], specialcf.normal(run.mesh.dim)
    flux = np.abs(np.array(Integrate(v * n, run.mesh, BND, order=8, element_wise=True)))
    assert flux.max() < 1e-11
    plane = "left|right|bottom|top"
    assert Integrate((v * n) ** 2, run.mesh, BND, definedon=run.mesh.Boundaries(plane)) < 1e-28
    fillet = run.mesh.Boundaries("fillet")
    speed = Integrate(v * v, run.mesh, BND, definedon=fillet)
    assert speed > 1e-4  # the body slips along the fillets
    assert Integrate((v * n) ** 2, run.mesh, BND, definedon=fillet) < 0.05 * speed


@pytest.mark.parametrize("k", [2, pytest.param(3, marks=pytest.mark.long)])
def test_a_rounded_rectangle_with_a_hole_conserves_energy_and_mass(k):
    mesh = block_with_hole((1.4, 1.0), 0.25, 0.5, fillet=0.35)
    assert set(mesh.GetBoundaries()) == {"left", "right", "bottom", "top", "hole", "fillet"}
    initial = nv.Initial(density=1 + 0.2 * x, velocity=(sin(pi * y), -sin(pi * x)))
    discretisation = nv.Discretisation(k=k, m=k - 1)
    law = nv.HyperViscosity(mu=1e-5, p=4) if k == 2 else None
    run = nv.Simulation(
        mesh, falling(2, hyperviscosity=law), dt=0.02, initial=initial, discretisation=discretisation
    )
    run.run(0.04)
    assert_exact_balance(run)
    assert_no_flux(run)


def part():
    """A box of 1 x 0.3 x 1 with the edges along y rounded and a hole along y, by OCC."""
    solid = occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(1, 0.3, 1))
    for name, direction in (("left", -occ.X), ("right", occ.X), ("bottom", -occ.Z), ("top", occ.Z)):
        solid.faces.Max(direction).name = name
    solid = solid.MakeFillet([edge for edge in solid.edges if abs(edge.center.y - 0.15) < 1e-9], 0.3)
    for face in solid.faces:
        if face.name not in ("left", "right", "bottom", "top"):
            face.name = "sides" if abs(abs(face.center.y - 0.15) - 0.15) < 1e-9 else "fillet"
    hole = occ.Cylinder(occ.Pnt(0.5, 0, 0.5), occ.Y, r=0.2, h=1)
    hole.faces.name = "hole"
    return solid - hole


@pytest.mark.long  # the mesh has 85 cells
@pytest.mark.ci
def test_a_filleted_part_with_a_hole_conserves_energy_and_mass():
    shape = part()
    coarse = {"curvaturesafety": 1.2, "grading": 0.7, "segmentsperedge": 0.5}
    mesh = Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=1.0, parallel_meshing=False, **coarse)).Curve(3)
    assert Integrate(CF(1.0), mesh) == pytest.approx(shape.mass, rel=2e-3)
    initial = nv.Initial(density=1 + 0.2 * x, velocity=(z - 0.5, 0 * x, 0.5 - x))
    run = nv.Simulation(mesh, falling(3), dt=0.02, initial=initial, discretisation=nv.Discretisation(m=0))
    run.run(0.04)
    assert_exact_balance(run)
    assert_no_flux(run)


SIDES = {
    2: {"left": -occ.X, "right": occ.X, "bottom": -occ.Y, "top": occ.Y},
    3: dict(left=-occ.X, right=occ.X, front=-occ.Y, back=occ.Y, bottom=-occ.Z, top=occ.Z),
}


def with_inclusion(dim, interface, maxh):
    """A box with an inner box, whose sides are called ``interface``; in the plane the inner box touches a
    wall."""
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
    """The mesh with the same cells in a single domain, without inner boundaries."""
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
        by_ci(3, "top", "split"),
        pytest.param(3, "interface", "split", marks=pytest.mark.long),
        pytest.param(3, "top", "coupled", marks=pytest.mark.long),
    ],
)
def test_an_interface_in_the_mesh_does_not_change_a_run(dim, interface, solver):
    """The interface may have the same name as a wall without slip, or as a moving wall."""
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


def test_a_mesh_of_glued_shapes_without_names_runs():
    """Netgen then calls both the walls and the interface ``default``."""
    whole, disc = occ.Rectangle(1, 1).Face(), occ.Circle((0.6, 0.5), 0.2).Face()
    mesh = Mesh(occ.OCCGeometry(occ.Glue([whole - disc, disc]), dim=2).GenerateMesh(maxh=0.3)).Curve(3)
    model = nv.Model(material=nv.NeoHookean(K_e=1, G_e=1, epsilon=0.1), loads=[nv.Gravity((0, -1))])
    run = nv.Simulation(mesh, model, dt=0.05)
    assert set(run.rothe_step.walls.conditions) == {"default"}
    ledger = run.run(0.05)
    assert abs(ledger.column("closure_relative")).max() < 1e-12
    # matter flows through the place where the disc's lowest point is
    assert run.fields["velocity"](mesh(0.6, 0.3))[1] < -0.001


def test_a_boundary_part_that_is_both_wall_and_interface_is_refused():
    """One edge of the file's geometry continues from the wall into the body."""
    plain = NetgenMesh(dim=2)
    points = [(0, 0), (1, 0), (1, 1), (0, 1)]
    a, b, c, d = (plain.Add(MeshPoint(Pnt(*point, 0))) for point in points)
    plain.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    for corners in ((a, b, c), (a, c, d)):
        plain.Add(Element2D(1, list(corners)))
    for ends in ((a, b), (b, c), (c, d), (d, a), (a, c)):
        plain.Add(Element1D(list(ends), index=1))
    model = nv.Model(material=nv.NeoHookean(K_e=1, G_e=1, epsilon=0.1))
    with pytest.raises(nv.MeshError, match="divide the boundary"):
        nv.Simulation(Mesh(plain), model, dt=0.05)

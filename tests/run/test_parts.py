"""Parts with fillets and a hole: slip on walls that bend from plane to curved, energy and mass."""

import netgen.occ as occ
import numpy as np
import pytest
from ngsolve import BND, CF, Integrate, Mesh, pi, sin, specialcf, x, y, z
from support import assert_balanced

import ngvisco as nv
from ngvisco.geometries import block_with_hole


def model(dim, **options):
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
    """The mean of v.n vanishes on every facet of the curved walls, and v.n on the plane ones."""
    v, n = run.fields["velocity"], specialcf.normal(run.mesh.dim)
    flux = np.abs(np.array(Integrate(v * n, run.mesh, BND, order=8, element_wise=True)))
    assert flux.max() < 1e-11
    plane = "left|right|bottom|top"
    assert Integrate((v * n) ** 2, run.mesh, BND, definedon=run.mesh.Boundaries(plane)) < 1e-28
    fillet = run.mesh.Boundaries("fillet")
    speed = Integrate(v * v, run.mesh, BND, definedon=fillet)
    assert speed > 1e-4  # it slips along the fillets
    assert Integrate((v * n) ** 2, run.mesh, BND, definedon=fillet) < 0.05 * speed


@pytest.mark.parametrize("k", [2, pytest.param(3, marks=pytest.mark.long)])
def test_rounded_rectangle_with_a_hole(k):
    mesh = block_with_hole((1.4, 1.0), 0.25, 0.5, fillet=0.35)
    assert set(mesh.GetBoundaries()) == {"left", "right", "bottom", "top", "hole", "fillet"}
    initial = nv.Initial(density=1 + 0.2 * x, velocity=(sin(pi * y), -sin(pi * x)))
    discretisation = nv.Discretisation(k=k, m=k - 1)
    law = nv.HyperViscosity(mu=1e-5, p=4) if k == 2 else None
    run = nv.Simulation(
        mesh, model(2, hyperviscosity=law), dt=0.02, initial=initial, discretisation=discretisation
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


@pytest.mark.long  # 85 cells
@pytest.mark.ci
def test_filleted_part_with_a_hole():
    shape = part()
    coarse = {"curvaturesafety": 1.2, "grading": 0.7, "segmentsperedge": 0.5}
    mesh = Mesh(occ.OCCGeometry(shape).GenerateMesh(maxh=1.0, parallel_meshing=False, **coarse)).Curve(3)
    assert Integrate(CF(1.0), mesh) == pytest.approx(shape.mass, rel=2e-3)
    initial = nv.Initial(density=1 + 0.2 * x, velocity=(z - 0.5, 0 * x, 0.5 - x))
    run = nv.Simulation(mesh, model(3), dt=0.02, initial=initial, discretisation=nv.Discretisation(m=0))
    run.run(0.04)
    assert_exact_balance(run)
    assert_no_flux(run)

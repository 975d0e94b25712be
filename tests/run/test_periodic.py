"""Periodic cells in one, two and three directions: all unknowns identified, energy and mass exact.

The meshes are so coarse that cells meet their own image: two of their vertices are one.
"""

import numpy as np
import pytest
from ngsolve import CF, Integrate, cos, pi, sin, x, y, z
from support import assert_balanced

import ngvisco as nv
from ngvisco.geometries import box, channel


def model(p=None, loads=()):
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=p) if p else None,
        creep=nv.Creep(G_m=5.0),
        loads=loads,
    )


@pytest.mark.parametrize("periodic", ["x", "xy", "xyz"])
def test_a_box_periodic_in_some_directions(periodic):
    """Material is carried through the identified walls, where the unknowns of both sides are one."""
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


@pytest.mark.parametrize("size", [(1.0, 1.0), (1.0, 1.0, 1.0)], ids=["2D", "3D"])
def test_a_uniform_flow_through_a_periodic_cell_stays_uniform(size):
    """Rest in another frame of reference."""
    dim = len(size)
    V = (1.0, 0.5, -0.25)[:dim]
    run = nv.Simulation(
        box(size, 0.9, periodic="xyz"[:dim]),
        model(4.0 if dim == 2 else 2.0),
        dt=0.1,
        initial=nv.Initial(density=2.0, velocity=V),
        discretisation=nv.Discretisation(m=0),
    )
    run.run(0.2)
    defect = run.fields["velocity"] - CF(V)
    assert Integrate(defect * defect, run.mesh) < 1e-22
    assert Integrate((run.fields["density"] - 2) ** 2, run.mesh) < 1e-24
    assert run.ledger.column("kinetic")[-1] == pytest.approx(sum(c * c for c in V), rel=1e-12)
    assert_balanced(run.ledger)


def test_a_channel_of_two_triangles_is_sheared_as_any_other():
    """Both vertices of each wall are one and the same."""
    walls = {"top": nv.PrescribedTangential((0.3, 0.0)), "bottom": nv.NoSlip()}
    plain = nv.Model(material=nv.LinearElastic(K_e=2.0, G_e=1.0), viscosity=nv.StokesViscosity(K_v=1, G_v=1))
    run = nv.Simulation(
        channel(1, 1, 2.0), plain, dt=0.1, walls=walls, initial=nv.Initial(velocity=(0.3 * y, 0))
    )
    assert run.mesh.ne == 2
    run.run(0.2)
    defect = run.fields["velocity"] - CF((0.3 * y, 0))
    assert Integrate(defect * defect, run.mesh) < 1e-24
    assert_balanced(run.ledger)

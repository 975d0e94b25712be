"""Arrays of meshes and spaces, against NGSolve's own objects one by one."""

import numpy as np
import pytest
from ngsolve import ET, H1, VOL, Mesh
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngvisco.forms.mesh.mesh_arrays import coordinates, is_simplicial, mask_of, vertices
from ngvisco.geometries import box, disc


def refined() -> Mesh:
    mesh = box((1, 1, 1), maxh=1)
    mesh.Refine()
    return mesh


MESHES = {
    "triangles": lambda: box((1, 1), maxh=0.4),
    "curved triangles": lambda: disc(1.0, maxh=0.5),
    "refined tetrahedra": refined,
    "squares": lambda: MakeStructured2DMesh(quads=True, nx=3, ny=2),
    "cubes": lambda: MakeStructured3DMesh(hexes=True, nx=2, ny=1, nz=1),
}


@pytest.mark.parametrize("name", MESHES)
def test_cells_and_vertices(name):
    mesh = MESHES[name]()
    expected = [v.nr for cell in mesh.Elements(VOL) for v in cell.vertices]
    assert vertices(mesh).ravel().tolist() == expected
    assert (coordinates(mesh) == np.array([v.point for v in mesh.vertices])).all()
    assert is_simplicial(mesh) == all(cell.type in (ET.TRIG, ET.TET) for cell in mesh.Elements(VOL))


def test_sets_of_unknowns():
    free = H1(box((1, 1), maxh=0.3), order=2, dirichlet="left").FreeDofs()
    assert (mask_of(free) == np.array(list(free), dtype=bool)).all()
    assert mask_of(free).dtype == bool

"""Values at the sides' points: NGSolve's integrals over element boundaries are met to rounding."""

import numpy as np
import pytest
from ngsolve import H1, L2, FacetFESpace, GridFunction, cos, grad, specialcf, x, y, z

from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.mesh.side_points import SidePoints
from ngvisco.geometries import box, disc, sphere

MESHES = {
    "square": lambda: box((1, 1), maxh=0.5),
    "cube": lambda: box((1, 1, 1), maxh=1),
    "periodic": lambda: box((1, 1), maxh=0.3, periodic="x"),
    "disc": lambda: disc(1.0, maxh=0.6),
    "ball": lambda: sphere(1.0, maxh=1.0),
}


@pytest.fixture(params=MESHES)
def mesh(request):
    return MESHES[request.param]()


def test_integrals_are_ngsolve_s(mesh):
    points = SidePoints(mesh, 6)
    space = H1(mesh, order=2)
    u = GridFunction(space)
    u.Set(cos(2 * x + y + z))
    n = specialcf.normal(mesh.dim)
    values = points.values(space) @ u.vec.FV().NumPy()
    slopes = points.operator(space, lambda v: grad(v) * n) @ u.vec.FV().NumPy()
    ours = points.weights @ (values * slopes * points.sample(1 + x * y) * points.normals[0])
    theirs = Quadrature(mesh, 6, 6).integrate_facets(u * (grad(u) * n) * (1 + x * y) * n[0])
    assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-13)


def test_the_two_sides_of_a_facet_see_the_same_trace(mesh):
    """int u n over all sides vanishes for u that is zero on walls: opposite normals, equal values."""
    points, space = SidePoints(mesh, 4), FacetFESpace(mesh, order=1)
    u = np.random.default_rng(0).standard_normal(space.ndof)
    u[np.array(list(space.GetDofs(mesh.Boundaries(".*"))), dtype=bool)] = 0.0
    values = points.values(space) @ u
    assert np.abs(values).max() > 0.1
    for n in points.normals:
        assert abs(points.weights @ (values * n)) <= 1e-13


def test_discontinuous_functions_have_values_of_their_own_cell(mesh):
    points = SidePoints(mesh, 2)
    matrix = points.values(L2(mesh, order=0))
    cells = np.repeat(np.arange(mesh.ne), (mesh.dim + 1) * points.per_side)
    assert (matrix.indices == cells).all() and np.allclose(matrix.data, matrix.data[0])

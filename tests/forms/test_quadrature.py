"""The rule of forms and of the ledger's integrals, which are one: else no ledger would close."""

from collections.abc import Callable

import numpy as np
import pytest
from ngsolve import Mesh, specialcf, x, y, z
from ngsolve.meshes import MakeStructured2DMesh

from ngvisco.forms.mesh.points import SidePoints
from ngvisco.forms.mesh.quadrature import Quadrature, Sampler
from ngvisco.geometries import box

MESHES: dict[str, Callable[[], Mesh]] = {
    "triangles": lambda: box((1, 0.7), 0.5),
    "tetrahedra": lambda: box((1, 0.7, 0.8), 1.0),
    "quadrilaterals": lambda: MakeStructured2DMesh(quads=True, nx=2, ny=1),
}
DEGREES = [3, 6, 9]


@pytest.mark.parametrize("degree", DEGREES)
def test_polynomials_of_the_degree_are_exact(degree: int) -> None:
    quadrature = Quadrature(box((1, 1), 0.5), degree, degree)
    assert quadrature.integrate_cells(x**degree) == pytest.approx(1 / (degree + 1), rel=1e-13)
    # the divergence theorem over all cells' boundaries
    flux = x**degree * specialcf.normal(2)[0]
    assert quadrature.integrate_facets(flux) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("k, m", [(2, 0), (2, 1), (3, 1), (3, 2)])
def test_degree_resolves_the_polynomial_terms(k: int, m: int) -> None:
    """Momentum's 3k - 1 + m with v three times is left out on purpose; the others are exact."""
    quadrature = Quadrature.for_orders(box((1, 1), 1.0), k, m)
    assert quadrature.volume_degree == quadrature.facet_degree >= max(2 * k + m, k - 1 + 2 * m)
    assert quadrature.volume_degree % 2 == 0  # NGSolve keeps values at the points of even degrees only
    more = Quadrature.for_orders(box((1, 1), 1.0), k, m, bonus=4)
    assert more.volume_degree == quadrature.volume_degree + 4


def test_vector_integrands_are_integrated_by_component() -> None:
    quadrature = Quadrature(box((1, 1), 0.5), 4, 4)
    from ngsolve import CF

    assert np.asarray(quadrature.integrate_cells(CF((1, x, y * y)))) == pytest.approx([1, 0.5, 1 / 3])


@pytest.mark.parametrize("name", ["triangles", "tetrahedra", "quadrilaterals"])
def test_sampler_sees_vertices_and_interior(name: str) -> None:
    """An extremum at a corner or inside is found: the points hold all vertices of all cells."""
    mesh = MESHES[name]()
    sampler = Sampler(mesh, Quadrature(mesh, 4, 4))
    assert sampler.extrema(x + y)[0] == pytest.approx(0.0, abs=1e-12)
    top = max(v.point[0] + v.point[1] for v in mesh.vertices)
    assert sampler.extrema(x + y)[1] == pytest.approx(top)
    assert sampler.values(x).shape == sampler.values(y).shape


@pytest.mark.parametrize(("k", "m"), [(2, 1), (2, 2), (3, 2)])
def test_both_sides_of_a_face_see_the_same_points(k: int, m: int) -> None:
    """NGSolve's rules of triangles from degree 8 on have no symmetry, and cells number faces differently."""
    mesh = box((1, 0.7, 0.8), 1.0)
    points = SidePoints(mesh, Quadrature.for_orders(mesh, k, m).facet_degree)
    places = np.stack([points.sample(c) for c in (x, y, z)], axis=1).reshape(-1, points.per_side, 3)
    order = [side[np.lexsort(np.round(side, 9).T)] for side in places]
    found = np.unique(np.round(np.stack(order).reshape(len(places), -1), 9), axis=0)
    assert len(found) == mesh.nface

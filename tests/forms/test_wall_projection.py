"""The projection onto the velocities that oblique and curved walls admit."""

import numpy as np
import pytest
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import BND, CF, Integrate, Mesh, specialcf

import ngvisco as nv
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.projections import WallProjection
from ngvisco.forms.system import Step
from ngvisco.geometries import sphere


def triangle() -> Mesh:
    """With oblique sides, that meet at corners."""
    face = WorkPlane().MoveTo(0, 0).LineTo(1, 0.2).LineTo(0.3, 1).LineTo(0, 0).Face()
    for side, name in zip(face.edges, "abc", strict=True):
        side.name = name
    return Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=0.4))


def step_on(dim: int, k: int = 2) -> Step:
    mesh, walls = (triangle(), {"a": nv.NoSlip()}) if dim == 2 else (sphere(1.0, maxh=1.2), None)
    model = nv.Model(material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1))
    return Step(mesh, model, nv.Discretisation(k=k), conditions=walls)


def projection_of(step: Step, diagonal: np.ndarray | None = None) -> tuple[WallProjection, int]:
    """With a diagonal drawn at random, and the number of free coefficients."""
    free = mask_of(step.layout.blocks["v"].FreeDofs())
    projection = WallProjection(step.layout, step.impenetrability, step.quadrature, free)
    count = np.count_nonzero(free)
    projection.update(np.random.default_rng(0).uniform(0.5, 2.0, count) if diagonal is None else diagonal)
    return projection, count


@pytest.mark.parametrize(("dim", "k"), [(2, 2), (2, 3), (3, 2)])
def test_projection_is_idempotent_and_its_transpose_is_one(dim, k):
    projection, count = projection_of(step_on(dim, k))
    v, w = np.random.default_rng(1).standard_normal((2, count))
    once = projection(v)
    assert np.linalg.norm(projection(once) - once) <= 1e-13 * np.linalg.norm(v)
    assert np.linalg.norm(once - v) > 0.1 * np.linalg.norm(v)
    assert projection.transposed(w) @ v == pytest.approx(w @ once, rel=1e-12)


def test_projection_is_orthogonal_in_the_diagonal():
    diagonal = np.random.default_rng(2).uniform(1e-3, 1e3, projection_of(step_on(2))[1])
    projection, count = projection_of(step_on(2), diagonal)
    v, w = np.random.default_rng(1).standard_normal((2, count))
    assert (diagonal * (v - projection(v))) @ projection(w) == pytest.approx(0.0, abs=1e-10 * diagonal.max())


@pytest.mark.parametrize("dim", [2, 3])
def test_completed_velocities_go_through_no_facet_of_a_wall(dim):
    """In 2D beside a wall whose velocity is prescribed: it has a share in the facets that meet it."""
    step = step_on(dim)
    projection, _ = projection_of(step)
    v, free = step.state.vec.FV().NumPy()[step.layout.ranges["v"]], projection.free
    v[:] = np.random.default_rng(3).standard_normal(len(v))
    wall = step.walls.region(step.walls.multiplied)
    through = CF(step.now.v) * specialcf.normal(dim)

    def largest() -> float:
        each = Integrate(through, step.mesh, BND, element_wise=True, definedon=wall, order=8)
        return float(abs(np.array(each)).max())

    assert largest() > 1e-2
    v[free] = projection.completed(v)
    assert largest() <= 1e-13

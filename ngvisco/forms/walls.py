"""Walls: impenetrability v.n = 0 with a free tangential part (paper: Euler-small-BC-hyper).

On a wall parallel to the axes the condition is one component of v, constrained exactly in the space.
Anything that a wall adds to the system as a form (a multiplier for an oblique or curved wall) is a
``Term`` that ``wall_terms`` returns; the step sums it like every other.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from ngsolve import BND, CF, Integrate, Mesh, specialcf

from ngvisco.errors import MeshError, UnknownNameError
from ngvisco.forms.context import Context, Term
from ngvisco.forms.orientation import check_orientation

_PARALLEL = 1e-10


def check_mesh(mesh: Mesh) -> None:
    """Raise MeshError unless the mesh is 2D or 3D, has volume elements and none is inverted."""
    if mesh.dim not in (2, 3):
        raise MeshError(f"the mesh has dimension {mesh.dim}: expected 2 (plane strain) or 3")
    if mesh.ne == 0:
        raise MeshError("the mesh has no volume elements: mesh the interior, not only its surface")
    check_orientation(mesh)


def check_boundary_names(mesh: Mesh, names: Iterable[str]) -> None:
    """Raise UnknownNameError for a name that no boundary of the mesh has; NGSolve stays silent."""
    known = set(mesh.GetBoundaries())
    for name in names:
        if name not in known:
            raise UnknownNameError("boundary", name, known)


def axis_parallel_walls(mesh: Mesh) -> tuple[list[list[str]], list[str]]:
    """For each axis the boundaries normal to it, and the boundaries that are normal to none."""
    n = specialcf.normal(mesh.dim)
    walls: list[list[str]] = [[] for _ in range(mesh.dim)]
    others: list[str] = []
    for name in sorted(set(mesh.GetBoundaries())):
        region = mesh.Boundaries(_exactly(name))
        area = Integrate(CF(1.0), mesh, BND, definedon=region)
        tilt = [abs(Integrate(1 - n[i] * n[i], mesh, BND, definedon=region)) for i in range(mesh.dim)]
        axis = int(np.argmin(tilt))
        (walls[axis] if tilt[axis] <= _PARALLEL * area else others).append(name)
    return walls, others


def slip_constraints(mesh: Mesh) -> tuple[str, ...]:
    """Boundary pattern for v_i = 0, one for each i, that makes every wall impenetrable.

    Raises
    ------
    MeshError
        If a wall is not parallel to the axes.
    """
    walls, others = axis_parallel_walls(mesh)
    if others:
        raise MeshError(
            f"boundary {others[0]!r} is not normal to an axis: expected walls parallel to the axes"
        )
    return tuple("|".join(_exactly(name) for name in names) for names in walls)


def wall_terms(mesh: Mesh, context: Context) -> tuple[Term, ...]:
    """Terms by which walls enter the system; none where the space holds the condition."""
    del mesh, context
    return ()


def _exactly(name: str) -> str:
    """A regular expression that matches this boundary name and no other."""
    return "".join(c if c.isalnum() or c == "_" else "\\" + c for c in name)

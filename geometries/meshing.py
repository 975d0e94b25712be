"""What all geometries share: checks of sizes, local refinement, meshing with curved cells."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from netgen.occ import OCCGeometry
from ngsolve import BND, VOL, Mesh

from ngvisco.errors import ParameterError, UnknownNameError

CURVE_ORDER = 3
"""Order of curved cells: one above the default velocity, so that the geometry's error is not the largest."""


def check_lengths(owner: str, **lengths: float) -> None:
    """Raise ParameterError unless every length is a finite number > 0."""
    for name, value in lengths.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
            raise ParameterError(f"{owner}.{name}", value, "a finite number > 0")


def mesh_of(
    owner: str,
    shape: Any,
    dim: int,
    maxh: float,
    order: int = 1,
    refine: Mapping[str, float] | None = None,
) -> Mesh:
    """Mesh an OCC shape, with a smaller cell size on the walls named in ``refine``, and curve it."""
    check_lengths(owner, maxh=maxh)
    if isinstance(order, bool) or not isinstance(order, int) or order < 1:
        raise ParameterError(f"{owner}.order", order, "an integer >= 1")
    walls = shape.edges if dim == 2 else shape.faces
    for name, size in (refine or {}).items():
        check_lengths(owner, **{f"refine[{name!r}]": size})
        known = {str(wall.name) for wall in walls}
        if name not in known:
            raise UnknownNameError("wall", name, known)
        for wall in walls:
            if wall.name == name:
                wall.maxh = size
    mesh = Mesh(OCCGeometry(shape, dim=dim).GenerateMesh(maxh=maxh))
    return mesh.Curve(order) if order > 1 else mesh


def refine_walls(mesh: Mesh, names: Iterable[str], times: int = 1) -> Mesh:
    """Bisect the cells that touch the named walls ``times`` times: a boundary layer graded towards them.

    Each time halves the height of the cells at the wall, and their size along it as well: the cells keep
    their shape, they are not flattened as those of a layer that is extruded from the wall.
    The mesh is changed in place, curved again as it was, and returned.

    Raises
    ------
    UnknownNameError
        For a name that no boundary has.
    """
    names = [names] if isinstance(names, str) else list(names)
    known = set(mesh.GetBoundaries())
    for name in names:
        if name not in known:
            raise UnknownNameError("boundary", name, known)
    order = mesh.GetCurveOrder()
    for _ in range(times):
        near = {v for e in mesh.Elements(BND) if e.mat in names for v in e.vertices}
        for element in mesh.Elements(VOL):
            mesh.SetRefinementFlag(element, bool(near.intersection(element.vertices)))
        mesh.Refine()
        if order > 1:
            mesh.Curve(order)
    return mesh

"""Boxes with axis-parallel walls."""

from __future__ import annotations

from collections.abc import Sequence

from netgen.occ import Box, OCCGeometry, Pnt, Rectangle, X, Y, Z
from ngsolve import Mesh

from ngvisco.errors import ParameterError


def box(size: Sequence[float], maxh: float) -> Mesh:
    """A box [0, size_1] x [0, size_2] (x [0, size_3]).

    Walls: ``left``/``right`` (x), ``bottom``/``top`` (y in 2D, z in 3D), ``front``/``back`` (y in 3D).

    Parameters
    ----------
    size : two or three positive numbers
        Edge lengths, m.
    maxh : float
        Largest cell size, m, > 0.

    Raises
    ------
    ParameterError
        If a length is not a finite positive number, or their number is not 2 or 3.
    """
    lengths = tuple(float(s) for s in size)
    if len(lengths) not in (2, 3) or not all(0 < s < float("inf") for s in lengths):
        raise ParameterError("box.size", size, "two or three finite numbers > 0")
    if not 0 < maxh < float("inf"):
        raise ParameterError("box.maxh", maxh, "a finite number > 0")
    if len(lengths) == 2:
        face = Rectangle(*lengths).Face()
        for name, direction in (("left", -X), ("right", X), ("bottom", -Y), ("top", Y)):
            face.edges.Max(direction).name = name
        return Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=maxh))
    solid = Box(Pnt(0, 0, 0), Pnt(*lengths))
    for name, direction in (
        ("left", -X),
        ("right", X),
        ("front", -Y),
        ("back", Y),
        ("bottom", -Z),
        ("top", Z),
    ):
        solid.faces.Max(direction).name = name
    return Mesh(OCCGeometry(solid).GenerateMesh(maxh=maxh))

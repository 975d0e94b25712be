"""Shapes: parts of space, given by a level that is positive inside.

Shapes set where bodies are at the start of a run. A level is any function with the right sign. The level
should be continuous near the surface, so that ``fractions`` divides cut cells at the surface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Mesh

from ngvisco.errors import ParameterError, Quantity, as_place, planar, require_fields, require_known
from ngvisco.shapes.fractions import fractions
from ngvisco.shapes.places import Places


class Shape(ABC):
    """A part of space.  ``a | b``, ``a & b``, ``a - b`` and ``~a`` are shapes as well."""

    @abstractmethod
    def level(self, at: Places) -> np.ndarray:
        """Level at each place, (places,): > 0 inside, <= 0 outside.

        Raises ParameterError if the shape does not fit the mesh, e.g. its dimension.
        """

    def inside(self, mesh: Mesh, order: int = 1) -> GridFunction:
        """The shape's fraction of each cell, a discontinuous P_order from 0 to 1 (``fractions``)."""
        return fractions(mesh, [self], order)[0]

    def __or__(self, other: Shape) -> Shape:
        return Union((self, other))

    def __and__(self, other: Shape) -> Shape:
        return Complement(Union((Complement(self), Complement(other))))

    def __sub__(self, other: Shape) -> Shape:
        return self & Complement(other)

    def __invert__(self) -> Shape:
        return Complement(self)


@dataclass(frozen=True)
class Union(Shape):
    """The points in at least one of the shapes."""

    shapes: Sequence[Shape]

    def __post_init__(self) -> None:
        require_fields(self)
        if not self.shapes:
            raise ParameterError("Union.shapes", self.shapes, "at least one shape")

    def level(self, at: Places) -> np.ndarray:
        return np.max([shape.level(at) for shape in self.shapes], axis=0)


@dataclass(frozen=True)
class Complement(Shape):
    """The points outside a shape."""

    shape: Shape

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Shape):
            raise ParameterError("Complement.shape", self.shape, "a shape")

    def level(self, at: Places) -> np.ndarray:
        return -self.shape.level(at)


@dataclass(frozen=True)
class Where(Shape):
    """The points at which a function is positive, or is 1 if its values are 0 and 1 only.

    Parameters
    ----------
    function : scalar coefficient function
        Function of x, y, z (m).  A continuous function locates the surface within sub-cells; a function
        that jumps locates it to a sub-cell.
    """

    function: CoefficientFunction

    def __post_init__(self) -> None:
        if not isinstance(self.function, CoefficientFunction) or self.function.dim != 1:
            raise ParameterError("Where.function", self.function, "a scalar coefficient function")

    def level(self, at: Places) -> np.ndarray:
        values = at.values(planar("Where.function", self.function, at.mesh.dim)).reshape(-1)
        if not np.isfinite(values).all():
            expected = "a function with finite values"
            raise ParameterError("Where.function", "a function that is not finite somewhere", expected)
        return values - 0.5 if bool(np.isin(values, (0.0, 1.0)).all()) else values


@dataclass(frozen=True)
class Ball(Shape):
    """A ball, in two dimensions a disc.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    centre : two or three numbers
        Centre, with a coordinate for each dimension.
    radius : float
        Radius.
    """

    centre: Annotated[tuple[float, ...], Quantity("m", example=[0.6, 0.5])]
    radius: Annotated[float, Quantity("m", "> 0", 0.2)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", as_place("Ball.centre", self.centre))
        require_fields(self)

    def level(self, at: Places) -> np.ndarray:
        require_dim("Ball.centre", self.centre, at.mesh)
        return self.radius - np.linalg.norm(at.coordinates - self.centre, axis=1)


@dataclass(frozen=True)
class Block(Shape):
    """A box between two corners, with edges along the axes.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    low : two or three numbers
        Corner of the smallest coordinates, a coordinate for each dimension.
    high : two or three numbers
        Corner of the largest coordinates.
    """

    low: Annotated[tuple[float, ...], Quantity("m", example=[0.2, 0.2])]
    high: Annotated[tuple[float, ...], Quantity("m", example=[0.8, 0.4])]

    def __post_init__(self) -> None:
        low, high = as_place("Block.low", self.low), as_place("Block.high", self.high)
        if len(low) != len(high) or not all(a < b for a, b in zip(low, high, strict=True)):
            raise ParameterError("Block.high", self.high, f"coordinates above those of low = {low}")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)

    def level(self, at: Places) -> np.ndarray:
        require_dim("Block.low", self.low, at.mesh)
        return np.minimum(at.coordinates - self.low, np.array(self.high) - at.coordinates).min(axis=1)


@dataclass(frozen=True)
class HalfSpace(Shape):
    """The half-space behind a plane; the plane's normal points out of the half-space.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    point : two or three numbers
        A point of the plane, a coordinate for each dimension.
    normal : as many numbers
        Outward normal of the plane, of any length.
    """

    point: Annotated[tuple[float, ...], Quantity("m", example=[0.0, 0.5])]
    normal: Annotated[tuple[float, ...], Quantity("1", example=[0.0, 1.0])]

    def __post_init__(self) -> None:
        point, normal = as_place("HalfSpace.point", self.point), as_place("HalfSpace.normal", self.normal)
        largest = max(map(abs, normal))
        if len(normal) != len(point) or largest == 0:
            expected = f"a nonzero vector with {len(point)} components"
            raise ParameterError("HalfSpace.normal", self.normal, expected)
        object.__setattr__(self, "point", point)
        scaled = [n / largest for n in normal]  # squares of the numbers given may leave the range of floats
        length = float(np.linalg.norm(scaled))
        object.__setattr__(self, "normal", tuple(n / length for n in scaled))

    def level(self, at: Places) -> np.ndarray:
        require_dim("HalfSpace.point", self.point, at.mesh)
        return (self.point - at.coordinates) @ np.array(self.normal)


@dataclass(frozen=True)
class Polygon(Shape):
    """A polygon of the plane, not necessarily convex.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    points : three pairs of numbers at least
        Corners, at least three, in either sense of rotation; the last corner is joined to the first, and
        edges must not cross.
    """

    points: Annotated[tuple[tuple[float, float], ...], Quantity("m", example=[[0, 0], [1, 0], [0, 1]])]

    def __post_init__(self) -> None:
        expected = "at least three points of two finite numbers"
        try:
            points = tuple(as_place("Polygon.points", point) for point in self.points)
        except TypeError:
            points = ()
        if len(points) < 3 or any(len(point) != 2 for point in points):
            raise ParameterError("Polygon.points", self.points, expected)
        object.__setattr__(self, "points", points)
        a, b = self._edges
        if not (np.linalg.norm(b - a, axis=1) > 0).all():
            expected = "points, none of which equals the point before it"
            raise ParameterError("Polygon.points", self.points, expected)
        if (otherwise := _expected_of_edges(a, b)) is not None:
            raise ParameterError("Polygon.points", self.points, otherwise)

    @property
    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        first = np.array(self.points)
        return first, np.roll(first, -1, axis=0)

    def level(self, at: Places) -> np.ndarray:
        if at.mesh.dim != 2:
            expected = "another shape, such as ClosedSurface, since a Polygon needs a mesh of two dimensions"
            raise ParameterError("Polygon.points", self.points, expected)
        p, is_inside = at.coordinates, np.zeros(len(at.coordinates), dtype=bool)
        distance = np.full(len(p), np.inf)
        for a, b in zip(*self._edges, strict=True):
            along = b - a
            share = np.clip((p - a) @ along / (along @ along), 0, 1)
            distance = np.minimum(distance, np.linalg.norm(p - a - share[:, None] * along, axis=1))
            spans = (a[1] > p[:, 1]) != (b[1] > p[:, 1])  # the edge spans the point's height
            if spans.any():
                where = a[0] + (p[spans, 1] - a[1]) / along[1] * along[0]
                is_inside[spans] ^= p[spans, 0] < where
        return np.where(is_inside, distance, -distance)


def _expected_of_edges(a: np.ndarray, b: np.ndarray) -> str | None:
    """Expectation for an error message if two of the edges a_i b_i cross or overlap; otherwise None."""
    along = b - a
    length = np.linalg.norm(along, axis=1)[:, None]
    ends = np.stack([a, b])[:, None] - a[None, :, None]  # (end, i, j): ends of edge j minus start of edge i
    off = along[:, None, 0] * ends[..., 1] - along[:, None, 1] * ends[..., 0]
    on = (along[:, None] * ends).sum(axis=-1) / length
    has_both_sides = np.sign(off).prod(axis=0) < 0
    rounding = 1e-12 * np.ptp(a, axis=0).max()
    common = np.minimum(on.max(axis=0), length) - np.maximum(on.min(axis=0), 0)
    is_collinear = (abs(off) <= rounding * length).all(axis=0) & ~np.eye(len(a), dtype=bool)
    for defect, expected in (
        (has_both_sides & has_both_sides.T, "points whose edges do not cross, but edges {} and {} cross"),
        (
            is_collinear & (common > rounding),
            "points whose edges do not overlap, but edges {} and {} overlap",
        ),
    ):
        if defect.any():
            return expected.format(*(np.argwhere(defect)[0] + 1))
    return None


@dataclass(frozen=True)
class Subdomain(Shape):
    """The cells of named subdomains (NGSolve: materials) of the mesh; no cell is cut.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    names : str or sequence of str
        Names of subdomains of the mesh.
    """

    names: Annotated[str | Sequence[str], Quantity(example=["inclusion"])]

    def __post_init__(self) -> None:
        require_fields(self)
        if not self.names:
            raise ParameterError("Subdomain.names", self.names, "at least one name")
        if isinstance(self.names, str):
            object.__setattr__(self, "names", (self.names,))

    def level(self, at: Places) -> np.ndarray:
        materials = at.mesh.GetMaterials()
        require_known("subdomain", self.names, materials, "Subdomain.names")
        is_named = np.array([name in self.names for name in materials])
        elements = at.mesh.ngmesh.Elements2D() if at.mesh.dim == 2 else at.mesh.ngmesh.Elements3D()
        index = elements.NumPy()["index"][at.cell_numbers]  # counted from 1
        return np.where(is_named[index - 1], 1.0, -1.0)


def as_shape(field: str, value: object) -> Shape:
    """Return a shape, converting a scalar coefficient function to ``Where``; raises ParameterError."""
    if isinstance(value, Shape):
        return value
    # a grid function is a coefficient function as well
    if isinstance(value, (CoefficientFunction, GridFunction)) and value.dim == 1:
        return Where(value)
    raise ParameterError(field, value, "a shape, or a scalar coefficient function that is positive inside")


def require_dim(field: str, value: Sequence[float], mesh: Mesh) -> None:
    """Raise ParameterError unless a place has as many coordinates as the mesh."""
    if len(value) != mesh.dim:
        expected = f"{mesh.dim} coordinates, since the mesh has {mesh.dim} dimensions"
        raise ParameterError(field, list(value), expected)

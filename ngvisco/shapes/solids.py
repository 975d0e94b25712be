"""Shapes of few numbers, balls, boxes, half-spaces, polygons; and the mesh's own named subdomains."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ngvisco.errors import ParameterError, Quantity, UnknownNameError, as_place, require_names, require_ranges
from ngvisco.shapes.places import Places
from ngvisco.shapes.shape import Shape, require_dim


@dataclass(frozen=True)
class Ball(Shape):
    """A ball, in two dimensions a disc.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    centre : two or three numbers
        Its centre, a coordinate for each dimension.
    radius : float
        Radius.
    """

    centre: Annotated[tuple[float, ...], Quantity("m", example=[0.6, 0.5])]
    radius: Annotated[float, Quantity("m", "> 0", 0.2)]

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", as_place("Ball.centre", self.centre))
        require_ranges(self)

    def level(self, at: Places) -> np.ndarray:
        require_dim("Ball.centre", self.centre, at.mesh)
        return self.radius - np.linalg.norm(at.coordinates - self.centre, axis=1)


@dataclass(frozen=True)
class Block(Shape):
    """The box between two corners, with edges along the axes.

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
        inside = np.minimum(at.coordinates - self.low, np.array(self.high) - at.coordinates)
        return inside.min(axis=1)


@dataclass(frozen=True)
class HalfSpace(Shape):
    """All that lies behind a plane, on the side that its normal points away from.

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
            raise ParameterError(
                "HalfSpace.normal", self.normal, f"a vector of length {len(point)}, not zero"
            )
        object.__setattr__(self, "point", point)
        scaled = [n / largest for n in normal]  # squares of the numbers given may leave the range of floats
        length = float(np.linalg.norm(scaled))
        object.__setattr__(self, "normal", tuple(n / length for n in scaled))

    def level(self, at: Places) -> np.ndarray:
        require_dim("HalfSpace.point", self.point, at.mesh)
        return (self.point - at.coordinates) @ np.array(self.normal)


@dataclass(frozen=True)
class Polygon(Shape):
    """A polygon of the plane, which need not be convex; the last point is joined to the first.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    points : three pairs of numbers at least
        Three corners at least, in either sense of rotation; the last is joined to the first, and edges do not
        cross each other.
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
            raise ParameterError("Polygon.points", self.points, "points that differ from the one before")
        crossing = _crossing(a, b)
        if crossing is not None:
            i, j = (k + 1 for k in crossing)
            raise ParameterError("Polygon.points", self.points, f"edges that do not cross: {i} and {j} do")
        overlap = _overlap(a, b)
        if overlap is not None:
            i, j = (k + 1 for k in overlap)
            raise ParameterError("Polygon.points", self.points, f"edges apart: {i} and {j} lie on each other")

    @property
    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        first = np.array(self.points)
        return first, np.roll(first, -1, axis=0)

    def level(self, at: Places) -> np.ndarray:
        if at.mesh.dim != 2:
            raise ParameterError("Polygon.points", self.points, "a mesh of the plane")
        p, is_inside = at.coordinates, np.zeros(len(at.coordinates), dtype=bool)
        distance = np.full(len(p), np.inf)
        for a, b in zip(*self._edges, strict=True):
            along = b - a
            share = np.clip((p - a) @ along / (along @ along), 0, 1)
            distance = np.minimum(distance, np.linalg.norm(p - a - share[:, None] * along, axis=1))
            spans = (a[1] > p[:, 1]) != (b[1] > p[:, 1])  # the ray to the right meets the edge's height
            if spans.any():
                where = a[0] + (p[spans, 1] - a[1]) / along[1] * along[0]
                is_inside[spans] ^= p[spans, 0] < where
        return np.where(is_inside, distance, -distance)


def _crossing(a: np.ndarray, b: np.ndarray) -> tuple[int, int] | None:
    """Two edges a_i b_i that cross in their interiors, or None."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return np.sign(
            (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1])
            - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        )

    A, B = a[:, None], b[:, None]
    apart = side(A, B, a[None]) * side(A, B, b[None]), side(a[None], b[None], A) * side(a[None], b[None], B)
    found = np.argwhere((apart[0] < 0) & (apart[1] < 0))
    return None if not len(found) else (int(found[0, 0]), int(found[0, 1]))


def _overlap(a: np.ndarray, b: np.ndarray) -> tuple[int, int] | None:
    """Two edges a_i b_i on one line that have a piece of it in common, or None."""
    along = b - a
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    ends = np.stack([a, b])[:, None] - a[None, :, None]  # (end, i, j): of edge j, from the start of edge i
    off = ends[..., 1] * along[:, None, 0] - ends[..., 0] * along[:, None, 1]
    on = ends[..., 0] * along[:, None, 0] + ends[..., 1] * along[:, None, 1]
    rounding = 1e-12 * np.ptp(a, axis=0).max()
    is_collinear = (abs(off) <= rounding).all(axis=0)
    common = np.minimum(on.max(axis=0), length[:, None]) - np.maximum(on.min(axis=0), 0)
    found = np.argwhere(is_collinear & (common > rounding) & ~np.eye(len(a), dtype=bool))
    return None if not len(found) else (int(found[0, 0]), int(found[0, 1]))


@dataclass(frozen=True)
class Subdomain(Shape):
    """The cells of named subdomains (NGSolve: materials) of the mesh: exactly these, nothing is cut.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    names : str or sequence of str
        Names of subdomains of the mesh.
    """

    names: Annotated[str | Sequence[str], Quantity(example=["inclusion"])]

    def __post_init__(self) -> None:
        names = (self.names,) if isinstance(self.names, str) else require_names("Subdomain.names", self.names)
        if not names:
            raise ParameterError("Subdomain.names", self.names, "at least one name")
        object.__setattr__(self, "names", tuple(names))

    def level(self, at: Places) -> np.ndarray:
        known = at.mesh.GetMaterials()
        for name in self.names:
            if name not in known:
                raise UnknownNameError("subdomain", name, known)
        wanted = np.array([name in self.names for name in known])
        elements = at.mesh.ngmesh.Elements2D() if at.mesh.dim == 2 else at.mesh.ngmesh.Elements3D()
        index = elements.NumPy()["index"][at.cell_numbers]  # from 1
        return np.where(wanted[index - 1], 1.0, -1.0)

"""The part of a plane in which a piecewise linear function is at or above a level, and the part's outline.

Triangles have columns of values at their corners; the first two columns are x and y.  All values are linear
between the corners.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

_CHUNK = 1_000_000
"""Number of pairs of a point and a segment whose distances are computed in one array."""
_BEARING = 1.5
"""Distance, in cells, up to which two places of an outline that face each other transmit forces: two lips
that are pressed together rest at 1.4 cells."""
_OPPOSITE = 0.8
"""Two places of an outline face each other if the cosine of the angles between outward normal and direction
to the other place is above this value."""


@dataclass(frozen=True)
class Cut:
    """The part of triangles where a function is at or above a level.

    Attributes
    ----------
    inside : array (parts, 3, columns)
        Triangles that make up the part, with all columns at their corners.
    ends : array (segments, 2, columns)
        Points where the outline enters and leaves a triangle; the part is on the left.
    edges : array (segments, 2)
        Numbers of the edges on which the ends lie; an edge shared by two triangles has one number.
    """

    inside: np.ndarray
    ends: np.ndarray
    edges: np.ndarray

    @classmethod
    def of(cls, corners: np.ndarray, points: np.ndarray, values: np.ndarray, level: float) -> Cut:
        """The cut of triangles at a level.

        ``corners`` are (triangles, 3, columns); ``points`` and ``values`` have the number of the point and
        the function's value at each corner, (triangles, 3).
        """
        a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
        turned = a[:, 0] * b[:, 1] < a[:, 1] * b[:, 0]
        order = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])
        above = np.take_along_axis(values, order, axis=1) >= level
        count = above.sum(axis=1)
        # the first corner is the one alone on its side of the line; the others follow counterclockwise
        alone = np.where(count == 1, above.argmax(axis=1), (~above).argmax(axis=1))
        order = np.take_along_axis(order, (alone[:, None] + [0, 1, 2]) % 3, axis=1)
        corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        points, values = (np.take_along_axis(array, order, axis=1) for array in (points, values))
        lone, pair = count == 1, count == 2
        falls = np.where((lone | pair)[:, None], values[:, :1] - values[:, 1:], 1.0)
        shares = (values[:, :1] - level) / falls
        first, second = (
            corners[:, 0] + shares[:, i, None] * (corners[:, 1 + i] - corners[:, 0]) for i in (0, 1)
        )
        inside = [
            corners[count == 3],
            np.stack([corners[lone, 0], first[lone], second[lone]], axis=1),
            np.stack([corners[pair, 1], corners[pair, 2], second[pair]], axis=1),
            np.stack([corners[pair, 1], second[pair], first[pair]], axis=1),
        ]
        ends = [np.stack([first[lone], second[lone]], axis=1), np.stack([second[pair], first[pair]], axis=1)]
        size = int(points.max(initial=0)) + 1
        pairs = np.sort(np.stack([points[:, [0, 1]], points[:, [0, 2]]], axis=1), axis=2)
        numbers = pairs[..., 0] * size + pairs[..., 1]
        edges = np.concatenate([numbers[lone], numbers[pair][:, ::-1]])
        return cls(np.concatenate(inside), np.concatenate(ends), edges)

    @property
    def length(self) -> float:
        """The length of the outline."""
        return float(np.linalg.norm(self.ends[:, 1, :2] - self.ends[:, 0, :2], axis=1).sum())

    def lines(self) -> Iterator[np.ndarray]:
        """Yield the outline as polylines, (points, columns) each; a closed line ends with its first point."""
        after = {int(start): i for i, start in enumerate(self.edges[:, 0])}
        reached = set(map(int, self.edges[:, 1]))
        # open lines come before closed lines
        begun = [i for i, start in enumerate(self.edges[:, 0]) if int(start) not in reached]
        left = dict.fromkeys(range(len(self.edges)))
        for start in (*begun, *range(len(self.edges))):
            if start not in left:
                continue
            line, i = [self.ends[start, 0]], start
            while i in left:
                del left[i]
                line.append(self.ends[i, 1])
                i = after.get(int(self.edges[i, 1]), -1)
            yield np.array(line)


@dataclass(frozen=True)
class Moments:
    """Area, centre, second moments and mean motion of a part of the plane.

    Attributes
    ----------
    area : float, m^2
    centre : array (2,), m
    second : array (2, 2), m^2
        The mean of (x - c)(x - c)^T.
    gradient : array (2, 2), 1/s
        Gradient L of the linear velocity about the centre that fits v best in the mean square.
    """

    area: float
    centre: np.ndarray
    second: np.ndarray
    gradient: np.ndarray

    @classmethod
    def of(cls, inside: np.ndarray) -> Moments | None:
        """Moments of triangles whose first columns are x, y, v_1, v_2; None without an area."""
        if not len(inside):
            return None
        origin = inside[:, :, :2].mean(axis=(0, 1))  # moments about a distant origin would lose digits
        x = inside[:, :, :2] - origin
        columns = np.concatenate([np.ones_like(x[:, :, :1]), x, inside[:, :, 2:4]], axis=2)
        a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        areas, sums = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), columns.sum(axis=1)
        # int f g of linear f, g over a triangle is |K|/12 (sum f sum g + sum f g)
        products = np.einsum("t,ti,tj->ij", areas, sums, sums)
        products += np.einsum("t,tai,taj->ij", areas, columns, columns)
        products /= 12
        area = float(products[0, 0])
        if not area > 0:
            return None
        means = products[0, 1:] / area
        spread = products[1:, 1:] / area - np.outer(means, means)
        second = spread[:2, :2]
        return cls(area, means[:2] + origin, second, spread[2:, :2] @ np.linalg.inv(second))

    def ellipse(self) -> tuple[float, float, float]:
        """Length L and breadth B, m, of the ellipse with these moments, and the angle of L with x, rad from
        -pi/2 to pi/2."""
        squares, axes = np.linalg.eigh(self.second)
        angle = float(np.arctan2(axes[1, 1], axes[0, 1]))
        angle -= np.pi * round(angle / np.pi)
        return 4 * float(np.sqrt(squares[1])), 4 * float(np.sqrt(squares[0])), angle

    def turning(self) -> float:
        """Rate at which matter turns in coordinates that make the ellipse of inertia a disc, rad/s.

        With second moments M = S^2 and M' = L M + M L^T the rate is the skew part of S^-1 L S - S^-1 S', the
        rate of the rotation R in F = S R.  For a rigid rotation the rate is the angular velocity; for an
        ellipse at rest with circulating matter the rate is 2 pi over the period.
        """
        squares, axes = np.linalg.eigh(self.second)
        s = np.sqrt(squares)
        L = axes.T @ self.gradient @ axes
        rate = (L * squares + squares[:, None] * L.T) / (s[:, None] + s)  # S' from S S' + S' S = M'
        W = (L * s - rate) / s[:, None]
        return float(np.linalg.det(axes) * (W[1, 0] - W[0, 1]) / 2)


@dataclass(frozen=True)
class Gap:
    """The closest points of two outlines: a point of one outline, and a point on a segment of the other.

    Attributes
    ----------
    width : float, m
    is_turned : bool
        Whether the point is on the second outline, and the segment on the first.
    point, segment : int
        Number of the segment that begins at the point, and of the segment on the other outline.
    share : float
        Place of the closest point on the segment, 0 at its start and 1 at its end.
    image : array (2,), m
        Displacement of the other outline's nearest image across periodic boundaries.
    """

    width: float
    is_turned: bool
    point: int
    segment: int
    share: float
    image: np.ndarray


def closest(one: np.ndarray, other: np.ndarray, images: np.ndarray) -> Gap | None:
    """The closest place of outlines that do not cross, (segments, 2, columns) each; None if one is empty.

    ``images``, (count, 2), are the displacements of the images of the other outline, with zero for itself.
    """
    if not (len(one) and len(other)):
        return None
    gaps = []
    for image in images:
        moved = displaced(other, image)
        for points, ends, is_turned in ((one, moved, False), (moved, one, True)):
            gaps.append(Gap(*_to_segments(points[:, 0, :2], ends, is_turned), image))
    return min(gaps, key=lambda gap: gap.width)


def displaced(ends: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Segments, (segments, 2, columns), whose places are displaced."""
    result = ends.copy()
    result[:, :, :2] += by
    return result


def distance(one: np.ndarray, other: np.ndarray, images: np.ndarray) -> float:
    """Least distance of outlines that do not cross, (segments, 2, columns) each; inf if one is empty."""
    gap = closest(one, other, images)
    return np.inf if gap is None else gap.width


def facing(points: np.ndarray, outwards: np.ndarray, sizes: np.ndarray, images: np.ndarray) -> float | None:
    """Least distance, in cells, between two places of a surface that face each other across the outside.

    The surface has ``points`` and unit normals ``outwards``, (points, dim), and ``sizes`` of cells there.
    Places that are more than ``_BEARING`` cells apart are not compared; the result is None if none face each
    other.  ``images`` are displacements of the surface's images across periodic boundaries, with zero for the
    surface itself.
    """
    if len(points) < 2:
        return None
    count = len(images)
    middle = np.concatenate([points + image for image in images])
    outwards, sizes = np.tile(outwards, (count, 1)), np.tile(sizes, count)
    i, j = cKDTree(middle).query_pairs(_BEARING * sizes.max(), output_type="ndarray").T
    off = middle[j] - middle[i]
    width = np.linalg.norm(off, axis=1)
    across = np.minimum((outwards[i] * off).sum(axis=1), -(outwards[j] * off).sum(axis=1))
    cells = width / np.minimum(sizes[i], sizes[j])
    found = cells[(across > _OPPOSITE * width) & (cells < _BEARING)]
    return float(found.min()) if len(found) else None


def level_surface(corners: np.ndarray, values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """In each simplex that a level cuts: the middle of the level's surface, and its unit normal, which points
    down the slope.

    ``corners``, (simplices, dim + 1, dim), and ``values``, (simplices, dim + 1), are those of simplices with
    such a surface.
    """
    dim = corners.shape[2]
    slopes = np.linalg.solve(corners[:, 1:] - corners[:, :1], (values[:, 1:] - values[:, :1])[:, :, None])
    sums, number = np.zeros((len(corners), dim)), np.zeros(len(corners))
    for i, j in combinations(range(dim + 1), 2):
        is_cut = (values[:, i] >= level) != (values[:, j] >= level)
        share = (values[:, i] - level) / np.where(is_cut, values[:, i] - values[:, j], 1.0)
        sums += is_cut[:, None] * (corners[:, i] + share[:, None] * (corners[:, j] - corners[:, i]))
        number += is_cut
    return sums / number[:, None], -slopes[:, :, 0] / np.linalg.norm(slopes[:, :, 0], axis=1, keepdims=True)


def _to_segments(
    points: np.ndarray, ends: np.ndarray, is_turned: bool
) -> tuple[float, bool, int, int, float]:
    """Least distance of points from segments, and the place of the least distance, as the attributes of a
    ``Gap``."""
    start, along = ends[:, 0, :2], ends[:, 1, :2] - ends[:, 0, :2]
    squares = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    least, place, step = np.inf, (0, 0, 0.0), max(1, _CHUNK // len(ends))
    for first in range(0, len(points), step):
        off = points[first : first + step, None] - start
        share = np.clip((off * along).sum(axis=2) / squares, 0, 1)
        apart = ((off - share[:, :, None] * along) ** 2).sum(axis=2)
        i, j = np.unravel_index(apart.argmin(), apart.shape)
        if apart[i, j] < least:
            least, place = float(apart[i, j]), (first + int(i), int(j), float(share[i, j]))
    return float(np.sqrt(least)), is_turned, *place

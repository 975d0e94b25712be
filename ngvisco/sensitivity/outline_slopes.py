"""Slopes of measures of a region {theta >= 1/2} in the plane by theta and v at the corners of triangles.

theta is linear in each triangle. The outline O moves outwards by delta theta/|grad theta|, so that

    delta int_{theta >= 1/2} f = int_O f delta theta / |grad theta| + int_{theta >= 1/2} delta f,

and an end p of a segment of O, on an edge with the direction d, moves by -d delta theta(p)/(d . grad theta).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ngvisco.run.outlines import Cut, Gap, Moments
from ngvisco.sensitivity.parameters import OFFSETS, STEP, differenced

_SIMPSON = ((0.0, 1 / 6), (0.5, 2 / 3), (1.0, 1 / 6))
"""Places on a segment and weights of Simpson's rule.  The rule is exact, since the integrands here have
degree three."""
_PLACE, _VELOCITY, _SHARES = slice(0, 2), slice(2, 4), slice(4, 7)
"""Columns of a traced cut: place, velocity, and shares of the three corners."""

Corners = tuple[np.ndarray, np.ndarray]
"""Slopes by theta, (triangles, 3), and by the velocity, (triangles, 3, 2), at the corners of triangles."""


@dataclass(frozen=True)
class OutlineSlopes:
    """Slopes for one region at one state.

    Attributes
    ----------
    cut : Cut
        The region, with columns x, y, v_1, v_2, shares of a triangle's corners, and the triangle's number.
    places : array (triangles, 3, 2)
        Corners of all triangles.
    theta : array (triangles, 3)
        Values at the corners.
    """

    cut: Cut
    places: np.ndarray
    theta: np.ndarray

    @property
    def _gradients(self) -> np.ndarray:
        """grad theta in each triangle, (triangles, 2)."""
        edges = self.places[:, 1:] - self.places[:, :1]
        rises = self.theta[:, 1:] - self.theta[:, :1]
        return np.linalg.solve(edges, rises[:, :, None])[:, :, 0]

    @property
    def _triangles(self) -> np.ndarray:
        """The triangle of each segment, (segments,)."""
        return np.rint(self.cut.ends[:, 0, -1]).astype(int)

    def _of_region(self, f: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Slopes by theta of the integral of f over the region; f is a quadratic function of the columns of
        ``cut``."""
        ends, numbers = self.cut.ends, self._triangles
        sizes = np.linalg.norm(ends[:, 1, _PLACE] - ends[:, 0, _PLACE], axis=1)
        sizes = sizes / np.linalg.norm(self._gradients[numbers], axis=1)
        result = np.zeros_like(self.theta)
        for place, weight in _SIMPSON:
            point = (1 - place) * ends[:, 0] + place * ends[:, 1]
            np.add.at(result, numbers, (weight * sizes * f(point))[:, None] * point[:, _SHARES])
        return result

    def _of_velocity(self, f: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Slopes by v of the region's integral of f . v.  The vector f is a linear function of the columns of
        ``cut``."""
        inside, result = self.cut.inside, np.zeros((*self.theta.shape, 2))
        areas = 0.5 * abs(np.linalg.det(inside[:, 1:, _PLACE] - inside[:, :1, _PLACE]))
        shares, values = inside[:, :, _SHARES], f(inside)
        products = np.einsum("tk,ta->tka", shares.sum(axis=1), values.sum(axis=1))
        products += np.einsum("tck,tca->tka", shares, values)
        np.add.at(result, np.rint(inside[:, 0, -1]).astype(int), areas[:, None, None] / 12 * products)
        return result

    def of_ends(self, weights: np.ndarray) -> Corners:
        """Slopes of the sum of ``weights``, (segments, 2, 2), times the places of the segments' ends."""
        numbers, result = self._triangles, np.zeros_like(self.theta)
        each = np.arange(len(numbers))
        for end in (0, 1):
            shares = self.cut.ends[:, end, _SHARES]
            opposite = shares.argmin(axis=1)  # the end lies on the edge of the two other corners
            first, second = (self.places[numbers, (opposite + i) % 3] for i in (1, 2))
            along = second - first
            rise = (along * self._gradients[numbers]).sum(axis=1)
            rates = -(weights[each, end] * along).sum(axis=1) / rise
            np.add.at(result, numbers, rates[:, None] * shares)
        return result, np.zeros((*self.theta.shape, 2))

    def perimeter(self) -> Corners:
        """Slopes of the outline's length."""
        along = self.cut.ends[:, 1, _PLACE] - self.cut.ends[:, 0, _PLACE]
        tangent = along / np.maximum(np.linalg.norm(along, axis=1), np.finfo(float).tiny)[:, None]
        return self.of_ends(np.stack([-tangent, tangent], axis=1))

    def inside(self) -> Corners:
        """Slopes of the area."""
        return self._of_region(lambda at: np.ones(len(at))), np.zeros((*self.theta.shape, 2))

    def _of_moments(self, moments: Moments, by_second: np.ndarray, by_mixed: np.ndarray) -> Corners:
        """Slopes of a function of the moments M = mean of x x^T and C = mean of v x^T about the means,
        computed from the function's slopes by M and by C, (2, 2) each."""
        mixed, area = moments.gradient @ moments.second, moments.area
        mean = self._mean_velocity()

        def density(at: np.ndarray) -> np.ndarray:
            x, v = at[:, _PLACE] - moments.centre, at[:, _VELOCITY] - mean
            values: np.ndarray = (
                np.einsum("ij,pi,pj->p", by_second, x, x) - (by_second * moments.second).sum()
            )
            return (values + np.einsum("ij,pi,pj->p", by_mixed, v, x) - (by_mixed * mixed).sum()) / area

        of_velocity = self._of_velocity(lambda at: (at[:, :, _PLACE] - moments.centre) @ by_mixed.T / area)
        return self._of_region(density), of_velocity

    def _mean_velocity(self) -> np.ndarray:
        inside = self.cut.inside
        areas = 0.5 * abs(np.linalg.det(inside[:, 1:, _PLACE] - inside[:, :1, _PLACE]))
        return areas @ inside[:, :, _VELOCITY].mean(axis=1) / areas.sum()

    def deformation(self, column: str) -> Corners:
        """Slopes of ``"L"``, ``"B"``, ``"D"`` or ``"angle"`` of the ellipse of inertia.

        Where L = B these columns have no slope: the result for ``"angle"`` is infinite or NaN, and the other
        results depend on an arbitrary choice of the axes.
        """
        moments = self._moments()
        squares, axes = np.linalg.eigh(moments.second)
        short, long = axes.T
        B, L = 4 * np.sqrt(squares)
        of_L, of_B = 8 / L * np.outer(long, long), 8 / B * np.outer(short, short)
        turned = np.array([-long[1], long[0]])
        across = np.outer(turned, long) + np.outer(long, turned)
        of_D, of_angle = 2 * (B * of_L - L * of_B) / (L + B) ** 2, 0.5 * across / (squares[1] - squares[0])
        by_second = {"L": of_L, "B": of_B, "D": of_D, "angle": of_angle}[column]
        return self._of_moments(moments, by_second, np.zeros((2, 2)))

    def turning(self) -> Corners:
        """Slopes of the rate of tank-treading, a linear function of the velocity."""
        moments = self._moments()
        M, mixed = moments.second, moments.gradient @ moments.second

        def rate(M: np.ndarray, C: np.ndarray) -> float:
            return replace(moments, second=M, gradient=C @ np.linalg.inv(M)).turning()

        by_second, by_mixed, h = np.zeros((2, 2)), np.zeros((2, 2)), STEP * np.linalg.eigvalsh(M)[0]
        for i in range(2):
            for j in range(2):
                unit = np.zeros((2, 2))
                unit[i, j] = 1.0
                by_mixed[i, j] = rate(M, unit)
                unit = 0.5 * (unit + unit.T)
                values = [np.array(rate(M + offset * h * unit, mixed)) for offset in OFFSETS[4]]
                by_second[i, j] = differenced(values, h)
        return self._of_moments(moments, by_second, by_mixed)

    def _moments(self) -> Moments:
        moments = Moments.of(self.cut.inside)
        assert moments is not None  # a body without a region has no slopes
        return moments


def of_gap(gap: Gap, one: Cut, other: Cut) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the distance of two outlines by the ends of their segments, (segments, 2, 2) each."""
    of_point, of_segment = (other, one) if gap.is_turned else (one, other)
    start, end = of_segment.ends[gap.segment, :, _PLACE]
    image = gap.image if gap.is_turned else -gap.image
    off = of_point.ends[gap.point, 0, _PLACE] + image - (1 - gap.share) * start - gap.share * end
    n = off / gap.width
    by_point, by_segment = (np.zeros((len(cut.ends), 2, 2)) for cut in (of_point, of_segment))
    by_point[gap.point, 0] = n
    by_segment[gap.segment] = -np.array([1 - gap.share, gap.share])[:, None] * n
    return (by_segment, by_point) if gap.is_turned else (by_point, by_segment)

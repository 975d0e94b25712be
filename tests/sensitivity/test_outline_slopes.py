"""Slopes of measures of a region by values at corners, against differences."""

import numpy as np
import pytest

from ngvisco.run.outlines import Cut, Moments, closest
from ngvisco.sensitivity.outline_slopes import OutlineSlopes, of_gap

COUNT = 12
LEVEL = 0.5


def triangles():
    """A square of side 1, cut into triangles with corners, and the numbers of the corners."""
    line = np.linspace(0, 1, COUNT + 1)
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (np.arange(COUNT)[:, None] * (COUNT + 1) + np.arange(COUNT)).ravel()
    up, right = first + 1, first + COUNT + 1
    numbers = np.concatenate([np.stack([first, right, up], 1), np.stack([right, right + 1, up], 1)])
    return points, numbers


POINTS, NUMBERS = triangles()
X = POINTS - [0.4, 0.55]
THETA = 0.5 + 0.3 - np.sqrt(1.3 * X[:, 0] ** 2 + X[:, 1] ** 2 + 0.4 * X[:, 0] * X[:, 1])
OTHER = 0.5 + 0.15 - np.linalg.norm(POINTS - [0.9, 0.9], axis=1)
V = np.stack([X[:, 1] + X[:, 0] ** 2, -0.4 * X[:, 0] + 0.2 * X[:, 0] * X[:, 1]], axis=1)


def cut_of(theta, v=V):
    """The region as ``FractionSamples.traced`` gives it."""
    corners, count = POINTS[NUMBERS], len(NUMBERS)
    columns = [corners, v[NUMBERS], np.broadcast_to(np.eye(3), (count, 3, 3))]
    columns.append(np.broadcast_to(np.arange(count, dtype=float)[:, None, None], (count, 3, 1)))
    return Cut.of(np.concatenate(columns, axis=2), NUMBERS, theta[NUMBERS], LEVEL)


def slopes_of(theta):
    return OutlineSlopes(cut_of(theta), POINTS[NUMBERS], theta[NUMBERS])


MEASURES = {
    "L": lambda cut: Moments.of(cut.inside).ellipse()[0],
    "B": lambda cut: Moments.of(cut.inside).ellipse()[1],
    "D": lambda cut: np.divide(*np.dot([[1, -1], [1, 1]], Moments.of(cut.inside).ellipse()[:2])),
    "angle": lambda cut: Moments.of(cut.inside).ellipse()[2],
    "inside": lambda cut: Moments.of(cut.inside).area,
    "perimeter": lambda cut: cut.length,
    "turning": lambda cut: Moments.of(cut.inside).turning(),
}


@pytest.mark.parametrize("name", MEASURES)
def test_slopes_of_an_outline_s_measures_are_limits_of_differences(name):
    outline, measure = slopes_of(THETA), MEASURES[name]
    own = getattr(outline, name, None)
    by_theta, by_v = outline.deformation(name) if own is None else own()
    random = np.random.default_rng(1)
    change, of_v = random.standard_normal(len(POINTS)), random.standard_normal((len(POINTS), 2))
    h = 1e-5
    up, down = (measure(cut_of(THETA + s * h * change, V + s * h * of_v)) for s in (1, -1))
    found = (by_theta * change[NUMBERS]).sum() + (by_v * of_v[NUMBERS]).sum()
    assert found == pytest.approx((up - down) / (2 * h), rel=1e-6)


def test_the_gap_has_slopes_with_respect_to_both_outlines():
    random, h = np.random.default_rng(2), 1e-6
    changes = [random.standard_normal(len(POINTS)) for _ in range(2)]
    fields = (THETA, OTHER)
    for order in ((0, 1), (1, 0)):
        outlines = [slopes_of(fields[i]) for i in order]
        cuts = [outline.cut for outline in outlines]
        parts = of_gap(closest(*(cut.ends for cut in cuts), np.zeros((1, 2))), *cuts)
        pairs = zip(outlines, parts, order, strict=True)
        found = sum((outline.of_ends(part)[0] * changes[i][NUMBERS]).sum() for outline, part, i in pairs)
        up, down = (
            closest(*(cut_of(fields[i] + s * h * changes[i]).ends for i in order), np.zeros((1, 2))).width
            for s in (1, -1)
        )
        assert found == pytest.approx((up - down) / (2 * h), rel=1e-6)

"""Surfaces of bodies in pictures: the lines where a volume fraction is one half.

Fractions jump between cells, and lines of the single cells would have gaps where a jump passes one half.  So
the lines are those of the fraction that is averaged at points where cells meet, and between these points they
follow a smooth function through its values, not the edges of cells.
"""

import importlib
from collections.abc import Sequence
from itertools import takewhile
from typing import Any

import numpy as np

OUTLINE: dict[str, Any] = {"levels": [0.5], "colors": "white", "linewidths": 1.4}
"""How matplotlib draws them."""
_SAME = 1e-9  # of the points' extent: those this close are one
_FLAT = 1e-6  # of the largest triangle: what is smaller is a corner or an edge
_HALVINGS = 2  # of the triangles in which a line is drawn


def averaged(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at points, each the mean of those at the same place.

    Parameters
    ----------
    points : array (points, dim), m
    values : array (..., points)
    """
    _, place = np.unique(whole_numbers(points), axis=0, return_inverse=True)
    place = place.reshape(-1)
    count = np.bincount(place)
    rows = values.reshape(-1, values.shape[-1])
    means = [(np.bincount(place, weights=row) / count)[place] for row in rows]
    return np.array(means).reshape(values.shape)


def whole_numbers(points: np.ndarray) -> np.ndarray:
    """Whole numbers that are the same for points that are one, in a domain of any size."""
    size = float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    return np.round(points / (_SAME * size)).astype(np.int64)


def outline(axis: Any, X: np.ndarray, Y: np.ndarray, triangles: np.ndarray, fraction: np.ndarray) -> Any:
    """Draw the line of a fraction at the corners of triangles, averaged; None where it has none."""
    if not fraction.min() < 0.5 < fraction.max():  # matplotlib warns of lines that are not there
        return None
    tri = importlib.import_module("matplotlib.tri")
    points = np.stack([X, Y], axis=1)
    _, first, number = np.unique(whole_numbers(points), axis=0, return_index=True, return_inverse=True)
    cells, (X, Y), values = number.reshape(-1)[triangles], points[first].T, fraction[first]
    a, b, c = np.moveaxis(points[first][cells], 1, 0)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    cells = cells[area > _FLAT * area.max()]  # a section has corners and edges of cells too
    is_cut = (values[cells].min(axis=1) < 0.5) & (values[cells].max(axis=1) > 0.5)
    near = cells[np.isin(cells, cells[is_cut]).any(axis=1)]
    mesh = tri.Triangulation(X, Y, near)
    finer, smooth = tri.UniformTriRefiner(mesh).refine_field(values, subdiv=_HALVINGS)
    return axis.tricontour(finer, smooth, **OUTLINE)


def outlined(names: Sequence[str]) -> list[str]:
    """Of the names of a run's fields the fractions that outline its bodies.

    They stand together before ``body``: a passive field may be named like them.  All but the last, whose
    surface is that of the others.
    """
    before = list(names)[: list(names).index("body")] if "body" in names else []
    backwards = takewhile(lambda name: name.endswith("_fraction"), reversed(before))
    return list(backwards)[:0:-1]

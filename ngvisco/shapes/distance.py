"""Signed distance from a shape's outline in the plane, as polynomials on the cells.

In cells near the outline the level is interpolated linearly in sub-cells.  The zeros of the interpolated
level are straight pieces of the outline.  The distance has the sign of the level, and is interpolated by
discontinuous polynomials.
"""

from __future__ import annotations

import numpy as np
from ngsolve import L2, VOL, ElementId, GridFunction, Mesh

from ngvisco.parallel.communicator import Communicator
from ngvisco.shapes.fractions import HasLevel, subdivision
from ngvisco.shapes.places import Places

_PIECES = 32
"""Number of pieces into which the edges of a cell are divided if the outline crosses the cell."""
_LOOKED_AT = 4
"""Number of pieces of a cell's edges; levels are tested at the ends of the pieces."""
_NEAREST = 6
"""Number of pieces of the outline, the nearest by their middles, whose distance is computed."""


def signed_distance(mesh: Mesh, shape: HasLevel, order: int) -> GridFunction:
    """Distance from the outline of a shape, > 0 inside, in discontinuous P_order; mesh of triangles.

    At the outline the error is of second order in h/32, with the size h of a cell.  At corners of the outline
    the error is the error of the interpolation.
    """
    cells, ranks = np.arange(mesh.ne), Communicator.of(mesh)
    outline = np.concatenate(ranks.gathered(_outline(mesh, cells, shape)))
    places = Places(mesh, cells, lattice(order))
    level, points = shape.level(places), places.coordinates
    size = ranks.most(float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0)
    distance = _distances(points, outline) if len(outline) else np.full(len(points), size)
    result = GridFunction(L2(mesh, order=order))
    _set(result, places, np.where(level > 0, distance, -distance))
    return result


def _outline(mesh: Mesh, cells: np.ndarray, shape: HasLevel) -> np.ndarray:
    """Straight pieces of the outline in cells, (pieces, 2 ends, 2), m."""
    corners, _ = subdivision(2, _LOOKED_AT)
    level = shape.level(Places(mesh, cells, corners)).reshape(len(cells), len(corners))
    cells = cells[(level > 0).any(axis=1) & (level <= 0).any(axis=1)]
    corners, pieces = subdivision(2, _PIECES)
    places = Places(mesh, cells, corners, pieces)
    shaped = len(cells), len(corners)
    level, points = shape.level(places).reshape(shaped), places.coordinates.reshape(*shaped, 2)
    level, points = level[:, pieces].reshape(-1, 3), points[:, pieces].reshape(-1, 3, 2)
    is_inside = level > 0
    is_cut = is_inside.any(axis=1) & ~is_inside.all(axis=1)
    level, points, is_inside = level[is_cut], points[is_cut], is_inside[is_cut]
    lonely = np.where(is_inside.sum(axis=1) == 1, is_inside.argmax(axis=1), is_inside.argmin(axis=1))
    rows, ends = np.arange(len(level)), []
    for other in (1, 2):
        next_to = (lonely + other) % 3
        a, b = level[rows, lonely], level[rows, next_to]
        share = (a / np.where(a == b, 1.0, a - b))[:, None]
        ends.append((1 - share) * points[rows, lonely] + share * points[rows, next_to])
    return np.stack(ends, axis=1)


def _distances(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Distance of points, (points, 2), from the pieces of the outline."""
    from scipy.spatial import cKDTree  # takes a tenth of a second to import

    count = min(_NEAREST, len(outline))
    _, near = cKDTree(outline.mean(axis=1)).query(points, k=count)
    begin, end = np.moveaxis(outline[near.reshape(len(points), count)], 2, 0)
    along, away = end - begin, points[:, None] - begin
    squares = np.maximum((along**2).sum(axis=2), np.finfo(float).tiny)
    share = np.clip((along * away).sum(axis=2) / squares, 0.0, 1.0)[:, :, None]
    return np.asarray(np.linalg.norm(away - share * along, axis=2).min(axis=1))


def lattice(order: int) -> np.ndarray:
    """Points of the reference triangle that determine a polynomial, (points, 2); ``order`` >= 1."""
    return np.array([(i / order, j / order) for i in range(order + 1) for j in range(order + 1 - i)])


def _set(function: GridFunction, places: Places, values: np.ndarray) -> None:
    """Set a discontinuous polynomial to ``values`` at its lattice in each cell, (cells * points,)."""
    cells, count = len(places.cells), len(places.reference)
    numbers = [function.space.GetDofNrs(ElementId(VOL, cell)) for cell in range(cells)]
    at = np.array(numbers, dtype=int).reshape(cells, count)
    unit, matrix = GridFunction(function.space), np.empty((cells, count, count))
    for j in range(count):
        unit.vec.FV().NumPy()[:] = 0.0
        unit.vec.FV().NumPy()[at[:, j]] = 1.0
        matrix[:, :, j] = places.values(unit).reshape(cells, count)
    function.vec.FV().NumPy()[at] = np.linalg.solve(matrix, values.reshape(cells, count, 1))[:, :, 0]

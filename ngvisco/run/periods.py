"""Translations between identified boundaries, and parts of a region put together across them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from ngsolve import VERTEX, Mesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ngvisco.parallel.communicator import Communicator

_SAME = 1e-9
"""Distance, in sizes of the domain, below which two points are one place."""


@dataclass(frozen=True)
class Periods:
    """The periods of a domain; without periodic boundaries there are none.

    Attributes
    ----------
    vectors : array (count, dim), m
        One translation for each pair of directions, from a boundary to its image.
    """

    vectors: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, ranks: Communicator) -> Periods:
        """The periods of a mesh; collective."""
        pairs = np.array([pair for pair, _ in mesh.GetPeriodicNodePairs(VERTEX)], dtype=int).reshape(-1, 2)
        corners = np.array([mesh.vertices[i].point for i in pairs.ravel()]).reshape(-1, 2, mesh.dim)
        between = np.concatenate(ranks.gathered(corners[:, 1] - corners[:, 0]))
        size = float(abs(between).max(initial=0.0)) or 1.0
        rounded = np.round(between / (_SAME * size)).astype(np.int64)
        # a boundary may be the first or the second of its pair
        leading = rounded[np.arange(len(rounded)), (rounded != 0).argmax(axis=1)]
        _, first = np.unique(rounded * np.sign(leading)[:, None], axis=0, return_index=True)
        return cls(between[first] * np.sign(leading[first])[:, None])

    @property
    def images(self) -> np.ndarray:
        """Displacements of the domain's nearest images, and zero, (3^count, dim)."""
        return _combinations(self.vectors)

    def pairs(self, points: np.ndarray) -> list[np.ndarray]:
        """For each period, numbers (pairs, 2) of points and of their images."""
        if not len(self.vectors):
            return []
        tree, size = cKDTree(points), float(np.ptp(points, axis=0).max(initial=0.0))
        result = []
        for vector in self.vectors:
            distance, image = tree.query(points + vector, distance_upper_bound=_SAME * size)
            result.append(np.stack([np.flatnonzero(np.isfinite(distance)), image[np.isfinite(distance)]], 1))
        return result

    def offsets(
        self, points: np.ndarray, cells: np.ndarray, is_inside: np.ndarray, pairs: list[np.ndarray]
    ) -> np.ndarray:
        """Displacements of cells, (cells, dim), that put the parts of a region together across periodic
        boundaries.

        The corners of ``cells``, (cells, corners), are numbers of ``points``, (points, dim). ``is_inside``
        says for each point whether it is in the region. ``pairs`` is the result of the method ``pairs`` for
        these points. The largest part of the region stays in its place; parts that meet their own image along
        a period are not displaced along it. A cell outside the region is displaced to the image that is
        nearest to the region.
        """
        part, free = _connected(cells, is_inside), np.ones(len(self.vectors), dtype=bool)
        joints = []
        for number, (start, end) in enumerate(both.T for both in pairs):
            kept = is_inside[start] & is_inside[end]
            joined = np.unique(np.stack([part[start[kept]], part[end[kept]]], axis=1), axis=0)
            step = np.eye(len(self.vectors), dtype=int)[number]
            joints += [(a, b, -step) for a, b in joined.tolist()] + [(b, a, step) for a, b in joined.tolist()]
        of_parts = np.zeros((part.max(initial=-1) + 1, len(self.vectors)), dtype=int)
        left = set(np.unique(part[is_inside]).tolist())
        for first in np.argsort(-np.bincount(part[is_inside], minlength=1), kind="stable").tolist():
            if first in left:
                found = _followed(first, joints, len(self.vectors))
                left -= set(found)
                is_open = np.ones(len(self.vectors), dtype=bool)
                for a, b, step in joints:
                    is_open &= a not in found or found[a] + step == found[b]
                free &= is_open
                of_parts[list(found)] = np.array(list(found.values())) * is_open
        count = len(is_inside)
        corner = np.where(is_inside[cells], cells, count).min(axis=1)
        result: np.ndarray = np.append(of_parts[part], np.zeros((1, len(self.vectors)), dtype=int), axis=0)
        result = result[corner] @ self.vectors
        edge, away = (corner < count) & ~is_inside[cells].all(axis=1), corner == count
        if free.any() and edge.any():
            centres, images = points[cells].mean(axis=1), _combinations(self.vectors[free])
            edges = centres[edge] + result[edge] + images[:, None]
            _, nearest = cKDTree(edges.reshape(-1, points.shape[1])).query(centres[away])
            result[away] = -images[nearest // edges.shape[1]]
        return result

    def folded(self, points: np.ndarray, domain: np.ndarray) -> np.ndarray:
        """``points``, displaced by whole periods into the mesh, whose points are ``domain``."""
        if not len(self.vectors):
            return points
        along = np.linalg.pinv(self.vectors)
        return points - np.floor(points @ along - (domain @ along).min(axis=0)) @ self.vectors


def _combinations(vectors: np.ndarray) -> np.ndarray:
    """Sums of vectors, each with one of the signs 0, 1 and -1, (3^count, dim); the first is zero."""
    return np.array(list(product((0.0, 1.0, -1.0), repeat=len(vectors)))) @ vectors


def merged(count: int, pairs: list[np.ndarray]) -> np.ndarray:
    """Numbers of ``count`` points, (count,), that are equal for points that are images of each other."""
    return _components(count, np.concatenate([np.zeros((0, 2), dtype=int), *pairs]))


def _components(count: int, ends: np.ndarray) -> np.ndarray:
    """Numbers of the connected components of points with edges ``ends``, (edges, 2)."""
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _connected(cells: np.ndarray, is_inside: np.ndarray) -> np.ndarray:
    """Number of the part to which each point belongs; points inside the region that share a cell belong to
    one part."""
    ends = np.stack([cells, np.roll(cells, 1, axis=1)], axis=2).reshape(-1, 2)
    return _components(len(is_inside), ends[is_inside[ends].all(axis=1)])


def _followed(first: int, joints: list[tuple[int, int, np.ndarray]], count: int) -> dict[int, np.ndarray]:
    """Displacements of the parts that ``joints`` connect with the part ``first``, by part: the number of each
    of the ``count`` periods in the displacement, (count,).  The part ``first`` stays in its place."""
    found, reached = {first: np.zeros(count, dtype=int)}, [first]
    while reached:
        part = reached.pop()
        for a, b, step in joints:
            if a == part and b not in found:
                found[b] = found[part] + step
                reached.append(b)
    return found

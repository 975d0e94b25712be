"""Points of space as points of a mesh, where coefficient functions are evaluated, and the walls near them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from ngsolve import BND, VOL, CoefficientFunction, Mesh

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import MeshPart
from ngvisco.shapes.places import mesh_points

_PULLS = (1e-9, 1e-6, 1e-4, 1e-3)
"""Shares of the way to the nearest cell's centre tried for a point on a wall, which rounding, or the
polynomials of a curved wall, may leave just outside of all cells."""


def as_points(field: str, value: object, dim: int) -> np.ndarray:
    """An array of points, (count, dim), m, of a sequence of them.

    Raises ParameterError unless there is at least one, with ``dim`` finite coordinates each.
    """
    expected = f"points of {dim} finite coordinates"
    try:
        points = np.array(value, dtype=float, ndmin=2)
    except (TypeError, ValueError) as error:
        raise ParameterError(field, value, expected) from error
    if points.ndim != 2 or points.shape[1] != dim or not points.size or not np.isfinite(points).all():
        raise ParameterError(field, value, expected)
    return points


def locate(mesh: Mesh, points: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """The mesh points at ``points``, (count, dim), m; ``names`` are what an error calls them.

    A point within 1e-3 of a cell's size of the domain counts as one on its wall.  Raises ParameterError for
    a point that is not in the domain.
    """
    found: np.ndarray = mesh(*points.T)
    for number in np.flatnonzero(found["nr"] < 0):
        found[number] = _on_wall(mesh, points[number], names[int(number)])
    return found


class Located:
    """Points of space, (count, dim), m, at which functions on a mesh are evaluated; ``names`` are for errors.

    Over ranks each rank has points of its own, and each point is in the cell in which it is on one process:
    what jumps across facets has one value there.  Making one and every evaluation are collective.  Raises
    ParameterError for a point that is not in the domain, and for a mesh that was distributed otherwise than
    by ``Simulation``: the whole is not known.
    """

    def __init__(self, mesh: Mesh, points: np.ndarray, names: Sequence[str]) -> None:
        self.ranks, self.count = Communicator.of(mesh), len(points)
        if not self.ranks.is_distributed:
            self._at = locate(mesh, points, names)
            return
        if not isinstance(mesh, MeshPart):
            expected = "a mesh that Simulation distributes itself, of which it knows the whole"
            raise ParameterError(names[0], "a distributed mesh", expected)
        mpi = self.ranks.mpi
        asked, called, cells = mpi.gather(points), mpi.gather(list(names)), mpi.gather(mesh.cells)
        found: list[tuple[np.ndarray, np.ndarray]] = []

        def locate_all() -> None:
            assert mesh.whole is not None
            for each, of_each in zip(asked, called, strict=True):
                at = locate(mesh.whole, each, of_each) if len(each) else None
                nr = np.zeros(0, dtype=int) if at is None else at["nr"].astype(int)
                axes = "xyz"[: mesh.dim]
                found.append((nr, each if at is None else np.stack([at[axis] for axis in axes], axis=1)))

        self.ranks.on_first(locate_all)
        wanted, given = None, None
        if mesh.whole is not None:
            owner, local = (np.zeros(mesh.whole.ne, dtype=int) for _ in range(2))
            for rank, of_rank in enumerate(cells):
                owner[of_rank], local[of_rank] = rank, np.arange(len(of_rank))
            every = range(self.ranks.size)
            given = [[np.flatnonzero(owner[nr] == rank) for rank in every] for nr, _ in found]
            wanted = [
                [
                    (local[nr[of[rank]]], reference[of[rank]])
                    for (nr, reference), of in zip(found, given, strict=True)
                ]
                for rank in every
            ]
        mine = mpi.scatter(wanted)
        self._from: list[np.ndarray] = mpi.scatter(given)  # which of this rank's points each rank has
        self._ends = np.cumsum([len(local) for local, _ in mine])
        self._at = mesh_points(mesh, *(np.concatenate(parts) for parts in zip(*mine, strict=True)))

    def values(self, function: CoefficientFunction) -> np.ndarray:
        """Values of a function, (count, components)."""
        own = np.asarray(function(self._at)).reshape(len(self._at), function.dim)
        if not self.ranks.is_distributed:
            return own
        values = np.zeros((self.count, function.dim))
        got = self.ranks.mpi.alltoall(np.split(own, self._ends[:-1]))
        for where, part in zip(self._from, got, strict=True):
            values[where] = part
        return values


def _on_wall(mesh: Mesh, point: np.ndarray, name: str) -> Any:
    vertices = coordinates(mesh)
    nearest = int(np.argmin(np.linalg.norm(vertices - point, axis=1)))
    cells = [cell for cell in mesh.Elements(VOL) if nearest in (v.nr for v in cell.vertices)]
    centres = [vertices[[v.nr for v in cell.vertices]].mean(axis=0) for cell in cells]
    for pull in _PULLS:
        for centre in centres:
            pulled = point + pull * (centre - point)
            found = mesh(*pulled[:, None])[0]
            if found["nr"] >= 0:
                return found
    size = np.ptp(vertices, axis=0).max()
    ends = np.round(np.array([vertices.min(axis=0), vertices.max(axis=0)]).T / size, 12) * size
    box = " x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in ends + 0.0)
    raise ParameterError(name, [float(c) for c in point], f"a point of the domain, which lies in {box} m")


def nearest_wall(mesh: Mesh, point: np.ndarray) -> tuple[str | None, float]:
    """The boundary nearest to ``point``, (dim,), m, and its distance, m; walls as straight as their vertices.

    (None, inf) for a mesh without boundary.  Over ranks that of the whole mesh; collective.
    """
    ranks = Communicator.of(mesh)
    if isinstance(mesh, MeshPart):  # so that of two at one distance it is the same as on one process
        return ranks.on_first(lambda: _nearest_wall(mesh.whole, point))
    return min(ranks.gathered(_nearest_wall(mesh, point)), key=lambda one: one[1])


def _nearest_wall(mesh: Mesh, point: np.ndarray) -> tuple[str | None, float]:
    """The nearest of the walls that this rank has."""
    vertices = coordinates(mesh)
    facets = list(mesh.Elements(BND))
    if not facets:
        return None, float("inf")
    corners = [vertices[[v.nr for v in facet.vertices]] for facet in facets]
    distances = [_distance(point, facet) for facet in corners]
    nearest = int(np.argmin(distances))
    return facets[nearest].mat, float(distances[nearest])


def _distance(point: np.ndarray, simplex: np.ndarray) -> float:
    """From a point to a simplex with these vertices, (count, dim); a quadrilateral counts as its sides."""
    origin, edges = simplex[0], simplex[1:] - simplex[0]
    weights = np.linalg.lstsq(edges.T, point - origin, rcond=None)[0]
    is_simplex = len(edges) < len(point)
    if is_simplex and (weights >= 0).all() and weights.sum() <= 1:
        return float(np.linalg.norm(point - origin - weights @ edges))
    if len(simplex) == 2:
        return float(np.linalg.norm(simplex - point, axis=1).min())
    return min(_distance(point, simplex[[i, i - 1]]) for i in range(len(simplex)))

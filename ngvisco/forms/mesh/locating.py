"""Points of space as points of a mesh, at which coefficient functions are evaluated; the nearest wall."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from ngsolve import BND, VOL, CoefficientFunction, Mesh

from ngvisco.errors import MeshError, ParameterError
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import MeshPart
from ngvisco.shapes.places import mesh_points

_PULLS = (1e-9, 1e-6, 1e-4, 1e-3)
"""Shares of the way from a point to the centre of a near cell.  A point on a wall may be just outside of all
cells, by rounding or by the polynomials of a curved wall. It is then moved by such a share."""


def as_points(field: str, value: object, dim: int) -> np.ndarray:
    """Convert a sequence of points to an array, (count, dim), m.

    Raises ParameterError for no points, and for a point without ``dim`` finite coordinates.
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
    """The mesh points at ``points``, (count, dim), m; ``names`` are the points' names in errors.

    A point outside the domain counts as a point on its wall if its distance is within 1e-3 of a cell's size.
    Raises ParameterError for a point farther outside.
    """
    places: np.ndarray = mesh(*points.T)
    for number in np.flatnonzero(places["nr"] < 0):
        places[number] = _on_wall(mesh, points[number], names[int(number)])
    return places


class Located:
    """Points of space, (count, dim), m, for functions on a mesh; ``names`` are their names in errors.

    Over ranks each rank has its points, and a point lies in the same cell as on one process. A function that
    jumps across facets therefore has one value at the point.  Construction and evaluation are collective.
    Raises ParameterError for a point outside the domain, and for a distributed mesh that ``Simulation`` did
    not distribute, since the undistributed mesh is not known.
    """

    def __init__(self, mesh: Mesh, points: np.ndarray, names: Sequence[str]) -> None:
        self.ranks, self.count = Communicator.of(mesh), len(points)
        if not self.ranks.is_distributed:
            self._at = locate(mesh, points, names)
            return
        if not isinstance(mesh, MeshPart):
            raise MeshError(
                f"{names[0]} cannot be found in a mesh that is already distributed over ranks; expected an "
                "undistributed mesh, which Simulation distributes"
            )
        mpi = self.ranks.mpi
        asked, called, cells = mpi.gather(points), mpi.gather(list(names)), mpi.gather(mesh.cells)
        located: list[tuple[np.ndarray, np.ndarray]] = []

        def locate_all() -> None:
            assert mesh.whole is not None
            for points, of_each in zip(asked, called, strict=True):
                at = locate(mesh.whole, points, of_each) if len(points) else None
                nr = np.zeros(0, dtype=int) if at is None else at["nr"].astype(int)
                axes = "xyz"[: mesh.dim]
                located.append((nr, points if at is None else np.stack([at[axis] for axis in axes], axis=1)))

        self.ranks.on_first(locate_all)
        requests, given = None, None
        if mesh.whole is not None:
            owner, local = (np.zeros(mesh.whole.ne, dtype=int) for _ in range(2))
            for rank, of_rank in enumerate(cells):
                owner[of_rank], local[of_rank] = rank, np.arange(len(of_rank))
            every = range(self.ranks.size)
            given = [[np.flatnonzero(owner[nr] == rank) for rank in every] for nr, _ in located]
            requests = [
                [
                    (local[nr[places[rank]]], reference[places[rank]])
                    for (nr, reference), places in zip(located, given, strict=True)
                ]
                for rank in every
            ]
        mine = mpi.scatter(requests)
        self._from: list[np.ndarray] = mpi.scatter(given)  # by ranks, the points that each rank evaluates
        self._ends = np.cumsum([len(local) for local, _ in mine])
        self._at = mesh_points(mesh, *(np.concatenate(parts) for parts in zip(*mine, strict=True)))

    def values(self, function: CoefficientFunction) -> np.ndarray:
        """Values of a function, (count, components)."""
        at_points = np.asarray(function(self._at)).reshape(len(self._at), function.dim)
        if not self.ranks.is_distributed:
            return at_points
        values = np.zeros((self.count, function.dim))
        got = self.ranks.mpi.alltoall(np.split(at_points, self._ends[:-1]))
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
            place = mesh(*(point + pull * (centre - point))[:, None])[0]
            if place["nr"] >= 0:
                return place
    size = np.ptp(vertices, axis=0).max()
    ends = np.round(np.array([vertices.min(axis=0), vertices.max(axis=0)]).T / size, 12) * size
    box = " x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in ends + 0.0)
    raise ParameterError(name, [float(c) for c in point], f"a point of the domain, which lies in {box} m")


def nearest_wall(mesh: Mesh, point: np.ndarray) -> tuple[str | None, float]:
    """The boundary nearest to ``point``, (dim,), m, and its distance, m; facets count as straight.

    The result is (None, inf) for a mesh without boundary.  Ranks search the whole mesh; collective.
    """
    ranks = Communicator.of(mesh)
    if isinstance(mesh, MeshPart):  # so that equal distances give the wall of one process
        return ranks.on_first(lambda: _nearest_wall(mesh.whole, point))
    return min(ranks.gathered(_nearest_wall(mesh, point)), key=lambda entry: entry[1])


def _nearest_wall(mesh: Mesh, point: np.ndarray) -> tuple[str | None, float]:
    """The nearest wall on this rank, and its distance."""
    vertices = coordinates(mesh)
    facets = list(mesh.Elements(BND))
    if not facets:
        return None, float("inf")
    corners = [vertices[[v.nr for v in facet.vertices]] for facet in facets]
    distances = [_distance(point, facet) for facet in corners]
    nearest = int(np.argmin(distances))
    return facets[nearest].mat, float(distances[nearest])


def _distance(point: np.ndarray, simplex: np.ndarray) -> float:
    """Distance from a point to a simplex with these vertices, (count, dim), or to a quadrilateral's sides."""
    origin, edges = simplex[0], simplex[1:] - simplex[0]
    weights = np.linalg.lstsq(edges.T, point - origin, rcond=None)[0]
    is_simplex = len(edges) < len(point)
    if is_simplex and (weights >= 0).all() and weights.sum() <= 1:
        return float(np.linalg.norm(point - origin - weights @ edges))
    if len(simplex) == 2:
        return float(np.linalg.norm(simplex - point, axis=1).min())
    return min(_distance(point, simplex[[i, i - 1]]) for i in range(len(simplex)))

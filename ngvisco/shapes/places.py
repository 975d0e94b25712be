"""Places of a mesh: reference points in chosen cells, at which functions and shapes are evaluated."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule, Mesh, x, y, z


@dataclass(frozen=True)
class Places:
    """Points with equal reference coordinates in cells of one type.

    Attributes
    ----------
    mesh : ngsolve.Mesh
    cells : array (cells,)
        Numbers of the cells.
    reference : array (points, dim)
        The points in coordinates of the reference cell.
    pieces : array (pieces, dim + 1), optional
        Sub-cells, each given by the numbers of the points at its corners.
    """

    mesh: Mesh
    cells: np.ndarray
    reference: np.ndarray
    pieces: np.ndarray | None = None

    @cached_property
    def points(self) -> np.ndarray:
        """NGSolve's mesh points, cell by cell, (cells * points,)."""
        cells = np.repeat(self.cells, len(self.reference))
        return mesh_points(self.mesh, cells, np.tile(self.reference, (len(self.cells), 1)))

    def values(self, function: CoefficientFunction) -> np.ndarray:
        """Values of a function, (cells * points, components)."""
        return np.asarray(function(self.points)).reshape(len(self.points), function.dim)

    @cached_property
    def coordinates(self) -> np.ndarray:
        """Coordinates of the points, (cells * points, dim), m."""
        from_ngsolve: Any = CoefficientFunction((x, y, z)[: self.mesh.dim])
        return self.values(from_ngsolve)

    @property
    def cell_numbers(self) -> np.ndarray:
        """Number of each point's cell, (cells * points,)."""
        return np.repeat(self.cells, len(self.reference))

    def of_cut_pieces(self, inside: np.ndarray) -> np.ndarray:
        """Numbers of the points at corners of sub-cells that a surface cuts; none without sub-cells.

        Parameters
        ----------
        inside : array of bool (cells * points,)
        """
        if self.pieces is None:
            return np.zeros(0, dtype=int)
        mask = np.zeros((len(self.cells), len(self.reference)), dtype=bool)
        sides = inside.reshape(mask.shape)[:, self.pieces]
        cell, piece = np.nonzero(sides.any(axis=2) & ~sides.all(axis=2))
        mask[cell[:, None], self.pieces[piece]] = True
        return np.flatnonzero(mask)

    @cached_property
    def spacing(self) -> np.ndarray:
        """Longest edge of the sub-cells in each point's cell, m; without sub-cells, the diagonal of the
        cell's box."""
        places = self.coordinates.reshape(len(self.cells), len(self.reference), self.mesh.dim)
        if self.pieces is None:
            longest = np.linalg.norm(np.ptp(places, axis=1), axis=1)
        else:
            pairs = [self.pieces[:, list(ends)] for ends in combinations(range(self.mesh.dim + 1), 2)]
            ends = np.unique(np.concatenate(pairs), axis=0)
            longest = np.linalg.norm(places[:, ends[:, 0]] - places[:, ends[:, 1]], axis=2).max(axis=1)
        return np.repeat(longest, len(self.reference))


def mesh_points(mesh: Mesh, cells: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """NGSolve's mesh points, (points,), for each point's cell and reference coordinates, (points, dim)."""
    # a point made by NGSolve serves as a pattern, because it contains the mesh's address
    types = (ET.TRIG, ET.QUAD) if mesh.dim == 2 else (ET.TET,)
    rule = IntegrationRule([(0.25,) * mesh.dim], [1.0])
    points = np.repeat(mesh.MapToAllElements({et: rule for et in types}, VOL)[:1], len(cells))
    points["nr"] = cells
    for axis, name in enumerate("xyz"[: mesh.dim]):
        points[name] = reference[:, axis]
    return points

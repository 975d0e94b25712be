"""Places of a mesh: reference points in chosen cells, where functions and shapes are evaluated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule, Mesh, x, y, z


@dataclass(frozen=True)
class Places:
    """Points in cells of one type.

    Attributes
    ----------
    mesh : ngsolve.Mesh
    cells : array (cells,)
        Numbers of the cells.
    reference : array (points, dim)
        In each of them, in the coordinates of the reference cell.
    """

    mesh: Mesh
    cells: np.ndarray
    reference: np.ndarray

    @cached_property
    def points(self) -> np.ndarray:
        """NGSolve's mesh points, cell by cell, (cells * points,)."""
        cells = np.repeat(self.cells, len(self.reference))
        return mesh_points(self.mesh, cells, np.tile(self.reference, (len(self.cells), 1)))

    def values(self, function: CoefficientFunction) -> np.ndarray:
        """Of a function, (cells * points, components)."""
        return np.asarray(function(self.points)).reshape(len(self.points), -1)

    @cached_property
    def coordinates(self) -> np.ndarray:
        """(cells * points, dim), m."""
        from_ngsolve: Any = CoefficientFunction((x, y, z)[: self.mesh.dim])
        return self.values(from_ngsolve)

    @property
    def cell_numbers(self) -> np.ndarray:
        """The cell of each point, (cells * points,)."""
        return np.repeat(self.cells, len(self.reference))


def mesh_points(mesh: Mesh, cells: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """NGSolve's mesh points, (points,), of the cell and the reference coordinates, (points, dim), of each."""
    # one point of NGSolve's own has the mesh's address in it
    types = (ET.TRIG, ET.QUAD) if mesh.dim == 2 else (ET.TET,)
    one = IntegrationRule([(0.25,) * mesh.dim], [1.0])
    pattern = mesh.MapToAllElements({et: one for et in types}, VOL)[:1]
    points = np.repeat(pattern, len(cells))
    points["nr"] = cells
    for axis, name in enumerate("xyz"[: mesh.dim]):
        points[name] = reference[:, axis]
    return points

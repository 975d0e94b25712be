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
        # one point of NGSolve's own has the mesh's address in it
        types = (ET.TRIG, ET.QUAD) if self.mesh.dim == 2 else (ET.TET,)
        one = IntegrationRule([(0.25,) * self.mesh.dim], [1.0])
        pattern = self.mesh.MapToAllElements({et: one for et in types}, VOL)[:1]
        points = np.repeat(pattern, len(self.cells) * len(self.reference))
        points["nr"] = np.repeat(self.cells, len(self.reference))
        for axis, name in enumerate("xyz"[: self.mesh.dim]):
            points[name] = np.tile(self.reference[:, axis], len(self.cells))
        return points

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

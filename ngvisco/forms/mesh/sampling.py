"""Pointwise checks and extrema, at the vertices and interior points of every cell."""

from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import CF, ET, VOL, CoefficientFunction, Integrate, IntegrationRule, Mesh, x, y, z

from ngvisco.errors import InitialDataError
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.parallel.communicator import Communicator

_VERTICES: dict[Any, list[tuple[float, ...]]] = {
    ET.TRIG: [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)],
    ET.QUAD: [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)],
    ET.TET: [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)],
}


class Sampler:
    """Evaluates coefficient functions at the vertices and quadrature points of all cells."""

    def __init__(self, mesh: Mesh, quadrature: Quadrature) -> None:
        self.mesh, self.quadrature = mesh, quadrature
        self.ranks = Communicator.of(mesh)

    @cached_property
    def points(self) -> np.ndarray:
        """Mesh points: at vertices (just inside each cell) and at the forms' quadrature points."""
        rules = {}
        for et, vertices in _VERTICES.items():
            if et in self.quadrature.cell_rules:
                inner_points = list(self.quadrature.cell_rules[et].points)
                points = [tuple(p)[: len(vertices[0])] for p in inner_points] + list(vertices)
                rules[et] = IntegrationRule(points, [0.0] * len(points))
        return self.mesh.MapToAllElements(rules, VOL)

    def values(self, f: CoefficientFunction) -> np.ndarray:
        """Values at all points of this rank, shape (points,) or (points, components)."""
        result = np.asarray(f(self.points))
        return result[:, 0] if result.ndim == 2 and result.shape[1] == 1 else result

    def rows(self, f: CoefficientFunction) -> np.ndarray:
        """The same as (points, components), also of a scalar and on a rank without points."""
        return np.asarray(f(self.points)).reshape(len(self.points), f.dim)

    def coordinates(self, indices: np.ndarray) -> np.ndarray:
        """Where some of the points are, (indices, dim), m."""
        position = CF((x, y, z)[: self.mesh.dim])
        return np.asarray(position(self.points[indices])).reshape(len(indices), self.mesh.dim)

    def integral(self, values: np.ndarray) -> float:
        """Of values at this rank's points over the whole mesh: of each cell the mean of its points counts."""
        cells = self.points["nr"]
        volumes = Integrate(CF(1.0), self.mesh, element_wise=True).NumPy()
        sums, counts = (np.bincount(cells, weights, len(volumes)) for weights in (values, None))
        return self.ranks.total(float(volumes @ (sums / np.maximum(counts, 1))))

    def extrema(self, f: CoefficientFunction) -> tuple[float, float]:
        """Minimum and maximum of a scalar, over all ranks."""
        values = self.values(f)
        return self.ranks.least(values), self.ranks.most(values)

    def place_of_largest(self, f: CoefficientFunction) -> tuple[float, ...]:
        """Where a scalar is largest over all ranks, m."""
        values, mine = self.values(f), None
        if len(values):
            at = int(np.argmax(values))
            mine = (float(values[at]), tuple(float(c) for c in self.coordinates(np.array([at]))[0]))
        return max(one for one in self.ranks.gathered(mine) if one is not None)[1]

    def require(self, f: CoefficientFunction, name: str, minimum: float | None = None) -> None:
        """Raise InitialDataError unless f is finite (and > ``minimum``) at all points."""
        values = self.values(f)
        if not self.ranks.all(np.isfinite(values).all()):
            raise InitialDataError(name, "not finite somewhere", "finite values")
        if minimum is not None and (least := self.ranks.least(values)) <= minimum:
            raise InitialDataError(name, f"minimum {least:.6g}", f"> {minimum:g}")

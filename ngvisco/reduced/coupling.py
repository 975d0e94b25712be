"""Derivatives of a cell's rows by the cell's own values and by values of the cells across its sides, as dense
blocks."""

from __future__ import annotations

import numpy as np

from ngvisco.algebra.local import Functions, integrals
from ngvisco.reduced.operators import FacetMass, SideOperators


class FacetCoupling:
    """Builds the blocks from weights at the sides' points; holds the values of the basis functions at these
    points."""

    def __init__(self, sides: SideOperators, mass: FacetMass) -> None:
        z, per = sides.z, sides.points.per_side
        self.cells, self.functions, self.per_side, self.points = z.cells, z.local, per, z.height
        self.sides = z.per_cell // per
        count = self.cells * self.sides
        self._weights = sides.points.weights.reshape(count, per)
        nodes = z.nodal.shape[2] // max(self.sides, 1)
        nodal = z.nodal.reshape(self.cells, self.functions, self.sides, nodes).swapaxes(1, 2)
        self._z = Functions(nodal.reshape(count, self.functions, nodes), z.shape)
        self._hat, self._facet = mass.functions, mass.facet
        self._mass, self.halo = mass, mass.halo
        order = np.argsort(self._facet, kind="stable")
        first = np.flatnonzero(np.diff(self._facet[order]) == 0)
        side, opposite = order[first], order[first + 1]
        self.across = np.arange(count)
        """Number of the same facet's side in the neighbouring cell, (sides,); on the boundary the side's own
        number.  Sides of other ranks' cells have numbers from ``count`` on."""
        self.across[side], self.across[opposite] = opposite, side
        side_of = np.zeros(len(mass.unknowns), dtype=np.int64)
        side_of[self._facet] = np.arange(count)
        self._border = side_of[mass.of_facets.places]
        self.across[self._border] = count + np.arange(len(self._border))
        self._inner = (self.across != np.arange(count))[:, None, None]
        beyond = self.across - count
        cell = np.where(beyond < 0, self.across // max(self.sides, 1), self.cells + beyond)
        self.neighbours = cell.reshape(self.cells, self.sides)
        """The cell across each side, (cells, sides)."""

    def tested(self, values: np.ndarray, tests: Functions | None = None) -> np.ndarray:
        """Integrals over each side of ``values`` (n, points) times test functions, (sides, n functions).

        The default of ``tests`` is the basis of the side's cell.
        """
        count = self.cells * self.sides
        parts = values.reshape(len(values), count, self.per_side).transpose(1, 2, 0)
        rows = (self._z if tests is None else tests).loads(parts * self._weights[..., None])
        return rows.transpose(0, 2, 1).reshape(count, len(values) * rows.shape[1])

    def beyond(self, blocks: np.ndarray) -> np.ndarray:
        """Blocks of the other side, (sides, ., .); zero on the boundary."""
        if len(self._border):
            blocks = np.concatenate([blocks, self.halo.swapped(blocks[self._border])])
        return blocks[self.across] * self._inner

    def blocks(
        self,
        direct: np.ndarray,
        to_trace: np.ndarray,
        from_trace: np.ndarray,
        values: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by z of the rows int (direct z + from_trace z_hat) q over the cells' sides.

        The trace z_hat is the solution of mass z_hat = int to_trace z t.  The first array has the derivatives
        by z of the cell itself, (cells, q, q). The second array has the derivatives by z of the cell across
        each side, (cells, sides, q, q).

        ``direct``, ``to_trace`` and ``from_trace`` are weights at the points of the sides, (points,).
        ``values``, (cells, points, functions), replace the basis functions of z.
        """
        direct, to_trace, from_trace = (
            self._weights * g.reshape(self._weights.shape) for g in (direct, to_trace, from_trace)
        )
        z = self._z
        if values is not None:
            by_sides = values.reshape(len(self._weights), self.per_side, self.functions)
            z = Functions(by_sides.swapaxes(1, 2), None)
        to_hat = integrals(self._hat, z, to_trace)
        from_hat = np.matmul(integrals(self._z, self._hat, from_trace), self._mass.inverses[self._facet])
        here = integrals(self._z, z, direct) + np.matmul(from_hat, to_hat)
        there = np.matmul(from_hat, self.beyond(to_hat))
        by_cells = (self.cells, self.sides, self.functions, self.functions)
        return here.reshape(by_cells).sum(axis=1), there.reshape(by_cells)

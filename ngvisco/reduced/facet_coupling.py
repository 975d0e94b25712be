"""Couplings of cells through facets' traces that are eliminated, in dense blocks."""

from __future__ import annotations

import numpy as np

from ngvisco.reduced.operators import FacetMass, SideOperators
from ngvisco.threads import product


class FacetCoupling:
    """Builds the blocks for weights at the sides' points; the functions there are known once."""

    def __init__(self, sides: SideOperators, mass: FacetMass) -> None:
        z, per = sides.z, sides.points.per_side
        self.cells, self.functions = z.cells, z.local
        self.sides = z.per_cell // per
        count = self.cells * self.sides
        self._weights = sides.points.weights.reshape(count, per, 1)
        self._z = z.blocks.reshape(count, per, self.functions)
        self._z_t = np.ascontiguousarray(self._z.transpose(0, 2, 1))
        self._hat = np.ascontiguousarray(mass.shapes.T).reshape(count, per, len(mass.shapes))
        self._hat_t = np.ascontiguousarray(self._hat.transpose(0, 2, 1))
        self._facet = mass.facet[::per]
        self.across = self._other_sides()
        """The side of the other cell, (sides,); itself on the boundary; beyond all sides on another rank."""
        self.halo = mass.halo
        side_of = np.zeros(len(mass.unknowns), dtype=np.int64)
        side_of[self._facet] = np.arange(count)
        self._border = side_of[mass.of_facets.places]
        self.across[self._border] = count + np.arange(len(self._border))
        self._inner = (self.across != np.arange(len(self._z)))[:, None, None]

    def _other_sides(self) -> np.ndarray:
        order = np.argsort(self._facet, kind="stable")
        same = np.flatnonzero(np.diff(self._facet[order]) == 0)
        across = np.arange(len(order))
        across[order[same]], across[order[same + 1]] = order[same + 1], order[same]
        return across

    def neighbours(self) -> np.ndarray:
        """The cell across each side, (cells, sides)."""
        beyond = self.across - self.cells * self.sides
        cell = np.where(beyond < 0, self.across // max(self.sides, 1), self.cells + beyond)
        return cell.reshape(self.cells, self.sides)

    def blocks(
        self,
        own: np.ndarray,
        to_trace: np.ndarray,
        from_trace: np.ndarray,
        mass: FacetMass,
        values: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of int (own z + from_trace z_hat) q, where mass z_hat = int to_trace z t of both sides.

        Parameters
        ----------
        own, to_trace, from_trace : ndarray, shape (sides' points,)
        mass : FacetMass
            At its last ``update``.
        values : ndarray, shape (cells, points, functions), optional
            Of the functions in the place of z at the sides' points; default their own.

        Returns
        -------
        of the cell's own values, (cells, q, q), and of those across each side, (cells, sides, q, q)
        """
        shape, w = self._weights.shape, self._weights
        z = self._z if values is None else values.reshape(self._z.shape)
        to_hat = product(self._hat_t, (w * to_trace.reshape(shape)) * z)
        from_hat = product(self._z_t, (w * from_trace.reshape(shape)) * self._hat)
        from_hat = product(from_hat, mass.inverses[self._facet])
        here = product(self._z_t, (w * own.reshape(shape)) * z) + product(from_hat, to_hat)
        if len(self._border):
            to_hat = np.concatenate([to_hat, self.halo.swapped(to_hat[self._border])])
        there = product(from_hat, to_hat[self.across]) * self._inner
        by_cells = (self.cells, self.sides, self.functions, self.functions)
        return here.reshape(by_cells).sum(axis=1), there.reshape(by_cells)

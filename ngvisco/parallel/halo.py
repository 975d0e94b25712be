"""Cells of other ranks across shared facets, which a rank counts after its own, in the order of the facets.

Cells take values from these; what they give to the rows of these goes back to their ranks.  A cell that lies
across two shared facets is counted twice.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from ngvisco.parallel.exchange import Exchange, Owned


class Halo:
    """The cells beyond the facets that a rank shares; none on one process.

    Parameters
    ----------
    facets : Exchange
        Of one value a facet.
    beside : (shared facets,) array of int
        This rank's cell at each of ``facets.places``.
    cells : int
        Of this rank.
    """

    def __init__(self, facets: Exchange, beside: np.ndarray, cells: int) -> None:
        self.facets, self.beside, self.cells = facets, beside, cells
        self.count = cells + len(beside)
        """Cells of this rank and those beyond."""

    def swapped(self, values: np.ndarray) -> np.ndarray:
        """What the other rank has for each shared facet in place of ``values``, (shared facets, ...)."""
        return np.moveaxis(self.facets.others(np.moveaxis(values, 0, -1)), -1, 0)

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of cells, (cells, ...), and after them those of the cells beyond."""
        if not len(self.beside):
            return values
        return np.concatenate([values, self.swapped(values[self.beside])])

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of cells, (cells, ...), with what other ranks have of them, of ``rows`` (count, ...)."""
        if not len(self.beside):
            return rows
        result = rows[: self.cells].copy()
        np.add.at(result, self.beside, self.swapped(rows[self.cells :]))
        return result


class HaloUnknowns(Owned):
    """Unknowns of cells and of those beyond, equally many to each, one after the other.

    Matrices of these in parts have rows of cells beyond where this rank's cells couple such with each other.
    """

    def __init__(self, halo: Halo, per_cell: int) -> None:
        super().__init__(halo.count * per_cell, halo.facets.neighbours, halo.facets.communicator)
        self.halo, self.per_cell = halo, per_cell
        self.of_cells = halo.cells * per_cell
        """How many are those of this rank's cells."""

    @cached_property
    def owned(self) -> np.ndarray:
        return np.arange(self.count) < self.of_cells

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        return self.with_others(values[..., : self.of_cells])

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), and after them those of the cells beyond."""
        return self._by_cells(self.halo.with_others, values)

    def of_cells_alone(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), and zeros for the cells beyond."""
        beyond = np.zeros((*values.shape[:-1], self.count - self.of_cells), values.dtype)
        return np.concatenate([values, beyond], axis=-1)

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of this rank's cells with what other ranks have of them, of ``rows`` (..., count)."""
        return self._by_cells(self.halo.added, rows)

    def _by_cells(self, function: Callable[[np.ndarray], np.ndarray], values: np.ndarray) -> np.ndarray:
        """A function of (cells, functions, ...) for values (..., unknowns)."""
        if self.count == self.of_cells:
            return values
        by_cells = values.reshape(*values.shape[:-1], -1, self.per_cell)
        result = np.moveaxis(function(np.moveaxis(by_cells, (-2, -1), (0, 1))), (0, 1), (-2, -1))
        return np.ascontiguousarray(result).reshape(*result.shape[:-2], -1)

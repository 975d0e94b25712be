"""Sparse matrices that act cell by cell, stored as dense blocks.

Rows are values, for instance at points, with an equal number in each cell; a row has unknowns of its own cell
only.  The product for all components of a field is one small dense product in each cell, which is many times
faster than a sparse product for each component.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from math import prod

import numpy as np
import scipy.sparse as sp


class LocalMatrix:
    """A sparse matrix with dense blocks for cells, and its transpose with weighted rows."""

    def __init__(
        self,
        matrix: sp.csr_matrix,
        cells: int,
        weights: np.ndarray | None = None,
        dtype: type = np.float64,
    ) -> None:
        """Split a matrix by cells; ``weights``, (rows,), of a quadrature rule multiply rows in tests."""
        self.cells, self.weights = cells, weights
        self.height, self.width = matrix.shape
        self.per_cell = self.height // cells if cells else 0  # a rank may have no cells
        entries = matrix.tocoo()
        cell, row = np.divmod(entries.row, max(self.per_cell, 1))
        # unknowns of each cell in ascending order
        ends = matrix.indptr[:: max(self.per_cell, 1)]
        seen = sp.csr_matrix((np.ones(matrix.nnz), matrix.indices, ends), (cells, self.width), copy=True)
        seen.sum_duplicates()
        counts, unknown = np.diff(seen.indptr), seen.indices
        of_cell = np.repeat(np.arange(cells), counts)
        self.local = int(counts.max(initial=1))
        first = seen.indptr[:-1]
        place = np.arange(len(unknown)) - first[of_cell]
        keys = of_cell * self.width + unknown
        position = np.searchsorted(keys, cell.astype(np.int64) * self.width + entries.col)
        # cells with fewer unknowns are padded with their first unknown and zero entries
        self.unknowns = np.zeros((cells, self.local), dtype=np.int64)
        self.unknowns[counts > 0] = unknown[first[counts > 0], None]
        self.unknowns[of_cell, place] = unknown
        self._blocks = np.zeros((cells, self.local, self.per_cell), dtype)
        self._blocks[cell, place[position], row] = entries.data
        # coefficients of a discontinuous space are ordered by cells
        self._in_order = np.array_equal(self.unknowns.ravel(), np.arange(self.width))
        self._first = 0
        """Number of the first cell of this part."""

    def part(self, cells: slice) -> LocalMatrix:
        """Rows of some cells as a view.  A part computes ``loads``; only the whole matrix sums them up."""
        part, rows = copy(self), slice(self.per_cell * cells.start, self.per_cell * cells.stop)
        part.__dict__.pop("scatter", None)
        part.unknowns, part._blocks, part._first = self.unknowns[cells], self._blocks[cells], cells.start
        part.cells, part.height = len(part.unknowns), len(part.unknowns) * self.per_cell
        part.weights = None if self.weights is None else self.weights[rows]
        return part

    @property
    def blocks(self) -> np.ndarray:
        """Dense blocks, (cells, rows of a cell, unknowns of a cell)."""
        return self._blocks.transpose(0, 2, 1)

    @property
    def matrix(self) -> sp.csr_matrix:
        """The matrix in sparse form."""
        columns = np.repeat(self.unknowns, self.per_cell, axis=0)
        ends = self.local * np.arange(self.height + 1)
        matrix = sp.csr_matrix((self.blocks.ravel(), columns.ravel(), ends), (self.height, self.width))
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return matrix

    @cached_property
    def scatter(self) -> sp.csr_matrix:
        """Sparse matrix that sums the cells' loads, (width, cells times unknowns of a cell)."""
        places = np.arange(self.unknowns.size)
        ones = np.ones(self.unknowns.size, self._blocks.dtype)
        return sp.csr_matrix((ones, (self.unknowns.ravel(), places)), shape=(self.width, places.size))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Apply the matrix to each of ``rows``, (..., width) -> (..., height)."""
        if np.iscomplexobj(rows):
            return self(rows.real.copy()) + 1j * self(rows.imag.copy())  # real products use BLAS
        parts = rows.reshape(prod(rows.shape[:-1]), self.width)
        result = np.empty((len(parts), self.height))
        by_cells = result.reshape(len(parts), self.cells, self.per_cell).transpose(1, 0, 2)
        if self._in_order:
            first, count = self.local * self._first, self.local * self.cells
            local = parts[:, first : first + count].reshape(len(parts), self.cells, self.local)
        else:
            local = parts[:, self.unknowns]
        np.matmul(local.transpose(1, 0, 2), self._blocks, out=by_cells)
        return result.reshape(*rows.shape[:-1], self.height)

    def test(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose to weighted ``values``, (..., height) -> (..., width)."""
        return self.summed(self.loads(values))

    def loads(self, values: np.ndarray) -> np.ndarray:
        """Loads of each cell's block, (..., height) -> (..., cells times unknowns of a cell)."""
        if np.iscomplexobj(values):
            return self.loads(values.real.copy()) + 1j * self.loads(values.imag.copy())
        parts = values.reshape(prod(values.shape[:-1]), self.height)
        if self.weights is not None:
            parts = parts * self.weights
        local = np.empty((len(parts), self.cells, self.local))
        by_cells = parts.reshape(len(parts), self.cells, self.per_cell).transpose(1, 0, 2)
        np.matmul(by_cells, self.blocks, out=local.transpose(1, 0, 2))
        return local.reshape(*values.shape[:-1], self.unknowns.size)

    def summed(self, loads: np.ndarray) -> np.ndarray:
        """Sums over the cells of ``loads``, (..., width)."""
        if self._in_order:
            return loads
        if np.iscomplexobj(loads):
            return self.summed(loads.real.copy()) + 1j * self.summed(loads.imag.copy())
        flat = loads.reshape(prod(loads.shape[:-1]), self.unknowns.size)
        flat = (self.scatter @ np.ascontiguousarray(flat.T)).T
        return flat.reshape(*loads.shape[:-1], self.width)

    def by_cells(self, columns: np.ndarray) -> np.ndarray:
        """Apply the matrix to ``columns``, (width, n) -> (cells, n, rows of a cell)."""
        local = np.take(np.ascontiguousarray(columns, self._blocks.dtype), self.unknowns, axis=0)
        return np.matmul(local.swapaxes(1, 2), self._blocks)

    def tested(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose without weights, (cells, n, rows of a cell) -> (width, n)."""
        local = np.matmul(self._blocks, values.swapaxes(1, 2))
        return self.scatter @ local.reshape(self.unknowns.size, values.shape[1])

"""Sparse matrices that act cell by cell, stored as dense blocks.

Each row gives a value, for instance at a point; all cells have equally many rows.  The unknowns of a row
belong to the row's cell.  The product for all components of a field is one small dense product in each cell,
which is many times faster than a sparse product for each component.

On straight cells functions are polynomials.  Values at all points of a rule then follow from the values at a
few points, the nodes, by one matrix for all cells.  Only the blocks of the nodes are stored, once for all
rules whose values follow from the same nodes.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from math import prod
from typing import NamedTuple

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

SAMPLE, NEGLIGIBLE = 100, 1e-12
"""Number of cells whose rows are searched for nodes, and the largest relative error that counts as
rounding."""


class Functions(NamedTuple):
    """Functions on sides, by their values at the nodes."""

    nodal: np.ndarray  # (sides, functions, nodes)
    shape: np.ndarray | None  # interpolates from the nodes, (nodes, points); None if all points are nodes

    @property
    def values(self) -> np.ndarray:
        """Values at the points, (sides, functions, points), computed at each access."""
        return self.nodal if self.shape is None else self.nodal @ self.shape

    def loads(self, values: np.ndarray) -> np.ndarray:
        """Sums over points of functions times ``values``, (sides, points, n) -> (sides, functions, n)."""
        if not len(self.nodal):  # a rank without cells does not know the number of nodes
            return np.zeros((0, self.nodal.shape[1], values.shape[2]))
        return np.asarray(np.matmul(self.values, values))


class LocalMatrix:
    """A sparse matrix with dense blocks for cells, and its transpose with weighted rows.

    ``nodal``, (cells, unknowns of a cell, nodes of a cell), has the transposed blocks of the rows at the
    nodes.  ``shape``, (nodes of a piece, rows of a piece), interpolates from the nodes; None if all rows are
    nodes.
    """

    def __init__(
        self,
        matrix: sp.csr_matrix,
        cells: int,
        weights: np.ndarray | None = None,
        dtype: type = np.float64,
        pieces: int = 0,
        other: LocalMatrix | None = None,
    ) -> None:
        """Split a matrix by cells.

        ``weights``, (rows,), are the weights of a quadrature rule, by which ``test`` and ``loads`` multiply.
        ``pieces`` is the number of equal parts of a cell's rows (the cell's sides).  All parts have nodes at
        the same places; with ``pieces`` = 0 every row is a node.  ``other`` has the same functions at the
        points of another rule; the nodes of ``other`` are used here too if all rows follow from them.
        """
        self.cells, self.weights, self.pieces = cells, weights, pieces
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
        blocks = np.zeros((cells, self.local, self.per_cell), dtype)
        blocks[cell, place[position], row] = entries.data
        self.nodal: np.ndarray
        self.shape: np.ndarray | None
        shape = None if other is None or not cells else _shape(other, self.unknowns, blocks, pieces)
        if other is not None and shape is not None:
            self.unknowns, self.nodal, self.shape = other.unknowns, other.nodal, shape
        else:
            self.nodal, self.shape = _nodes(blocks, pieces)
        # coefficients of a discontinuous space are ordered by cells
        self._in_order = np.array_equal(self.unknowns.ravel(), np.arange(self.width))
        self._first = 0
        """Number of the first cell of this part."""

    def part(self, cells: slice) -> LocalMatrix:
        """Rows of some cells as a view.  A part computes ``loads``; only the whole matrix adds them up
        (``summed``)."""
        part, rows = copy(self), slice(self.per_cell * cells.start, self.per_cell * cells.stop)
        part.__dict__.pop("scatter", None)
        part.unknowns, part.nodal, part._first = self.unknowns[cells], self.nodal[cells], cells.start
        part.cells, part.height = len(part.unknowns), len(part.unknowns) * self.per_cell
        part.weights = None if self.weights is None else self.weights[rows]
        return part

    @property
    def is_constant(self) -> bool:
        """Whether in each cell all rows are equal."""
        return self.shape is not None and self.nodal.shape[2] == 1 and bool((self.shape == 1.0).all())

    @property
    def blocks(self) -> np.ndarray:
        """Dense blocks, (cells, rows of a cell, unknowns of a cell), computed at each access."""
        return self.from_nodes(self.nodal).transpose(0, 2, 1)

    def from_nodes(self, values: np.ndarray) -> np.ndarray:
        """Interpolate ``values``, (..., nodes of a cell), to all rows of a cell."""
        return values if self.shape is None else _mapped(values, self.shape)

    def to_nodes(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose of ``from_nodes`` to ``values``, (..., rows of a cell)."""
        return values if self.shape is None else _mapped(values, self.shape.T)

    @property
    def matrix(self) -> sp.csr_matrix:
        """The matrix in sparse form."""
        return self._sparse(self.blocks)

    @property
    def at_nodes(self) -> sp.csr_matrix:
        """The rows at the nodes in sparse form."""
        return self._sparse(self.nodal.transpose(0, 2, 1))

    def _sparse(self, blocks: np.ndarray) -> sp.csr_matrix:
        columns, height = np.repeat(self.unknowns, blocks.shape[1], axis=0), self.cells * blocks.shape[1]
        ends = self.local * np.arange(height + 1)
        matrix = sp.csr_matrix((blocks.ravel(), columns.ravel(), ends), (height, self.width))
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return matrix

    @cached_property
    def scatter(self) -> sp.csr_matrix:
        """Sparse matrix that sums the cells' loads, (width, cells times unknowns of a cell)."""
        places = np.arange(self.unknowns.size)
        ones = np.ones(self.unknowns.size, self.nodal.dtype)
        return sp.csr_matrix((ones, (self.unknowns.ravel(), places)), shape=(self.width, places.size))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Apply the matrix to each of ``rows``, (..., width) -> (..., height)."""
        if np.iscomplexobj(rows):
            return self(rows.real.copy()) + 1j * self(rows.imag.copy())  # real products use BLAS
        return self.from_nodes(self.of_nodes(rows)).reshape(*rows.shape[:-1], self.height)

    def of_nodes(self, rows: np.ndarray) -> np.ndarray:
        """Apply the matrix at the nodes to each of real ``rows``, (..., width) -> (..., cells, nodes)."""
        parts = rows.reshape(prod(rows.shape[:-1]), self.width)
        nodes = np.empty((len(parts), self.cells, self.nodal.shape[2]))
        if self._in_order:
            first, count = self.local * self._first, self.local * self.cells
            local = parts[:, first : first + count].reshape(len(parts), self.cells, self.local)
        else:
            local = np.take(parts, self.unknowns, axis=1)  # faster than an index
        np.matmul(local.transpose(1, 0, 2), self.nodal, out=nodes.transpose(1, 0, 2))
        return nodes.reshape(*rows.shape[:-1], *nodes.shape[1:])

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
        nodes = self.to_nodes(parts.reshape(len(parts), self.cells, self.per_cell))
        np.matmul(nodes.transpose(1, 0, 2), self.nodal.swapaxes(1, 2), out=local.transpose(1, 0, 2))
        return local.reshape(*values.shape[:-1], self.unknowns.size)

    def summed(self, loads: np.ndarray) -> np.ndarray:
        """Add up the cells' ``loads``, (..., cells times unknowns of a cell) -> (..., width)."""
        if self._in_order:
            return loads
        if np.iscomplexobj(loads):
            return self.summed(loads.real.copy()) + 1j * self.summed(loads.imag.copy())
        flat = loads.reshape(prod(loads.shape[:-1]), self.unknowns.size)
        return (self.scatter @ np.ascontiguousarray(flat.T)).T.reshape(*loads.shape[:-1], self.width)

    def by_cells(self, columns: np.ndarray) -> np.ndarray:
        """Apply the matrix at the nodes to ``columns``, (width, n) -> (cells, n, nodes of a cell)."""
        local = np.take(np.ascontiguousarray(columns, self.nodal.dtype), self.unknowns, axis=0)
        return np.matmul(local.swapaxes(1, 2), self.nodal)

    def tested(self, values: np.ndarray) -> np.ndarray:
        """Apply the transpose of ``by_cells``, (cells, n, nodes of a cell) -> (width, n)."""
        local = np.matmul(self.nodal, values.swapaxes(1, 2))
        return self.scatter @ local.reshape(self.unknowns.size, values.shape[1])


def _mapped(values: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Multiply each group of len(matrix) successive values along the last axis by the matrix."""
    product = values.reshape(-1, len(matrix)) @ matrix.astype(values.dtype, copy=False)
    return product.reshape(*values.shape[:-1], values.shape[-1] // len(matrix) * matrix.shape[1])


def integrals(left: Functions, right: Functions, weights: np.ndarray) -> np.ndarray:
    """Sums over points of products of functions, (sides, left, right); ``weights`` are (sides, points)."""
    if not len(weights):  # a rank may have no cells
        return np.zeros((0, left.nodal.shape[1], right.nodal.shape[1]))
    points = np.eye(weights.shape[1])
    a, b = (points if matrix.shape is None else matrix.shape for matrix in (left, right))
    products = (a[:, None] * b).reshape(len(a) * len(b), len(points)).T
    masses = (weights @ products).reshape(len(weights), len(a), len(b))
    return np.matmul(np.matmul(left.nodal, masses), right.nodal.swapaxes(1, 2))


def squared(nodal: np.ndarray, shape: np.ndarray | None, weights: np.ndarray) -> np.ndarray:
    """The products B^T W B of each cell's B = shape^T nodal; W is diagonal with ``weights`` (cells, rows).

    ``nodal`` are (cells, nodes, columns); ``shape`` interpolates as in ``LocalMatrix``.
    """
    if shape is None:
        return np.matmul(nodal.swapaxes(1, 2), weights[:, :, None] * nodal)
    cells, count, columns = nodal.shape
    nodes, points = shape.shape
    products = (shape[:, None] * shape).reshape(nodes**2, points).T
    masses = (weights.reshape(-1, points) @ products).reshape(cells, count // nodes, nodes, nodes)
    weighted = np.matmul(masses, nodal.reshape(cells, count // nodes, nodes, columns))
    return np.matmul(nodal.swapaxes(1, 2), weighted.reshape(nodal.shape))


def _shape(other: LocalMatrix, unknowns: np.ndarray, blocks: np.ndarray, pieces: int) -> np.ndarray | None:
    """The matrix that interpolates transposed ``blocks``, (cells, unknowns, rows), from the nodes of
    ``other``.

    The result is None if the rows do not follow from the nodes of ``other``.
    """
    if pieces != other.pieces or not np.array_equal(unknowns, other.unknowns):
        return None
    nodal, by_pieces = (part.reshape(*part.shape[:2], pieces, -1) for part in (other.nodal, blocks))
    sample = np.linspace(0, len(blocks) - 1, min(len(blocks), SAMPLE)).astype(int)
    of_nodes, of_rows = (part[sample].reshape(-1, part.shape[3]) for part in (nodal, by_pieces))
    shape: np.ndarray = la.lstsq(of_nodes, of_rows)[0]
    error = abs(nodal @ shape - by_pieces).max(axis=(1, 2, 3))
    return shape if (error <= NEGLIGIBLE * abs(blocks).max(axis=(1, 2))).all() else None


def _nodes(blocks: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Find nodes of transposed ``blocks``, (cells, unknowns, rows), the same nodes in each of a cell's
    ``pieces``.

    Return the blocks at the nodes, (cells, unknowns, nodes), and the matrix that interpolates from the nodes.

    If no smaller set of rows determines the others, all rows are nodes, and the matrix is None."""
    cells, local, count = blocks.shape
    if not pieces or not cells:
        return blocks, None
    by_pieces = blocks.reshape(cells, local, pieces, count // pieces)
    some = by_pieces[np.linspace(0, cells - 1, min(cells, SAMPLE)).astype(int)]
    triangle, order = la.qr(some.reshape(-1, count // pieces), mode="r", pivoting=True)
    diagonal = abs(np.diag(triangle))
    rank = int((diagonal > 100 * NEGLIGIBLE * diagonal.max(initial=0.0)).sum())
    if not 0 < rank < len(order):
        return blocks, None
    shape = np.zeros((rank, len(order)), blocks.dtype)
    shape[:, order[:rank]] = np.eye(rank)
    shape[:, order[rank:]] = la.solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])
    nodal = by_pieces[..., order[:rank]]
    if rank == 1 and np.allclose(shape, 1.0, rtol=0, atol=NEGLIGIBLE):
        shape[:] = 1.0  # all rows of a piece are equal
    error = abs(nodal @ shape - by_pieces).max(axis=(1, 2, 3))
    if (error > NEGLIGIBLE * abs(blocks).max(axis=(1, 2))).any():
        return blocks, None
    return np.ascontiguousarray(nodal).reshape(cells, local, pieces * rank), shape

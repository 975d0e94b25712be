"""Small operations with SciPy's sparse matrices."""

import math

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ngvisco.algebra import precision

_AT_ONCE = 1 << 16
"""Number of entries of element matrices that are added up in one call."""


def apply(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """Apply a matrix to each row, (..., width) -> (..., height); twice as fast as a product with columns."""
    return matrix @ rows if rows.ndim == 1 else np.stack([apply(matrix, row) for row in rows])


def largest(values: np.ndarray) -> float:
    """Largest modulus of the values, or 1 if all are zero."""
    return float(abs(values).max(initial=0.0)) or 1.0


class Rounded:
    """A matrix in single precision.

    Matrix and arguments are scaled, because SI numbers may be outside the range of single precision.
    """

    def __init__(self, matrix: sp.csr_matrix) -> None:
        self._unit = largest(matrix.data)
        self._matrix = (matrix / self._unit).astype(precision.SINGLE).tocsr()

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Apply the matrix to each row, (rows, width) -> (rows, height)."""
        length = largest(rows)
        return np.float64(self._unit * length) * apply(self._matrix, (rows / length).astype(precision.SINGLE))


def widened(matrix: sp.csr_matrix, height: int, width: int) -> sp.csr_matrix:
    """The matrix extended by zero rows and columns to ``height`` and ``width``."""
    result = matrix.copy()
    result.resize((height, width))
    return result


def beside(blocks: list[sp.csr_matrix], dtype: type = np.float64) -> sp.csr_matrix:
    """Matrices with equally many rows, side by side; SciPy's ``hstack`` takes thrice the result's memory."""
    lengths = np.array([np.diff(block.indptr) for block in blocks], np.int32)
    ends, width = np.concatenate([[0], np.cumsum(lengths.sum(axis=0))]).astype(np.int32), 0
    values, columns = np.empty(ends[-1], dtype), np.empty(ends[-1], np.int32)
    first = ends[:-1].copy()
    for block, count in zip(blocks, lengths, strict=True):
        places = np.repeat(first - block.indptr[:-1], count)
        places += np.arange(block.nnz, dtype=np.int32)
        values[places], columns[places] = block.data, block.indices + width
        first, width = first + count, width + block.shape[1]
    return sp.csr_matrix((values, columns, ends), shape=(lengths.shape[1], width))


def stacked(parts: list[sp.csr_matrix]) -> sp.csr_matrix:
    """The rows of all parts, one part after the other; empties ``parts``, to free their memory early."""
    width, lengths = parts[0].shape[1], np.concatenate([np.diff(part.indptr) for part in parts])
    data, columns = [part.data for part in parts], [part.indices for part in parts]
    parts.clear()
    values = np.concatenate(data)
    data.clear()
    ends = np.concatenate([[0], np.cumsum(lengths)]).astype(columns[0].dtype)
    return sp.csr_matrix((values, np.concatenate(columns), ends), shape=(len(lengths), width))


def mass_matrix(values: sp.csr_matrix, weights: np.ndarray) -> sp.csr_matrix:
    """Mass matrix of functions with given values at quadrature points with given weights."""
    return (values.T @ sp.diags(weights) @ values).tocsr()


def pruned(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Remove entries that are rounding; a normal derivative at a side then depends on the side's facet
    alone."""
    matrix.data[abs(matrix.data) <= 1e-14 * abs(matrix.data).max(initial=0.0)] = 0.0
    matrix.eliminate_zeros()
    return matrix


class Blocks:
    """The diagonal blocks of a matrix: connected components of ``pattern``.

    Unknowns without an entry in the pattern (copies of identified unknowns) belong to no block.  ``groups``
    contain, for each block size, the blocks' unknowns, (blocks, size).
    """

    def __init__(self, pattern: sp.csr_matrix) -> None:
        graph = pattern.tocsr().copy()
        graph.data = np.where(abs(graph.data) > 1e-13 * largest(graph.data), 1.0, 0.0)
        graph.eliminate_zeros()
        _, label = connected_components(graph, directed=False)
        order = np.argsort(label, kind="stable")
        order = order[np.diff(graph.indptr)[order] > 0]
        _, sizes = np.unique(label[order], return_counts=True)
        starts = np.cumsum(sizes) - sizes
        self.groups = [order[starts[sizes == n][:, None] + np.arange(n)] for n in np.unique(sizes)]

    def inverse(self, matrix: sp.csr_matrix) -> sp.csr_matrix:
        """Inverse of the blocks of ``matrix``, zero elsewhere.  Raises LinAlgError for a singular block."""
        values, rows, columns = [np.zeros(0)], [np.zeros(0, int)], [np.zeros(0, int)]
        for group in self.groups:
            size = group.shape[1]
            rows.append(np.repeat(group, size, axis=1).ravel())
            columns.append(np.tile(group, (1, size)).ravel())
            blocks = np.asarray(matrix[rows[-1], columns[-1]]).reshape(-1, size, size)
            values.append(np.linalg.inv(blocks).ravel())
        data, *places = map(np.concatenate, (values, rows, columns))
        return sp.csr_matrix((data, tuple(places)), shape=matrix.shape)


def inverse_of_blocks(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Inverse of a block-diagonal matrix."""
    return Blocks(matrix).inverse(matrix)


def of_blocks(diagonal: np.ndarray, across: np.ndarray, neighbours: np.ndarray, count: int) -> sp.csr_matrix:
    """Assemble the cells' blocks: ``diagonal``, (cells, q, q), and ``across`` sides, (cells, sides, q, q).

    ``neighbours``, (cells, sides), are the cells across the sides.  ``count`` is the number of all cells;
    cells without blocks come last.
    """
    cells, sides, q, _ = across.shape
    blocks = np.concatenate([diagonal[:, None], across], axis=1).reshape(-1, q, q)
    columns = np.concatenate([np.arange(cells)[:, None], neighbours], axis=1).ravel()
    ends = (1 + sides) * np.minimum(np.arange(count + 1), cells)
    matrix = sp.bsr_matrix((blocks, columns, ends), shape=(q * count, q * count)).tocsr()
    matrix.sum_duplicates()  # two cells may share two sides
    return matrix


class ElementAssembly:
    """Assembly of square matrices from element matrices in one pass."""

    def __init__(self, unknowns: np.ndarray, width: int) -> None:
        """Prepare the pattern for the cells' ``unknowns`` (cells, local) among ``width`` unknowns."""
        flat = unknowns[:, :, None].astype(np.int64) * width + unknowns[:, None, :]
        keys, position = np.unique(flat.ravel(), return_inverse=True)
        del flat
        self.width, self._unknowns = width, unknowns.astype(np.int32)
        self._columns = (keys % max(width, 1)).astype(np.int32)
        self._ends = np.searchsorted(keys, width * np.arange(width + 1))
        # places within rows are small numbers, which take fewer bytes than places in the matrix
        position = position.reshape(*unknowns.shape, unknowns.shape[1])
        position -= self._ends[unknowns][:, :, None]
        self._place = position.astype(np.min_scalar_type(int(position.max(initial=0))))

    def __call__(self, elements: np.ndarray) -> sp.csr_matrix:
        """Assemble element matrices (cells, local, local)."""
        values, entries = np.zeros(len(self._columns)), max(math.prod(elements.shape[1:]), 1)
        for first in range(0, len(elements), at_once := max(_AT_ONCE // entries, 1)):
            chunk = slice(first, first + at_once)
            position = self._ends[self._unknowns[chunk]][:, :, None] + self._place[chunk]
            # NumPy adds numbers that are not floats one by one, which is seventeen times slower
            numbers = elements[chunk].astype(float, copy=False)
            np.add.at(values, position.astype(np.intp, copy=False).ravel(), numbers.ravel())
        pattern = self._columns.copy(), self._ends.copy()
        return sp.csr_matrix((values, *pattern), shape=(self.width, self.width))

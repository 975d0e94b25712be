"""Small operations with scipy's sparse matrices."""

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision


def apply(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """matrix @ each row, (rows, height): twice as fast as by one pass for several columns."""
    return np.stack([matrix @ row for row in rows])


def largest(values: np.ndarray) -> float:
    """The largest modulus, 1 where all are zero."""
    return float(abs(values).max(initial=0.0)) or 1.0


class Rounded:
    """A matrix in single precision and in units of its own, as what it is applied to: SI's may leave it."""

    def __init__(self, matrix: sp.csr_matrix) -> None:
        self._unit = largest(matrix.data)
        self._matrix = (matrix / self._unit).astype(precision.SINGLE).tocsr()

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """matrix @ each row, (rows, height)."""
        length = largest(rows)
        found = apply(self._matrix, (rows / length).astype(precision.SINGLE))
        return np.float64(self._unit * length) * found


def widened(matrix: sp.csr_matrix, height: int, width: int) -> sp.csr_matrix:
    """The matrix with zero rows and columns after its own."""
    result = matrix.copy()
    result.resize((height, width))
    return result


def mass_matrix(values: sp.csr_matrix, weights: np.ndarray) -> sp.csr_matrix:
    """The mass matrix of functions with these values at the points."""
    return (values.T @ sp.diags(weights) @ values).tocsr()


def pruned(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Without the entries that are rounding: a side sees the normal derivative of its own facet alone."""
    matrix.data[abs(matrix.data) <= 1e-14 * abs(matrix.data).max(initial=0.0)] = 0.0
    matrix.eliminate_zeros()
    return matrix


def of_blocks(
    own: np.ndarray, across: np.ndarray, neighbours: np.ndarray, count: int | None = None
) -> sp.csr_matrix:
    """A matrix of cells' blocks: their ``own`` (cells, q, q), and ``across`` each side, (cells, sides, q, q).

    ``neighbours`` (cells, sides) are the cells there; ``count`` is their number where some have no blocks.
    """
    cells, sides, q, _ = across.shape
    count = cells if count is None else count
    row = np.repeat(np.arange(cells), 1 + sides)
    column = np.concatenate([np.arange(cells)[:, None], neighbours], axis=1).ravel()
    blocks = np.concatenate([own[:, None], across], axis=1).reshape(-1, q, q)
    inside = np.arange(q)
    rows = np.broadcast_to((q * row[:, None, None] + inside[:, None]), blocks.shape)
    columns = np.broadcast_to((q * column[:, None, None] + inside[None, :]), blocks.shape)
    return sp.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(q * count,) * 2)


class ElementAssembly:
    """Square matrices as sums of element matrices, in one pass."""

    def __init__(self, unknowns: np.ndarray, width: int) -> None:
        """``unknowns`` (cells, local) are those of the cells, ``width`` is the number of all."""
        self.width = width
        flat = unknowns[:, :, None].astype(np.int64) * width + unknowns[:, None, :]
        keys, self._position = np.unique(flat.ravel(), return_inverse=True)
        self._rows, self._columns = keys // width, keys % width

    def __call__(self, elements: np.ndarray) -> sp.csr_matrix:
        """The matrix of element matrices (cells, local, local)."""
        values = np.bincount(self._position, weights=elements.ravel(), minlength=len(self._rows))
        return sp.csr_matrix((values, (self._rows, self._columns)), shape=(self.width, self.width))

"""Small operations with scipy's sparse matrices."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def apply(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """matrix @ each row, (rows, height)."""
    return np.stack([matrix @ row for row in rows])


def together(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """The same, of few rows by one pass through the matrix."""
    return np.ascontiguousarray((matrix @ np.ascontiguousarray(rows.T, matrix.dtype)).T)


def mass_matrix(values: sp.csr_matrix, weights: np.ndarray) -> sp.csr_matrix:
    """The mass matrix of functions with these values at the points."""
    return (values.T @ sp.diags(weights) @ values).tocsr()


def pruned(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Without the entries that are rounding: a side sees the normal derivative of its own facet alone."""
    matrix.data[abs(matrix.data) <= 1e-14 * abs(matrix.data).max(initial=0.0)] = 0.0
    matrix.eliminate_zeros()
    return matrix

"""Block-diagonal inverses of sparse matrices whose blocks are cells or facets."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ngvisco.algebra.local import by_parts
from ngvisco.threads import product


class BlockInverse:
    """The inverse of a block-diagonal matrix, or of the block diagonal of a matrix.

    The blocks are the connected components of ``pattern``; unknowns without an entry there (copies of
    identified ones) are left out, and get 0.  Blocks have few different sizes; those of one size are
    inverted together.
    """

    def __init__(self, pattern: sp.csr_matrix, tolerance: float = 1e-13) -> None:
        pattern = pattern.tocsr()
        size = abs(pattern.data).max(initial=0.0)
        used = np.where(abs(pattern.data) > tolerance * size, 1.0, 0.0)
        graph = sp.csr_matrix((used, pattern.indices, pattern.indptr), shape=pattern.shape, copy=True)
        graph.eliminate_zeros()
        count, label = connected_components(graph, directed=False)
        label[np.diff(graph.indptr) == 0] = count
        order = np.argsort(label, kind="stable")
        order = order[label[order] < count]
        _, sizes = np.unique(label[order], return_counts=True)
        starts = np.cumsum(sizes) - sizes
        self.groups = [
            order[starts[sizes == size][:, None] + np.arange(size)[None]] for size in np.unique(sizes)
        ]
        self.size = pattern.shape[0]
        self._inverses: list[np.ndarray] = []
        # blocks of a discontinuous space stand one after the other
        self._in_order = (
            len(self.groups) == 1
            and self.groups[0].size == self.size
            and bool((self.groups[0].ravel() == np.arange(self.size)).all())
        )
        self._entries = [_entries(group) for group in self.groups]

    @classmethod
    def of(cls, matrix: sp.csr_matrix) -> "BlockInverse":
        """The inverse of a matrix that stays what it is."""
        inverse = cls(matrix)
        inverse.update(matrix)
        return inverse

    def update(self, matrix: sp.csr_matrix) -> None:
        """Invert the blocks of ``matrix``."""
        blocks = [
            np.asarray(matrix[rows, columns]).reshape(len(group), group.shape[1], group.shape[1])
            for group, (rows, columns) in zip(self.groups, self._entries, strict=True)
        ]
        self._inverses = [np.linalg.inv(block) for block in blocks]

    def matrix(self) -> sp.csr_matrix:
        """The inverse as a sparse matrix."""
        none = np.zeros(0, dtype=np.int64)  # as on a rank without cells
        values = np.concatenate([np.zeros(0), *(inverse.ravel() for inverse in self._inverses)])
        rows, columns = (np.concatenate([none, *(entry[i] for entry in self._entries)]) for i in range(2))
        return sp.csr_matrix((values, (rows, columns)), shape=(self.size, self.size))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """Inverse times ``r`` (..., n)."""
        if np.iscomplexobj(r):
            return by_parts(self, r)
        if self._in_order and self.groups[0].shape[1] == 1:
            return r * self._inverses[0].ravel()
        if self._in_order:
            parts = r.reshape(-1, *self.groups[0].shape).swapaxes(0, 1)
            result = np.empty(r.shape)
            out = result.reshape(-1, *self.groups[0].shape).swapaxes(0, 1)
            product(parts, self._inverses[0].swapaxes(1, 2), out=out)
            return result
        result = np.zeros_like(r)
        for group, inverse in zip(self.groups, self._inverses, strict=True):
            result[..., group] = (inverse @ r[..., group][..., None])[..., 0]
        return result


def _entries(groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the dense blocks' entries."""
    size = groups.shape[1]
    return np.repeat(groups, size, axis=1).ravel(), np.tile(groups, (1, size)).ravel()

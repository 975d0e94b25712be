"""Mass matrices of functions of facets, with weights at the sides' points."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.local import LocalMatrix


class FacetMass:
    """sum over sides of int weight u t for functions of facets: small blocks, one a facet."""

    def __init__(self, values: LocalMatrix) -> None:
        matrix = values.matrix
        self._pattern = BlockInverse((abs(matrix).T @ abs(matrix)).tocsr())
        (self.unknowns,) = self._pattern.groups
        facet_of = np.zeros(matrix.shape[1], dtype=np.int64)
        facet_of[self.unknowns.ravel()] = np.repeat(np.arange(len(self.unknowns)), self.unknowns.shape[1])
        first = matrix.indices[matrix.indptr[:-1]]
        self.facet = facet_of[first]
        columns = self.unknowns[self.facet]
        rows = np.repeat(np.arange(matrix.shape[0]), columns.shape[1])
        shapes = np.asarray(matrix[rows, columns.ravel()]).reshape(columns.shape)
        self.shapes = np.ascontiguousarray(shapes.T)  # (unknowns, points)

    def update(self, weights: np.ndarray) -> None:
        """Invert the blocks for the weights (points,)."""
        size, count = self.unknowns.shape[1], len(self.unknowns)
        blocks = np.empty((count, size, size))
        for i in range(size):
            weighted = weights * self.shapes[i]
            for j in range(i + 1):
                blocks[:, i, j] = np.bincount(self.facet, weighted * self.shapes[j], count)
                blocks[:, j, i] = blocks[:, i, j]
        self.inverses = np.linalg.inv(blocks)
        """(facets, functions of a facet, the same)."""
        self.__dict__.pop("inverse", None)

    def fitted(self, values: np.ndarray, weights: np.ndarray, where: np.ndarray) -> np.ndarray:
        """The facets' functions fitted to ``values`` (n, points), by blocks of the last ``update``.

        ``where`` are the sides' points, all of some facets, ``weights`` theirs.
        """
        facets, facet = np.unique(self.facet[where], return_inverse=True)
        shapes = self.shapes[:, where]
        loads = np.empty((len(facets), len(shapes), len(values)))
        for i, shape in enumerate(weights * shapes):
            for j, value in enumerate(values):
                loads[:, i, j] = np.bincount(facet, shape * value, len(facets))
        fit = self.inverses[facets] @ loads  # (facets, functions, n)
        return np.einsum("ip,pin->np", shapes, fit[facet])

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Inverse times ``loads`` (..., unknowns)."""
        result = np.zeros_like(loads)
        local = loads[..., self.unknowns][..., None]
        result[..., self.unknowns] = (self.inverses @ local)[..., 0]
        return result

    @cached_property
    def inverse(self) -> sp.csr_matrix:
        """The inverse as a sparse matrix."""
        size = self.unknowns.shape[1]
        rows = np.repeat(self.unknowns, size, axis=1).ravel()
        columns = np.tile(self.unknowns, (1, size)).ravel()
        n = self._pattern.size
        return sp.csr_matrix((self.inverses.ravel(), (rows, columns)), shape=(n, n))

"""The hyperviscosity's part of the velocity tangent, with the normal derivatives a eliminated."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.hyper import MatrixHyperviscosity


class HyperTangent:
    """The hyperviscosity's second derivative in v with a = E v, and the facets' own blocks.

    The coefficient is cellwise constant, c + (c - mu_1)(p - 2)/2: in the middle between the smallest and
    the largest eigenvalue of the second derivative of |.|^p/p, which couples the components of v.
    """

    def __init__(self, hyper: MatrixHyperviscosity) -> None:
        self.h = hyper
        self.side, self.h_cell = hyper.sides(), hyper.hess_cells()
        pattern = abs(hyper.J_a).T @ abs(hyper.J_a)
        self.a_inverse = BlockInverse(pattern.tocsr())
        self.facet_inverse = BlockInverse(pattern.tocsr())

    def update(self) -> None:
        """Form E, the matrix of v and the facets' blocks at the present state."""
        h = self.h
        cell, penalty = h.tangent_coefficients()
        weight = _scaled(h.side_mass, penalty[self.side])
        facets = (h.J_a_t @ weight @ h.J_a).tocsr()
        self.facet_inverse.update(facets)
        self.E = -(self.facet_inverse.matrix() @ (h.J_a_t @ (weight @ h.J_v))).tocsr()
        self.E_t = self.E.T.tocsr()
        L, J = (h.L_v + h.L_a @ self.E).tocsr(), (h.J_v + h.J_a @ self.E).tocsr()
        inverse = _scaled(h.h_inverse_matrix, cell[self.h_cell])
        own = (J.T @ weight @ J).tocsr()
        blocks = facets
        for b in range(h.size):
            rows = slice(b * h.h_count, (b + 1) * h.h_count)
            own = own + L[rows].T @ inverse @ L[rows]
            blocks = blocks + h.L_a[rows].T @ inverse @ h.L_a[rows]
        self.matrix = own.tocsr()
        self.cross = (h.J_a_t @ weight @ J).tocsr()
        for b in range(h.size):
            rows = slice(b * h.h_count, (b + 1) * h.h_count)
            self.cross = self.cross + h.L_a[rows].T @ inverse @ L[rows]
        self.a_inverse.update(blocks.tocsr())


def _scaled(matrix: sp.csr_matrix, rows: np.ndarray) -> sp.csr_matrix:
    scaled = matrix.copy()
    scaled.data *= np.repeat(rows, np.diff(matrix.indptr))
    return scaled

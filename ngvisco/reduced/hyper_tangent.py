"""The hyperviscosity's part of the velocity tangent, with the normal derivatives a eliminated.

On facets between ranks, of which each sees one side, a stays an unknown of the tangent: its matrix is then
the sum of what the ranks' cells make of it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.blocks import BlockInverse
from ngvisco.reduced.hyper_derivative import HyperDerivative


class HyperTangent:
    """The hyperviscosity's second derivative in v and the kept a, with a = E v elsewhere, and facets' blocks.

    The coefficient is c + (c - mu_1)(p - 2)/2: in the middle between the smallest and the largest
    eigenvalue of the second derivative of |.|^p/p, which couples the components of v.
    """

    def __init__(self, derivative: HyperDerivative, kept: np.ndarray) -> None:
        """``kept`` are the unknowns of a component of a that are not eliminated."""
        self.derivative, self.hyper = derivative, derivative.hyper
        h, sides = self.hyper, derivative.sides
        self.h_cell = np.arange(h.h_count) // h.h_values.local
        width = sides.of_a.shape[1]
        self.kept, self.eliminated = kept, np.setdiff1d(np.arange(width), kept)
        pattern = abs(sides.of_a[:, self.eliminated])
        pattern = pattern.T @ pattern
        self._facets = BlockInverse(pattern.tocsr())

    def update(self) -> None:
        """Form E, the matrix of v and the facets' blocks where the derivative was last updated."""
        h, sides = self.hyper, self.derivative.sides
        cell, penalty = self.derivative.tangent_coefficients()
        J_v, J_a = sides.of_v, sides.of_a[:, self.eliminated]
        L_v, L_a = h.L_v, h.L_a[:, self.eliminated]
        if len(self.kept):  # beside v
            J_v, L_v = (
                sp.hstack([of_v, of_a[:, self.kept]], format="csr")
                for of_v, of_a in ((J_v, sides.of_a), (L_v, h.L_a))
            )
        J_a_t = (sp.diags(sides.weights * penalty) @ J_a).T.tocsr()
        facets = (J_a_t @ J_a).tocsr()
        self._facets.update(facets)
        E = -(self._facets.matrix() @ (J_a_t @ J_v)).tocsr()
        self.E_t = E.T.tocsr().astype(precision.SINGLE)
        L, J = (L_v + L_a @ E).tocsr(), (J_v + J_a @ E).tocsr()
        inverse = _scaled(h.h_inverse_matrix, cell[self.h_cell])
        own = (J.T @ sp.diags(sides.weights * penalty) @ J).tocsr()
        blocks = facets
        cross = (J_a_t @ J).tocsr()
        for b in range(h.size):
            rows = slice(b * h.h_count, (b + 1) * h.h_count)
            weighted = inverse @ L[rows]
            own = own + L[rows].T @ weighted
            blocks = blocks + L_a[rows].T @ inverse @ L_a[rows]
            cross = cross + L_a[rows].T @ weighted
        self.matrix = own.tocsr()
        self._facets.update(blocks.tocsr())
        # a = E v + (blocks)^{-1} (r - cross v), of (v, r) side by side, v with the kept a
        solved = self._facets.matrix()
        of_a = sp.hstack([E - solved @ cross, solved], format="csr")
        self.solved = of_a.astype(precision.SINGLE)

    def bordered(self, matrix: sp.csr_matrix, dim: int) -> sp.csr_matrix:
        """A matrix of the flow's unknowns, v's components first, with rows and columns of the kept a."""
        own, each = self.matrix, sp.identity(dim)
        width = own.shape[0] - len(self.kept)
        others, count = matrix.shape[0] - dim * width, dim * len(self.kept)
        right = sp.vstack([sp.kron(each, own[:width, width:]), sp.csr_matrix((others, count))])
        below = sp.hstack([sp.kron(each, own[width:, :width]), sp.csr_matrix((count, others))])
        return sp.bmat([[matrix, right], [below, sp.kron(each, own[width:, width:])]], format="csr")


def _scaled(matrix: sp.csr_matrix, rows: np.ndarray) -> sp.csr_matrix:
    scaled = matrix.copy()
    scaled.data *= np.repeat(rows, np.diff(matrix.indptr))
    return scaled

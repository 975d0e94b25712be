"""The velocity tangent: the flow's operator with the fields predicted inside each cell, as a matrix.

What a cell's increments change its fields by takes the inverse of the transport's own block, without what
neighbours carry over, so that the matrix is a sum over the cells of ``FlowElements``' products; the normal
derivatives a are taken as a = E v with the mean of both sides' d_n v, weighted by the
hyperviscosity's coefficient, which leaves a matrix of v alone (``HyperTangent``); but for those of facets
between ranks, which come last.
"""

from __future__ import annotations

import scipy.sparse as sp

from ngvisco.algebra.sparse import ElementAssembly
from ngvisco.reduced.hyper_tangent import HyperTangent
from ngvisco.solver.split.schur_complement import FlowSchurComplement


class VelocityTangent:
    """The matrix of the flow's unknowns; see the module's docstring."""

    def __init__(self, flow: FlowSchurComplement, hyper: HyperTangent | None) -> None:
        self.flow, self.hyper = flow, hyper
        e = flow.elements
        self.width, self.dim = flow.op.v.width, flow.dim
        self._assembled = ElementAssembly(e.dofs, self.width)

    def matrix(self) -> sp.csr_matrix:
        """Of the flow's unknowns and the kept a, where the operator and HyperTangent were last updated.

        Over ranks in parts.
        """
        d, n, flow, e = self.dim, self.width, self.flow, self.flow.elements
        rows = e.to_fields.reshape(e.cells * e.functions, e.components * e.dim * e.local)
        fields = flow.sweep.in_cells(rows).reshape(e.to_fields.shape)
        cells = (e.own - e.from_fields @ fields).reshape(e.cells, e.local, d, d, e.local)
        blocks = [[self._assembled(cells[:, :, i, k]) for k in range(d)] for i in range(d)]
        if self.hyper is not None:
            for i in range(d):
                blocks[i][i] = blocks[i][i] + self.hyper.matrix[:n, :n]
        matrix = sp.bmat(blocks, format="csr")
        others = flow.size - d * n
        if others:
            matrix = sp.block_diag([matrix, sp.csr_matrix((others, others))], format="csr")
        if flow.rest is not None:
            matrix = (matrix + flow.rest).tocsr()
        return matrix if self.hyper is None or not len(self.hyper.kept) else self.hyper.bordered(matrix, d)

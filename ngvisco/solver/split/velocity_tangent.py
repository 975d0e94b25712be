"""The velocity tangent: the flow's operator with the fields predicted inside each cell, as a matrix.

Neither convected nor carried through facets, z makes the stiffness C of ``PointTangent`` at every point.
The element matrices of C, inertia, convection and viscosity are products of arrays over all cells; the
normal derivatives a are taken as a = E v with the mean of both sides' d_n v, weighted by the
hyperviscosity's coefficient, which leaves a matrix of v alone (``HyperTangent``).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.errors import MeshError
from ngvisco.solver.split.flow import FlowOperator
from ngvisco.solver.split.hyper_tangent import HyperTangent


class VelocityTangent:
    """The matrix of the flow's unknowns; see the module's docstring."""

    def __init__(self, flow: FlowOperator, hyper: HyperTangent | None) -> None:
        self.flow, self.hyper = flow, hyper
        op, d = flow.op, flow.d
        cells = op.points.mesh.ne
        v = op.v.matrix
        per, local = op.points.per_cell, v.indptr[1]
        if not (np.diff(v.indptr) == local).all():
            raise MeshError("a cell of a periodic mesh meets its own image: expected two cells or more")
        self.dofs = v.indices.reshape(cells, per, local)[:, 0]
        self.shapes = np.stack(
            [each.matrix.data.reshape(cells, per, local) for each in (op.v, *op.dv)], axis=2
        )  # (cells, points, 1 + d, local)
        self.weights = op.weights.reshape(cells, per)
        n = op.v.width
        flat = self.dofs[:, :, None].astype(np.int64) * n + self.dofs[:, None, :]
        keys, self.position = np.unique(flat.ravel(), return_inverse=True)
        self.rows, self.columns = keys // n, keys % n
        self.n, self.d, self.cells, self.per, self.local = n, d, cells, per, local

    def matrix(self) -> sp.csr_matrix:
        """The matrix of the flow's unknowns where FlowOperator and HyperTangent were last updated."""
        d, n, flow = self.d, self.n, self.flow
        A = flow.base.copy()
        A[:, :, 1:, :, 1:] += flow.p.stiffness()[:, : d * d, : d * d].reshape(-1, d, d, d, d)
        A = A.reshape(self.cells, self.per, d, 1 + d, d, 1 + d)
        blocks = [[self._assembled(self._cells(A[:, :, i, :, k, :])) for k in range(d)] for i in range(d)]
        inertia = self._assembled(self._inertia())
        for i in range(d):
            blocks[i][i] = blocks[i][i] + inertia
            if self.hyper is not None:
                blocks[i][i] = blocks[i][i] + self.hyper.matrix
        matrix = sp.bmat(blocks, format="csr")
        others = flow.size - d * n
        if others:
            matrix = sp.block_diag([matrix, sp.csr_matrix((others, others))], format="csr")
        return matrix if flow.rest is None else (matrix + flow.rest).tocsr()

    def _assembled(self, cells: np.ndarray) -> sp.csr_matrix:
        values = np.bincount(self.position, weights=cells.ravel(), minlength=len(self.rows))
        return sp.csr_matrix((values, (self.rows, self.columns)), shape=(self.n, self.n))

    def _inertia(self) -> np.ndarray:
        op = self.flow.m.op
        density = (self.flow.inertia * op.weights).reshape(self.cells, -1, 1)
        shapes = op.v.matrix.data.reshape(*density.shape[:2], self.local)
        return shapes.transpose(0, 2, 1) @ (density * shapes)

    def _cells(self, A: np.ndarray) -> np.ndarray:
        """Element matrices (cells, local, local) of pointwise matrices (cells, points, 1 + d, 1 + d)."""
        shapes = self.shapes
        right = (A * self.weights[:, :, None, None]) @ shapes
        shape = (self.cells, self.per * (self.d + 1), self.local)
        return shapes.reshape(shape).transpose(0, 2, 1) @ right.reshape(shape)

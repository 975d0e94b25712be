"""The velocity tangent: dR/dv with the fields predicted inside each cell.

For an increment X = (grad dv, dPi) the fields follow at every point of a coarse rule as

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep)/dz,

neither convected nor carried through facets.  With the elastic force zeta : rate(z; X) that makes the
point's stiffness C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX), not symmetric where
there is stress or creep.  The element matrices of C, inertia, convection and viscosity are products of
arrays over all cells; the normal derivatives a are taken as a = E v with the mean of both sides' d_n v,
weighted by the hyperviscosity's coefficient, which leaves a tangent of v alone (``HyperTangent``).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.errors import MeshError
from ngvisco.solver.split.hyper_tangent import HyperTangent
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import Conjugation, Operators
from ngvisco.solver.split.transport import Transport


class PointTangent:
    """Values and derivatives at the points of the coarse rule, at the present state."""

    def __init__(self, transport: Transport, operators: Operators) -> None:
        self.t, self.op = transport, operators
        self.conjugation = Conjugation(transport.step, operators.points)

    def update(self) -> None:
        """Form K's resolvent, d rate/dX and C at the present state."""
        t, op, rates = self.t, self.op, self.t.rates
        tau, g = t.context.tau.Get(), rates.gradients
        self.z, self.zeta, self.v = op.z(t.z), op.z(t.zeta), op.v(t.v)
        self.L = op.velocity_gradient(t.v)
        slopes = self._second_derivative()  # (points, n, n)
        columns = rates.columns(self.z)  # (points, n, X)
        K = np.einsum("xnm,xp->pnm", rates.linear[:g], self.L, optimize=True)
        stress_slope = np.einsum("xnm,np->pxm", rates.linear, self.zeta, optimize=True)
        # d(zeta : rate)/dX in z: what the elastic force and the Mandel stress take from dz
        force = stress_slope + np.einsum("pnx,pnm->pxm", columns, slopes, optimize=True)
        # -(w . grad z) : zeta with its share of the facets is  phi'(z) : dz div w  to leading order
        for i in range(t.step.mesh.dim):
            force[:, i * (t.step.mesh.dim + 1)] += self.zeta.T
        creep = t.step.model.creep
        if creep is not None and creep.R > 0 and creep.is_local:
            Pi = -creep.R * np.einsum("np,pnx->px", self.zeta, columns[:, :, g:], optimize=True)
            K += np.einsum("xnm,px->pnm", rates.linear[g:], Pi, optimize=True)
            K -= creep.R * columns[:, :, g:] @ force[:, g:]
        self.resolvent = np.linalg.inv(np.eye(t.n)[None] - tau * K)
        self.C = tau * force @ (self.resolvent @ columns)
        self.force, self.columns = force, columns
        self.dz = op.gradients(op.dz, t.z)

    def _second_derivative(self) -> np.ndarray:
        """phi'' by central differences of phi', (points, n, n)."""
        n, step = self.t.n, 1e-5
        result = np.empty((self.op.points.count, n, n))
        shifted = self.z.copy()
        for m in range(n):
            size = step * (1 + abs(self.z[m]).max())
            shifted[m] += size
            upper = self.conjugation(shifted)
            shifted[m] -= 2 * size
            result[:, :, m] = ((upper - self.conjugation(shifted)) / (2 * size)).T
            shifted[m] = self.z[m]
        return result


class VelocityTangent:
    """The matrix of v (all components) at the present state; see the module's docstring."""

    def __init__(self, momentum: Momentum, points: PointTangent, hyper: HyperTangent | None) -> None:
        self.m, self.p, self.hyper = momentum, points, hyper
        op, d = points.op, momentum.dim
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

    def matrices(self) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        """Matrices of the flow's unknowns without and with the elastic and the hyperviscosity's part.

        PointTangent and HyperTangent are those of the present state.
        """
        d, n = self.d, self.n
        plain, elastic = (
            [[self._assembled(self._cells(A[:, :, i, :, k, :])) for k in range(d)] for i in range(d)]
            for A in self._pointwise()
        )
        inertia = self._assembled(self._inertia())
        for i in range(d):
            plain[i][i] = plain[i][i] + inertia
        parts = [sp.bmat(plain, format="csr"), sp.bmat(elastic, format="csr")]
        if self.hyper is not None:
            parts[1] = parts[1] + sp.block_diag([self.hyper.matrix] * d, format="csr")
        rest = self.m.rows - d * n
        if rest:
            parts = [sp.block_diag([m, sp.csr_matrix((rest, rest))]) for m in parts]
        if self.m.by_forms is not None:
            parts[0] = parts[0] + self.m.by_forms.jacobian()
        if self.m.transport.Pi is not None:
            creep = self._creep_stiffness()
            first = self.m.rows - creep.shape[0]
            parts[0] = parts[0] + sp.block_diag([sp.csr_matrix((first, first)), creep])
        plain_matrix = parts[0].tocsr()
        return plain_matrix, (plain_matrix + parts[1]).tocsr()

    def _assembled(self, cells: np.ndarray) -> sp.csr_matrix:
        values = np.bincount(self.position, weights=cells.ravel(), minlength=len(self.rows))
        return sp.csr_matrix((values, (self.rows, self.columns)), shape=(self.n, self.n))

    def _creep_stiffness(self) -> sp.csr_matrix:
        """What M takes from a creep rate field Pi within the step, coupling to v left out."""
        p, op = self.p, self.p.op
        first = p.t.rates.gradients
        values = op.points.values(op.creep)
        C = p.C[:, first:, first:] * op.weights[:, None, None]
        size = C.shape[1]
        blocks = [[values.T @ sp.diags(C[:, i, k]) @ values for k in range(size)] for i in range(size)]
        return sp.bmat(blocks, format="csr")

    def _inertia(self) -> np.ndarray:
        """(rho + rho_old)/(2 tau), by the rule of the forms: the coarse one does not see all of P_k."""
        t, op = self.m.transport, self.m.op
        density = op.z(0.5 / t.context.tau.Get() * (t.rho + t.rho_old)) * op.weights
        shapes = op.v.matrix.data.reshape(self.cells, op.points.per_cell, self.local)
        return shapes.transpose(0, 2, 1) @ (density.reshape(shapes.shape[:2])[:, :, None] * shapes)

    def _cells(self, A: np.ndarray) -> np.ndarray:
        """Element matrices (cells, local, local) of pointwise matrices (cells, points, 1 + d, 1 + d)."""
        shapes = self.shapes
        right = (A * self.weights[:, :, None, None]) @ shapes
        shape = (self.cells, self.per * (self.d + 1), self.local)
        return shapes.reshape(shape).transpose(0, 2, 1) @ right.reshape(shape)

    def _pointwise(self) -> tuple[np.ndarray, np.ndarray]:
        """dR/d(v, grad v) at the points, (cells, points, i, 0 or 1 + j, k, 0 or 1 + l); its elastic part."""
        m, p, d = self.m, self.p, self.d
        t, op = m.transport, p.op
        rho = op.z(t.rho)
        v, L = p.v, p.L
        count = op.points.count
        A = np.zeros((count, d, 1 + d, d, 1 + d))
        for i in range(d):
            for j in range(d):
                A[:, i, 0, j, 0] += 0.5 * L[i * d + j] * rho
                A[:, i, 0, i, 1 + j] += 0.5 * rho * v[j]
                A[:, i, 1 + j, i, 0] -= 0.5 * rho * v[j]
                A[:, i, 1 + j, j, 0] -= 0.5 * rho * v[i]
                A[:, i, 0, j, 1 + j] -= 0.5 * rho * v[i]
        elastic = np.zeros_like(A)
        elastic[:, :, 1:, :, 1:] = p.C[:, : d * d, : d * d].reshape(count, d, d, d, d)
        if m.stokes is not None:
            A[:, :, 1:, :, 1:] += m.stokes.reshape(1, d, d, d, d)
        shape = (self.cells, self.per, d, 1 + d, d, 1 + d)
        return A.reshape(shape), elastic.reshape(shape)

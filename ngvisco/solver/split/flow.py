"""The flow's linear operator: dR/d(v, wall stress, Pi, a) with the fields carried along.

An increment of v changes z by rate(z; grad dv) - (dv . grad) z, carried by the transport within the step
(``Sweep``), and dz the elastic force: what remains of Newton's matrix when z is eliminated.  Values are
taken at the points of a coarse rule, but for inertia: a rule that does not see all of P_k makes it
singular.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.reversal import Reversal
from ngvisco.solver.split.sweep import Sweep
from ngvisco.solver.split.tangent import PointTangent


class FlowOperator:
    """The operator at the state of the last ``update``."""

    def __init__(
        self, momentum: Momentum, points: PointTangent, sweep: Sweep, derivative: HyperDerivative | None
    ) -> None:
        self.m, self.p, self.sweep, self.derivative = momentum, points, sweep, derivative
        self.t, self.op, self.d = momentum.transport, points.op, momentum.dim
        self.reversal = Reversal(self.t.facets)
        self.nv = self.t.v.size
        self.size = momentum.rows

    def update(self, everything: bool = True) -> None:
        """Linearise at the present state, whose residual has just been evaluated.

        Without ``everything`` only hyperviscosity, upwinding and a density equation that is not linear.
        """
        self.sweep.linearise()
        self.reversal.update(self.t.z, self.t.zeta, abs(self.t.v_q).max())
        if self.derivative is not None:
            self.derivative.update()
        if not everything:
            return
        self.p.update()
        self.sweep.update()
        d, count = self.d, self.op.points.count
        self.base = self._base()
        self._matrices = self.base.reshape(count, d * (1 + d), d * (1 + d))
        self.inertia = self.m.op.z(0.5 / self.t.context.tau.Get() * (self.t.rho + self.t.rho_old))
        self.rest = self._rest()

    def _base(self) -> np.ndarray:
        """dR/d(v, grad v) of convection and viscosity: (points, i, 0 or 1 + j, k, 0 or 1 + l)."""
        p, d = self.p, self.d
        rho = p.op.z(self.t.rho)
        v, L = p.v, p.L
        A = np.zeros((p.op.points.count, d, 1 + d, d, 1 + d))
        for i in range(d):
            for j in range(d):
                A[:, i, 0, j, 0] += 0.5 * L[i * d + j] * rho
                A[:, i, 0, i, 1 + j] += 0.5 * rho * v[j]
                A[:, i, 1 + j, i, 0] -= 0.5 * rho * v[j]
                A[:, i, 1 + j, j, 0] -= 0.5 * rho * v[i]
                A[:, i, 0, j, 1 + j] -= 0.5 * rho * v[i]
        if self.m.stokes is not None:
            A[:, :, 1:, :, 1:] += self.m.stokes.reshape(1, d, d, d, d)
        return A

    def _rest(self) -> sp.csr_matrix | None:
        """Walls, damping and the creep rate field, as a matrix."""
        rest = None if self.m.by_forms is None else self.m.by_forms.jacobian()
        if self.t.Pi is None:
            return rest
        creep = self._creep_stiffness()
        first = self.size - creep.shape[0]
        creep = sp.block_diag([sp.csr_matrix((first, first)), creep], format="csr")
        return creep if rest is None else (rest + creep).tocsr()

    def _creep_stiffness(self) -> sp.csr_matrix:
        """What M takes from a creep rate field Pi within the step, coupling to v left out."""
        first = self.t.rates.gradients
        values = self.op.points.values(self.op.creep)
        C = self.p.stiffness()[:, first:, first:] * self.op.weights[:, None, None]
        size = C.shape[1]
        blocks = [[values.T @ sp.diags(C[:, i, k]) @ values for k in range(size)] for i in range(size)]
        return sp.bmat(blocks, format="csr")

    def __call__(self, flow: np.ndarray, normals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
        """Rows of the flow's unknowns and of a, of an increment of these."""
        d, op = self.d, self.op
        dv = flow[: self.nv].reshape(d, -1)
        v_q, L = op.v(dv), op.velocity_gradient(dv)
        both = np.concatenate([v_q[:, None], L.reshape(d, d, -1)], axis=1)
        tested = at_points(self._matrices, both.reshape(d * (1 + d), -1)).reshape(d, 1 + d, -1)
        force, through = self.reversal(dv) if self.reversal.exists else (0.0, 0.0)
        tested[:, 1:] += self.stress(self.carried(L, v_q, through)).reshape(d, d, -1)
        rows = op.v.test(tested[:, 0]) + self.tested(tested[:, 1:]) + force
        rows += self.m.op.v.test(self.inertia * self.m.op.v(dv))
        of_a = None
        if self.derivative is not None and normals is not None:
            of_both = self.derivative(np.concatenate([dv, normals], axis=1))
            rows += of_both[:, : op.v.width]
            of_a = of_both[:, op.v.width :]
        result = np.zeros(self.size) if self.rest is None else self.rest @ flow
        result[: self.nv] += rows.ravel()
        return result, of_a

    def resolved(self, dz: np.ndarray) -> np.ndarray:
        """(1 - tau K)^{-1} dz at the points, (n, points), of coefficients dz."""
        return at_points(self.p.resolvent, self.op.z(dz))

    def carried(self, X: np.ndarray, v_q: np.ndarray, through: np.ndarray | float) -> np.ndarray:
        """What z takes from an increment of v and Pi, (n, points).

        These have the values ``X`` = (grad v, Pi) and ``v_q`` at the points, and change the rows of z by
        ``through`` what crosses facets.
        """
        source = at_points(self.p.columns[:, :, : len(X)], X)
        for j, values in enumerate(v_q):
            source -= self.p.dz[:, j] * values
        return self.resolved(self.sweep.fields(self.op.z.test(source) - through))

    def stress(self, dz: np.ndarray) -> np.ndarray:
        """The elastic stress's derivative in dz at the points, entries ij row by row, (dim^2, points)."""
        return at_points(self.p.force[:, : self.d**2], dz)

    def tested(self, stress: np.ndarray) -> np.ndarray:
        """int stress : grad w, rows of v (dim, .), of stress (dim, dim, points)."""
        rows = np.zeros((self.d, self.op.v.width))
        for j, D in enumerate(self.op.dv):
            rows += D.test(np.ascontiguousarray(stress[:, j]))
        return rows


def at_points(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrices (points, i, j) times values (j, points): (i, points)."""
    return np.ascontiguousarray((matrices @ values.T[:, :, None])[:, :, 0].T)

"""The flow's linear operator: dR/d(v, wall stress, Pi, a) with the fields carried along.

An increment of v changes z by rate(z; grad dv) - (dv . grad) z, carried by the transport within the step
(``Sweep``), and dz the elastic force: what remains of Newton's matrix when z is eliminated.  Element
matrices (``FlowElements``) are of a coarse rule, but for inertia: a rule that does not see all of P_k makes
it singular.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.solver.split.elements import FlowElements
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.reversal import Reversal
from ngvisco.solver.split.sweep import Sweep
from ngvisco.solver.split.tangent import PointTangent
from ngvisco.threads import concurrently, product


class FlowOperator:
    """The operator at the state of the last ``update``."""

    def __init__(
        self, momentum: Momentum, points: PointTangent, sweep: Sweep, derivative: HyperDerivative | None
    ) -> None:
        self.m, self.p, self.sweep, self.derivative = momentum, points, sweep, derivative
        self.t, self.op, self.d = momentum.transport, points.op, momentum.dim
        self.elements = FlowElements(points, momentum.op)
        self.reversal = Reversal(self.t.facets)
        self.nv = self.t.v.size
        self.size = momentum.rows

    def update(self, everything: bool = True) -> None:
        """Linearise at the present state, whose residual has just been evaluated.

        Without ``everything`` only hyperviscosity, upwinding and a density equation that is not linear.
        """
        self.sweep.linearise()
        self.reversal.update(self.t.z, self.t.zeta, self.t.rho)
        if self.derivative is not None:
            self.derivative.update()
        if not everything:
            return
        concurrently(self.p.update, self.sweep.update, self.op.points.count * self.t.n**2)
        inertia = self.m.op.z(self.t.context.rate(0.5 * (self.t.rho + self.t.rho_old)))
        self.elements.update(self._base(), inertia)
        self.rest = self._rest()

    def _base(self) -> np.ndarray:
        """dR/d(v, grad v) of convection and viscosity: (points, 0 or 1 + j, i, k, 0 or 1 + l)."""
        p, d = self.p, self.d
        rho = p.op.z(self.t.rho)
        v, L = p.v, p.L
        A = np.zeros((p.op.points.count, 1 + d, d, d, 1 + d))
        for i in range(d):
            for j in range(d):
                A[:, 0, i, j, 0] += 0.5 * L[i * d + j] * rho
                A[:, 0, i, i, 1 + j] += 0.5 * rho * v[j]
                A[:, 1 + j, i, i, 0] -= 0.5 * rho * v[j]
                A[:, 1 + j, i, j, 0] -= 0.5 * rho * v[i]
                A[:, 0, i, j, 1 + j] -= 0.5 * rho * v[i]
        if self.m.stokes is not None:
            A[:, 1:, :, :, 1:] += self.m.stokes.reshape(d, d, d, d).swapaxes(0, 1)
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
        dv, of_a = flow[: self.nv].reshape(self.d, -1), None
        if self.derivative is None or normals is None:
            rows = self._with_fields(dv)
        else:
            x, hyper = np.concatenate([dv, normals], axis=1), self.derivative
            size = self.elements.own.size
            rows, of_x = concurrently(lambda: self._with_fields(dv), lambda: hyper(x), size)
            rows += of_x[:, : dv.shape[1]]
            of_a = of_x[:, dv.shape[1] :]
        result = np.zeros(self.size) if self.rest is None else self.rest @ flow
        result[: self.nv] += rows.ravel()
        return result, of_a

    def _with_fields(self, dv: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), without hyperviscosity, with the fields carried along."""
        e = self.elements
        local = e.gathered(dv)
        force, through = self.reversal(dv) if self.reversal.exists else (0.0, None)
        carried = self._carried(product(e.to_fields, local).reshape(-1, e.n), through)
        of_cells = product(e.own, local)
        of_cells += product(e.from_fields, carried.reshape(e.cells, -1, 1))
        return e.scattered(of_cells) + force

    def _carried(self, rows: np.ndarray, through: np.ndarray | None) -> np.ndarray:
        """What increments of v change z by, before rates and creep, (cells' unknowns, n).

        They change the rows of z, (cells' unknowns, n), by ``rows`` and, at the facets, by ``through``.
        """
        if through is not None:
            rows += through.T
        return self.sweep.fields(-rows)

    def force(self, dz: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), of what the sweeps make of the fields' rows, (cells' unknowns, n)."""
        e = self.elements
        return e.scattered(product(e.from_fields, dz.reshape(e.cells, -1, 1)))

    def carried(self, dv: np.ndarray, dPi: np.ndarray | None) -> np.ndarray:
        """What z takes from an increment of v (dim, .) and Pi, before rates and creep, as above."""
        e = self.elements
        rows = product(e.to_fields, e.gathered(dv)).reshape(-1, e.n)
        if dPi is not None:
            values = at_points(self.p.columns[:, :, self.d**2 :], dPi)
            rows -= self.op.z.test(values).T
        return self._carried(rows, self.reversal(dv)[1] if self.reversal.exists else None)

    def resolved(self, dz: np.ndarray) -> np.ndarray:
        """(1 - tau K)^{-1} dz at the points, (n, points), of coefficients dz (cells' unknowns, n)."""
        return at_points(self.p.resolvent, self.op.z(np.ascontiguousarray(dz.T)))


def at_points(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrices (points, i, j) times values (j, points): (i, points)."""
    return np.ascontiguousarray(product(matrices, values.T[:, :, None])[:, :, 0].T)

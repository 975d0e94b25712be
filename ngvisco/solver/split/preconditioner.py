"""P^{-1} R: what the split solver takes for an increment of all unknowns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.forms.system import Step
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.hyper import MatrixHyperviscosity
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.hyper_tangent import HyperTangent
from ngvisco.solver.split.linear import DirectSolver, TwoLevelSolver
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import Operators, apply, mass_matrix
from ngvisco.solver.split.sweep import Sweep
from ngvisco.solver.split.tangent import PointTangent, VelocityTangent
from ngvisco.solver.split.unknowns import Unknowns

FLOW_ITERATIONS = 30
"""GMRES iterations for (v, a) with the tangent of v and facets' blocks as preconditioner."""


DIRECT_UP_TO = {2: 100_000, 3: 3_000}
"""Unknowns of v, by dimension, up to which its tangent is factorised as a whole; above, two levels do.

(3D, 2,639 tetrahedra: 5.4 s for a factorisation, 0.1 s for two levels, and no more GMRES iterations' time.)
"""


@dataclass
class Residual:
    """Rows of the flow's unknowns, of the normal derivatives a (dim, .), of the density's and of z (n, .)."""

    flow: np.ndarray
    normals: np.ndarray | None
    density: np.ndarray
    z: np.ndarray


class Preconditioner:
    """One sweep of the transport, the flow's tangent, and what z and rho take from the new velocity."""

    def __init__(
        self,
        step: Step,
        momentum: Momentum,
        hyper: MatrixHyperviscosity | None,
        unknowns: Unknowns,
        inverse: str,
    ) -> None:
        self.t, self.m, self.unknowns = momentum.transport, momentum, unknowns
        k, m = step.discretisation.k, step.discretisation.m
        self.op = Operators(step, max(k - 1, m))
        self.d = step.mesh.dim
        self.points = PointTangent(self.t, self.op)
        self.derivative = None if hyper is None else HyperDerivative(hyper)
        self.hyper_tangent = None if self.derivative is None else HyperTangent(self.derivative)
        self.tangent = VelocityTangent(momentum, self.points, self.hyper_tangent)
        self.sweep = Sweep(self.t, inverse)
        free = [np.array(list(step.layout.blocks[name].FreeDofs()), dtype=bool) for name in unknowns.flow]
        self.free = np.concatenate(free)
        self.solver: DirectSolver | TwoLevelSolver
        if unknowns.flow == ["v"] and self.free.sum() > DIRECT_UP_TO[self.d]:
            per_component = len(self.free) // self.d
            vertices = np.arange(len(self.free)) % per_component < step.mesh.nv
            self.solver = TwoLevelSolver(self.free, vertices, inverse)
        else:
            self.solver = DirectSolver(self.free, inverse, symmetric=unknowns.flow == ["v"])
        mass = mass_matrix(self.op.z.matrix, self.op.weights)
        self.project = BlockInverse(mass)
        self.project.update(mass)
        self.nv = self.t.v.size
        if self.t.Pi is not None:
            self._creep = self.op.local(self.op.points.values(self.op.creep))

    def update(self, clock: Callable[[str], AbstractContextManager[None]]) -> None:
        """Form and factorise everything at the present state, whose residual has just been evaluated.

        ``clock(name)`` measures the time of a part.
        """
        with clock("assembly"):
            self.points.update()
            if self.hyper_tangent is not None:
                self.hyper_tangent.derivative.update()
                self.hyper_tangent.update()
            self.plain, matrix = self.tangent.matrices()
        with clock("factorisation"):
            self.solver.factorise(matrix)
        with clock("assembly"):
            self.sweep.update()

    def linearise(self) -> None:
        """Let what is strongly nonlinear follow the present state, at little cost."""
        self.sweep.linearise()
        if self.derivative is not None:
            self.derivative.update()

    def __call__(self, r: Residual, tolerance: float) -> np.ndarray:
        """The increment, packed; ``tolerance`` is that of the flow's linear system."""
        op, d, t = self.op, self.d, self.t
        dz = self._resolved(self.sweep.fields(r.z))
        flow = r.flow.copy()
        flow[: self.nv] -= self._force(dz).ravel()
        dflow, da = self._flow(flow, r.normals, tolerance)
        dv = dflow[: self.nv].reshape(d, -1)
        X = op.velocity_gradient(dv)
        if t.Pi is not None:
            X = np.concatenate([X, self._creep(dflow[-t.Pi.size :].reshape(t.Pi.shape))])
        dv_q = op.v(dv)
        dz += self._carried(X, dv_q)
        drho = op.z(t.rho) * sum(X[i * (d + 1)] for i in range(d))
        drho += sum(D(t.rho) * dv_q[j] for j, D in enumerate(op.dz))
        density = r.density.copy()
        density[: t.rho.size] -= op.z.test(drho)
        parts = [dflow, *([] if da is None else [da.ravel()]), self.sweep.density(density)]
        return np.concatenate([*parts, self.project(op.z.test(dz)).ravel()])

    def _resolved(self, dz: np.ndarray) -> np.ndarray:
        """(1 - tau K)^{-1} dz at the coarse rule's points, (n, points), of coefficients dz."""
        return _at_points(self.points.resolvent, self.op.z(dz))

    def _carried(self, X: np.ndarray, dv_q: np.ndarray) -> np.ndarray:
        """What z takes from an increment of v and Pi with these values at the points, (n, points)."""
        p = self.points
        source = _at_points(p.columns[:, :, : len(X)], X)
        for j, values in enumerate(dv_q):
            source -= p.dz[:, j] * values
        return self._resolved(self.sweep.fields(self.op.z.test(source)))

    def _force(self, dz: np.ndarray) -> np.ndarray:
        """The elastic force's derivative in dz at the points, rows of v (dim, .)."""
        stress = _at_points(self.points.force[:, : self.d**2], dz)
        rows = np.zeros((self.d, self.op.v.width))
        for j, D in enumerate(self.op.dv):
            rows += D.test(stress[j :: self.d])
        return rows

    def _flow(
        self, flow: np.ndarray, normals: np.ndarray | None, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """(v, ..., a) of the flow's tangent with the hyperviscosity's own derivative, by GMRES."""
        count, shape = len(flow), (0,) if normals is None else normals.shape
        right = np.concatenate(
            [np.where(self.free, flow, 0.0), np.ravel(normals) if normals is not None else []]
        )

        def operator(y: np.ndarray) -> np.ndarray:
            rows = self.plain @ y[:count]
            dv = y[: self.nv].reshape(self.d, -1)
            carried = self._carried(self.op.velocity_gradient(dv), self.op.v(dv))
            rows[: self.nv] += self._force(carried).ravel()
            if self.derivative is None:
                return np.where(self.free, rows, 0.0)
            both = [dv, y[count:].reshape(shape)]
            of_both = self.derivative(np.concatenate(both, axis=1))
            n = self.nv // self.d
            rows[: self.nv] += of_both[:, :n].ravel()
            return np.concatenate([np.where(self.free, rows, 0.0), of_both[:, n:].ravel()])

        def block(y: np.ndarray) -> np.ndarray:
            h = self.hyper_tangent
            if h is None:
                return self.solver(y)
            a = y[count:].reshape(shape)
            rows = y[:count].copy()
            rows[: self.nv] += apply(h.E_t, a).ravel()
            increment = self.solver(rows)
            dv = increment[: self.nv].reshape(self.d, -1)
            da = apply(h.E, dv) + h.a_inverse(a - apply(h.cross, dv))
            return np.concatenate([increment, da.ravel()])

        start = block(right)
        # lengths in units of each block's first increment, so that stresses do not drown velocities
        scale = np.ones_like(start)
        for where in self._blocks(count, len(start)):
            scale[where] = np.linalg.norm(start[where]) / np.sqrt(where.stop - where.start) or 1.0
        size = len(right)
        operator_of_scaled = LinearOperator(
            (size, size), lambda y: block(operator(scale * y)) / scale, dtype=float
        )
        y, _ = gmres(operator_of_scaled, start / scale, rtol=tolerance, restart=FLOW_ITERATIONS, maxiter=1)
        y *= scale
        return y[:count], None if normals is None else y[count:].reshape(shape)

    def _blocks(self, count: int, size: int) -> list[slice]:
        """v, wall stress, creep rate and normal derivatives in the joint vector of the flow."""
        blocks = [self.unknowns.slices[name] for name in self.unknowns.flow]
        return blocks if count == size else [*blocks, slice(count, size)]


def _at_points(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrices (points, i, j) times values (j, points): (i, points)."""
    return np.ascontiguousarray((matrices @ values.T[:, :, None])[:, :, 0].T)

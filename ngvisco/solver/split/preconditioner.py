"""P^{-1} R: what the split solver takes for an increment of all unknowns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.forms.mesh_arrays import mask_of
from ngvisco.forms.system import Step
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.flow import FlowOperator
from ngvisco.solver.split.hyper import MatrixHyperviscosity
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.hyper_tangent import HyperTangent
from ngvisco.solver.split.linear import DirectSolver, TwoLevelSolver
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import Operators, mass_matrix, together
from ngvisco.solver.split.sweep import Sweep
from ngvisco.solver.split.tangent import PointTangent
from ngvisco.solver.split.unknowns import Unknowns
from ngvisco.solver.split.velocity_tangent import VelocityTangent


@dataclass
class Residual:
    """Rows of the flow's unknowns, of the normal derivatives a (dim, .), of the density's and of z (n, .)."""

    flow: np.ndarray
    normals: np.ndarray | None
    density: np.ndarray
    z: np.ndarray


class Preconditioner:
    """Sweeps of the transport, the flow's linear system, and what z and rho take from the new velocity."""

    def __init__(
        self,
        step: Step,
        momentum: Momentum,
        hyper: MatrixHyperviscosity | None,
        unknowns: Unknowns,
        options: NewtonOptions,
    ) -> None:
        self.t, self.m, self.unknowns = momentum.transport, momentum, unknowns
        k, m = step.discretisation.k, step.discretisation.m
        self.op = Operators(step, max(k - 1, m))
        self.d = step.mesh.dim
        self.sweep = Sweep(self.t, options.inverse)
        derivative = None if hyper is None else HyperDerivative(hyper)
        self.operator = FlowOperator(momentum, PointTangent(self.t, self.op), self.sweep, derivative)
        self.hyper_tangent = None if derivative is None else HyperTangent(derivative)
        self.tangent = VelocityTangent(self.operator, self.hyper_tangent)
        free = [mask_of(step.layout.blocks[name].FreeDofs()) for name in unknowns.flow]
        self.free = np.concatenate(free)
        self.solver: DirectSolver | TwoLevelSolver
        if self.free.sum() > options.split.direct_up_to[self.d - 2]:
            others = np.arange(len(self.free)) >= self.t.v.size
            vertices = ~others & (np.arange(len(self.free)) % self.t.v.shape[1] < step.mesh.nv)
            self.solver = TwoLevelSolver(
                self.free, vertices, others, options.inverse, options.split.two_level
            )
        else:
            self.solver = DirectSolver(self.free, options.inverse, symmetric=unknowns.flow == ["v"])
        mass = mass_matrix(self.op.z.matrix, self.op.weights)
        self.project = BlockInverse(mass)
        self.project.update(mass)
        self.nv = self.t.v.size
        self.flow_iterations = options.split.flow_iterations
        self.iterations = 0
        """What the last linear system of the flow took."""
        if self.t.Pi is not None:
            self._creep = self.op.local(self.op.points.values(self.op.creep))

    def update(self, clock: Callable[[str], AbstractContextManager[None]]) -> None:
        """Form and factorise everything at the present state, whose residual has just been evaluated.

        ``clock(name)`` measures the time of a part.
        """
        with clock("assembly"):
            self.operator.update()
            if self.hyper_tangent is not None:
                self.hyper_tangent.update()
            matrix = self.tangent.matrix()
        with clock("factorisation"):
            self.solver.factorise(matrix)

    def linearise(self, everything: bool) -> None:
        """Let the linear operator follow the present state, or what changes suddenly; the rest stays."""
        self.operator.update(everything)

    def __call__(self, r: Residual, tolerance: float) -> np.ndarray:
        """The increment, packed; ``tolerance`` is that of the flow's linear system."""
        op, d, t, operator = self.op, self.d, self.t, self.operator
        dz = self.sweep.fields(np.ascontiguousarray(r.z.T))
        flow = r.flow.copy()
        flow[: self.nv] -= operator.force(dz).ravel()
        dflow, da = self._flow(flow, r.normals, tolerance)
        dv = dflow[: self.nv].reshape(d, -1)
        dPi = None if t.Pi is None else self._creep(dflow[-t.Pi.size :].reshape(t.Pi.shape))
        dz += operator.carried(dv, dPi)
        dv_q, L = op.v(dv), op.velocity_gradient(dv)
        drho = op.z(t.rho) * sum(L[i * (d + 1)] for i in range(d))
        drho += sum(D(t.rho) * dv_q[j] for j, D in enumerate(op.dz))
        density = r.density.copy()
        density[: t.rho.size] -= op.z.test(drho)
        parts = [dflow, *([] if da is None else [da.ravel()]), self.sweep.density(density)]
        return np.concatenate([*parts, self.project(op.z.test(operator.resolved(dz))).ravel()])

    def _flow(
        self, flow: np.ndarray, normals: np.ndarray | None, tolerance: float
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """(v, ..., a) of the flow's tangent with the hyperviscosity's own derivative, by GMRES."""
        count, shape = len(flow), (0,) if normals is None else normals.shape
        right = np.concatenate(
            [np.where(self.free, flow, 0.0), np.ravel(normals) if normals is not None else []]
        )

        def operator(y: np.ndarray) -> np.ndarray:
            rows, of_a = self.operator(y[:count], None if normals is None else y[count:].reshape(shape))
            rows = np.where(self.free, rows, 0.0)
            return rows if of_a is None else np.concatenate([rows, of_a.ravel()])

        def block(y: np.ndarray) -> np.ndarray:
            h = self.hyper_tangent
            if h is None:
                return self.solver(y)
            a = y[count:].reshape(shape)
            rows = y[:count].copy()
            rows[: self.nv] += together(h.E_t, a).ravel()
            increment = self.solver(rows)
            dv = increment[: self.nv].reshape(self.d, -1)
            da = together(h.solved, np.concatenate([dv, a], axis=1))
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
        residuals: list[float] = []
        y, _ = gmres(
            operator_of_scaled,
            start / scale,
            rtol=tolerance,
            restart=self.flow_iterations,
            maxiter=1,
            callback=residuals.append,
            callback_type="pr_norm",
        )
        self.iterations = len(residuals)
        y *= scale
        return y[:count], None if normals is None else y[count:].reshape(shape)

    def _blocks(self, count: int, size: int) -> list[slice]:
        """v, wall stress, creep rate and normal derivatives in the joint vector of the flow."""
        blocks = [self.unknowns.slices[name] for name in self.unknowns.flow]
        return blocks if count == size else [*blocks, slice(count, size)]

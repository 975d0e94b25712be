"""P^{-1} R: what the split solver takes for an increment of all unknowns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.sparse import mass_matrix, together
from ngvisco.forms.mesh_arrays import mask_of
from ngvisco.forms.operators import Operators
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.split.flow import FlowOperator
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.hyper_tangent import HyperTangent
from ngvisco.solver.split.linear import DirectSolver, TwoLevelSolver
from ngvisco.solver.split.reduced import Evaluation, ReducedResidual
from ngvisco.solver.split.sweep import Sweep
from ngvisco.solver.split.tangent import PointTangent
from ngvisco.solver.split.velocity_tangent import VelocityTangent


class Preconditioner:
    """Sweeps of the transport, the flow's linear system, and what z and rho take from the new velocity."""

    def __init__(self, residual: ReducedResidual, options: NewtonOptions) -> None:
        step, unknowns = residual.step, residual.unknowns
        self.unknowns = unknowns
        k, m = step.discretisation.k, step.discretisation.m
        self.op = Operators(step, max(k - 1, m))
        self.d = step.mesh.dim
        self.sweep = Sweep(residual, options.inverse)
        derivative = None if residual.hyper is None else HyperDerivative(residual.hyper)
        self.operator = FlowOperator(residual, PointTangent(residual, self.op), self.sweep, derivative)
        self.hyper_tangent = None if derivative is None else HyperTangent(derivative)
        self.tangent = VelocityTangent(self.operator, self.hyper_tangent)
        free = [mask_of(step.layout.blocks[name].FreeDofs()) for name in unknowns.flow]
        self.free = np.concatenate(free)
        self.solver: DirectSolver | TwoLevelSolver
        if self.free.sum() > options.split.direct_up_to[self.d - 2]:
            others = np.arange(len(self.free)) >= self.operator.nv
            vertices = ~others & (np.arange(len(self.free)) % residual.op.v.width < step.mesh.nv)
            self.solver = TwoLevelSolver(
                self.free, vertices, others, options.inverse, options.split.two_level
            )
        else:
            self.solver = DirectSolver(self.free, options.inverse, symmetric=unknowns.flow == ["v"])
        mass = mass_matrix(self.op.z.matrix, self.op.weights)
        self.project = BlockInverse(mass)
        self.project.update(mass)
        self.nv = self.operator.nv
        self.flow_iterations = options.split.flow_iterations
        self.iterations = 0
        """What the last linear system of the flow took."""

    def update(self, at: Evaluation, clock: Callable[[str], AbstractContextManager[None]]) -> None:
        """Form and factorise everything at an evaluation, which is that of the step's state.

        ``clock(name)`` measures the time of a part.
        """
        with clock("assembly"):
            self.operator.update(at)
            if self.hyper_tangent is not None:
                self.hyper_tangent.update()
            matrix = self.tangent.matrix()
        with clock("factorisation"):
            self.solver.factorise(matrix)

    def linearise(self, at: Evaluation, everything: bool) -> None:
        """Let the linear operator follow an evaluation, or what changes suddenly; the rest stays."""
        self.operator.update(at, everything)

    def __call__(self, at: Evaluation, tolerance: float) -> np.ndarray:
        """The increment, packed; ``tolerance`` is that of the flow's linear system."""
        op, d, operator, r, rho = self.op, self.d, self.operator, at.residual, at.coefficients["rho"]
        dz = self.sweep.fields(np.ascontiguousarray(r.z.T))
        flow = r.flow.copy()
        flow[: self.nv] -= operator.force(dz).ravel()
        dflow, da = self._flow(flow, r.normals, tolerance)
        dv = dflow[: self.nv].reshape(d, -1)
        dPi = None
        if "Pi" in self.unknowns.slices:
            dPi = op.creep_values(
                dflow[self.unknowns.slices["Pi"]].reshape(self.unknowns.components["Pi"], -1)
            )
        dz += operator.carried(dv, dPi)
        dv_q, L = op.v(dv), op.velocity_gradient(dv)
        drho = op.z(rho) * sum(L[i * (d + 1)] for i in range(d))
        drho += sum(D(rho) * dv_q[j] for j, D in enumerate(op.dz))
        density = r.density.copy()
        density[: rho.size] -= op.z.test(drho)
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

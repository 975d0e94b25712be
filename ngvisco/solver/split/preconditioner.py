"""P^{-1} R: what the split solver takes for an increment of all unknowns."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.algebra.factorised import DirectSolver, TwoLevelSolver
from ngvisco.algebra.sparse import together
from ngvisco.forms.mesh_arrays import mask_of
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.split.fields_system import FieldsSystem
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.hyper_tangent import HyperTangent
from ngvisco.solver.split.point_tangent import PointTangent
from ngvisco.solver.split.schur_complement import FlowSchurComplement
from ngvisco.solver.split.transport_sweeps import TransportSweeps
from ngvisco.solver.split.velocity_tangent import VelocityTangent


class Preconditioner:
    """The flow's linear system with the fields by sweeps of the transport, then the fields' own systems.

    The flow's unknowns are v, wall stress, creep rate and the facets' normal derivatives of v, one vector.
    """

    def __init__(self, residual: ReducedResidual, options: NewtonOptions) -> None:
        step, unknowns = residual.step, residual.unknowns
        self.unknowns, self.options, self.dim = unknowns, options.split, step.mesh.dim
        k, m = step.discretisation.k, step.discretisation.m
        self.op = Operators(step, max(k - 1, m))
        self.sweep = TransportSweeps(residual, options.inverse, self.options.sweeps)
        derivative = (
            None if residual.hyper is None else HyperDerivative(residual.hyper, self.options.penalty_degree)
        )
        tangent = PointTangent(residual, self.op)
        self.operator = FlowSchurComplement(
            residual, tangent, self.sweep, derivative, self.options.switch_share
        )
        self.hyper_tangent = None if derivative is None else HyperTangent(derivative)
        self.tangent = VelocityTangent(self.operator, self.hyper_tangent)
        free = [mask_of(step.layout.blocks[name].FreeDofs()) for name in unknowns.flow]
        self.free = np.concatenate(free)
        self.solver: DirectSolver | TwoLevelSolver
        if self.free.sum() > self.options.direct_up_to[self.dim - 2]:
            number = np.arange(len(self.free))
            others = number >= self.operator.nv
            vertices = ~others & (number % residual.op.v.width < step.mesh.nv)
            two_level = asdict(self.options.two_level)
            self.solver = TwoLevelSolver(self.free, vertices, others, options.inverse, **two_level)
        else:
            self.solver = DirectSolver(self.free, options.inverse, symmetric=unknowns.flow == ["v"])
        self._blocks = [unknowns.slices[name] for name in unknowns.flow]
        self._rows = self.free
        if residual.hyper is not None:
            normals = unknowns.normal_slice
            self._blocks.append(normals)
            free_normals = np.ones(normals.stop - normals.start, dtype=bool)
            self._rows = np.concatenate([self.free, free_normals])
        self.fields = FieldsSystem(self.operator, self.options.fields)
        self.iterations = 0
        """What the last linear system of the flow took."""

    def update(self, at: Evaluation, clock: Callable[[str], AbstractContextManager[None]]) -> None:
        """Form and factorise everything at an evaluation, which is that of the step's state.

        ``clock(name)`` measures the time of a part.
        """
        with clock("assembly"):
            self.linearise(at, everything=True)
            if self.hyper_tangent is not None:
                self.hyper_tangent.update()
            matrix = self.tangent.matrix()
        with clock("factorisation"):
            self.solver.factorise(matrix)

    def linearise(self, at: Evaluation, everything: bool) -> None:
        """Let the linear operator follow an evaluation, or what changes suddenly; the rest stays."""
        self.operator.update(at, everything)
        if everything:
            self.fields.renew()

    def __call__(self, at: Evaluation, tolerance: float) -> np.ndarray:
        """The increment, packed; ``tolerance`` is that of the flow's linear system."""
        op, operator, dim, size = self.op, self.operator, self.dim, self.operator.nv
        r, rho, u = at.residual, at.coefficients["rho"], self.unknowns
        dz = self.sweep.fields(np.ascontiguousarray(r.z.T))
        right = np.concatenate([r.flow, *([] if r.normals is None else [r.normals.ravel()])])
        right[:size] -= operator.force(dz).ravel()
        dflow = self._flow(right, tolerance)
        dv = dflow[:size].reshape(dim, -1)
        dPi = None
        if "Pi" in u.slices:
            dPi = op.creep_values(dflow[u.slices["Pi"]].reshape(u.components["Pi"], -1))
        dz = self.fields.z(np.ascontiguousarray(r.z.T) - operator.fields_rows(dv, dPi))
        dv_q, L = op.v(dv), op.velocity_gradient(dv)
        drho = op.z(rho) * sum(L[i * (dim + 1)] for i in range(dim))
        drho += sum(D(rho) * dv_q[j] for j, D in enumerate(op.dz))
        density = r.density.copy()
        density[: rho.size] -= op.z.test(drho)
        return np.concatenate([dflow, self.fields.density(density), dz.T.ravel()])

    def _flow(self, right: np.ndarray, tolerance: float) -> np.ndarray:
        """The flow's unknowns by its tangent with the hyperviscosity's own derivative, by GMRES."""
        start = self._block(np.where(self._rows, right, 0.0))
        # lengths in units of each block's first increment, so that stresses do not drown velocities
        scale = np.ones_like(start)
        for where in self._blocks:
            scale[where] = np.linalg.norm(start[where]) / np.sqrt(where.stop - where.start) or 1.0
        residuals: list[float] = []
        y, _ = gmres(
            LinearOperator(
                (len(start), len(start)), lambda y: self._block(self._applied(scale * y)) / scale, dtype=float
            ),
            start / scale,
            rtol=tolerance,
            restart=self.options.flow_iterations,
            maxiter=1,
            callback=residuals.append,
            callback_type="pr_norm",
        )
        self.iterations = len(residuals)
        return y * scale

    def _parts(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The unknowns of the tangent of v and, where there is a hyperviscosity, the normal derivatives."""
        count = len(self.free)
        normals = y[count:].reshape(self.dim, -1)
        return y[:count], None if self.hyper_tangent is None else normals

    def _applied(self, y: np.ndarray) -> np.ndarray:
        rows, of_a = self.operator(*self._parts(y))
        return np.where(self._rows, rows if of_a is None else np.concatenate([rows, of_a.ravel()]), 0.0)

    def _block(self, y: np.ndarray) -> np.ndarray:
        """The tangent of v solved, with the normal derivatives eliminated from it."""
        rows, a = self._parts(y)
        if self.hyper_tangent is None or a is None:
            return self.solver(rows)
        dim, size = self.dim, self.operator.nv
        rows = rows.copy()
        rows[:size] += together(self.hyper_tangent.E_t, a).ravel()
        increment = self.solver(rows)
        dv = increment[:size].reshape(dim, -1)
        da = together(self.hyper_tangent.solved, np.concatenate([dv, a], axis=1))
        return np.concatenate([increment, da.ravel()])

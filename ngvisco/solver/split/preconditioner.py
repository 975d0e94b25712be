"""P^{-1} R: what the split solver takes for an increment of all unknowns.

First the flow's linear system, with the fields by sweeps of the transport, then the linear equations of the
fields for a given velocity: transport, rates and creep together.  For an increment dz they are
T dz - (K dz, .) = rows, with the transport T (``TransportSweeps``) and the derivative K of rates and creep
(``PointTangent``); for drho the transport alone.  Sweeps, and (1 - tau K)^{-1} at every point after them,
invert these up to tau^2 (products of T and K) and what the sweeps leave: well for Courant numbers and strains
in a step below a half, and not at all where either is above one.  There they precondition GMRES: near walls
that start to move at once, one cell of the first step is enough.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial

import numpy as np

from ngvisco.algebra import precision
from ngvisco.algebra.factorised import Direct, Fallback, MakesDirect, TwoLevelSolver, direct_solver
from ngvisco.algebra.krylov import Map, gmres, improved
from ngvisco.errors import InputWarning
from ngvisco.forms.mesh.mesh_arrays import mask_of, rigid_motions
from ngvisco.parallel.petsc import SumInverse
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual, Residual
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.split.flow_operator import FlowSchurComplement
from ngvisco.solver.split.hyperviscosity import HyperDerivative, HyperTangent
from ngvisco.solver.split.point_tangent import PointTangent
from ngvisco.solver.split.transport import TransportSweeps

TOLERANCE, ITERATIONS = 0.05, 20
"""Of z's and rho's increments, by GMRES at most; 0.1 takes an iteration of Newton more in twenty, 0.01 no
fewer."""
ENOUGH, ENOUGH_WHERE_STEEP = 0.15, 0.05
"""Share of the right side that sweeps alone may leave, without GMRES: Newton's iteration then contracts by
as much.  In a smooth run with creep 0.05 takes as many iterations as 0.15 and a tenth more time.  Steep are
local rules of creep that are not linear: there 0.05 takes fewer iterations, and fewer operators, which are
made anew where an increment is above a tenth of the one before."""
_LINEAR = 1e-3
"""Tolerance of the flow's linear systems down to which directions are in single precision."""
_IN_WORDS = {"wall_stress": "stresses of oblique or curved walls", "Pi": "a creep rate field"}


class FieldsSystem:
    """Solves the fields' equations where the operator was last updated."""

    def __init__(self, operator: FlowSchurComplement, enough: float) -> None:
        """``enough`` is what sweeps may leave of an increment."""
        self.operator, self.sweep, self.enough = operator, operator.sweep, enough
        self.iterations = ITERATIONS
        self.points, self.op = operator.points, operator.points.op
        self._swept_is_enough: set[str] = set()
        """Fields for which one application of the approximate inverse did, at this operator."""

    def renew(self) -> None:
        """Whether sweeps are enough is to be seen again."""
        self._swept_is_enough.clear()

    def z(self, rows: np.ndarray, tolerance: float) -> np.ndarray:
        """Increments of z, of rows: both (cells' unknowns, n)."""
        return self._solved("z", self.rows, self._approximate, rows, tolerance)

    def density(self, rows: np.ndarray, tolerance: float) -> np.ndarray:
        """Increments of the density's unknowns, of rows."""
        sweep = self.sweep
        if sweep.density_is_factorised:
            return sweep.density(rows)
        return self._solved("rho", sweep.density_rows, sweep.density, rows[:, None], tolerance)[:, 0]

    def _solved(
        self, name: str, apply: Map, approximate: Map, rows: np.ndarray, tolerance: float
    ) -> np.ndarray:
        if name in self._swept_is_enough and tolerance >= TOLERANCE:
            return approximate(rows)
        enough = self.enough if tolerance >= TOLERANCE else 0.0
        products = self.operator.residual.ranks.products
        found, iterations = improved(apply, approximate, rows, tolerance, self.iterations, enough, products)
        if not iterations:
            self._swept_is_enough.add(name)
        return found

    def _approximate(self, rows: np.ndarray) -> np.ndarray:
        return self.operator.resolved(self.sweep.fields(rows))

    def rows(self, dz: np.ndarray) -> np.ndarray:
        """Of increments of z, both (cells' unknowns, n)."""
        return self.sweep.rows(dz) - self.points.fields_rows(dz)


class Preconditioner:
    """The flow's linear system with the fields by sweeps of the transport, then the fields' own systems.

    The flow's unknowns are v, wall stress, creep rate and the facets' normal derivatives of v, one vector.
    """

    def __init__(self, residual: ReducedResidual, options: NewtonOptions) -> None:
        step, unknowns = residual.step, residual.unknowns
        self.unknowns, self.options, self.dim = unknowns, options.split, step.mesh.dim
        self._coarse = options.coarse
        self.without_multigrid: str | None = None
        """Why vertices are factorised where the options have a multigrid for them."""
        k, m = step.discretisation.k, step.discretisation.m
        thick = step.model.viscosity
        bends = thick is not None and not thick.is_linear
        # a coarse rule misses where a viscosity is steep, and how moduli of bodies vary within a cell:
        # increments of a slab then shrink by 0.99 only
        varies = len(step.model.bodies) > 1
        # on triangles one of degree 2, k - 1, misses convection, where no hyperviscosity holds: at a Courant
        # number of 0.2 a step takes 16 iterations and seven operators in place of 9 and one
        least = k if self.dim == 2 and residual.hyper is None else k - 1
        self.op = residual.op if bends or varies else Operators(step, max(least, m))
        self.sweep = TransportSweeps(residual)
        derivative = (
            None if residual.hyper is None else HyperDerivative(residual.hyper, self.options.penalty_degree)
        )
        tangent = PointTangent(residual, self.op)
        self.operator = FlowSchurComplement(residual, tangent, self.sweep, derivative)
        self.ranks, self.exchange = residual.ranks, residual.shared_rows
        places, kept = np.arange(unknowns.flow_slice.stop), np.zeros(0, dtype=np.int64)
        self.hyper_tangent: HyperTangent | None = None
        if derivative is not None:
            normals = unknowns.normal_slice.stop - unknowns.normal_slice.start
            of_a = (places.size + np.arange(normals)).reshape(self.dim, -1)
            kept = self.exchange.part(of_a[0]).places
            places = np.concatenate([places, of_a[:, kept].ravel()])
            self.hyper_tangent = HyperTangent(derivative, kept)
        self._of_tangent = self.exchange.part(places)
        """The exchange of the tangent's unknowns: the flow's and, between ranks, the normal derivatives."""
        free = [mask_of(step.layout.blocks[name].FreeDofs()) for name in unknowns.flow]
        self.free = np.concatenate(free)
        self._whole: Callable[[], Direct] | None = None
        """Makes a factorisation of the tangent as a whole, where two levels are in its place."""
        self._two_levels: Direct | None = None
        self.solver = self._solver(np.concatenate([self.free, np.ones(self.dim * len(kept), dtype=bool)]))
        self._blocks = [unknowns.slices[name] for name in unknowns.flow]
        self._held = np.flatnonzero(~self.free)
        if residual.hyper is not None:
            self._blocks.append(unknowns.normal_slice)
        self._lengths = [self.exchange.length(where) for where in self._blocks]
        self._of_velocity = self.exchange.part(np.arange(residual.op.v.width))
        self._relaxes = tangent.nodes is not None
        self.fields = FieldsSystem(self.operator, ENOUGH_WHERE_STEEP if step.stresses else ENOUGH)
        self.iterations = 0
        """What the last linear system of the flow took."""

    def _solver(self, free: np.ndarray) -> Direct:
        """A solver for the velocity tangent with these free unknowns."""
        exchange, operator = self._of_tangent, self.operator
        direct: MakesDirect = partial(direct_solver, exchange=exchange)
        number = np.arange(len(free))
        is_velocity = number < operator.nv
        count = int(self.ranks.total(int((free & exchange.owned)[: operator.size].sum())))
        if count <= (largest := self.options.direct_up_to[self.dim - 2]):
            self.without_multigrid = f"up to {largest} unknowns of v are factorised as a whole, here {count}"
            return direct(free, symmetric=self.unknowns.flow == ["v"])
        if count <= self.options.direct_at_most[self.dim - 2]:
            self._whole = partial(direct, free, symmetric=self.unknowns.flow == ["v"])
        others = (number >= operator.nv) & (number < operator.size)
        vertices = is_velocity & (number % operator.op.v.width < operator.residual.step.mesh.nv)
        if self.ranks.any(others.any()):
            known = " and ".join(_IN_WORDS.get(name, name) for name in self.unknowns.flow if name != "v")
            self.without_multigrid = f"with {known} beside v the matrix is not positive definite"
        elif self._coarse != "direct":
            kernel = rigid_motions(operator.residual.step.mesh, operator.op.v.width, len(free))
            multigrid = partial(SumInverse, exchange=exchange, method=self._coarse, kernel=kernel)
            direct = partial(Fallback, multigrid, direct, self._say)
        return TwoLevelSolver(free, vertices, others, direct, exchange)

    def strengthen(self) -> bool:
        """Let the tangent be factorised as a whole from the next ``update`` on, if it is not and may be."""
        if self._whole is None or self._two_levels is not None:
            return False
        self._two_levels, self.solver = self.solver, self._whole()
        self._two_levels.release()
        return True

    def relax(self) -> bool:
        """Two levels again, from the next ``update`` on; whether there was something else."""
        if self._two_levels is None:
            return False
        self.solver.release()
        self.solver, self._two_levels = self._two_levels, None
        return True

    def _say(self, reason: str) -> None:
        message = f"coarse = {self._coarse!r}: {reason}; the velocities of the vertices are factorised"
        self.ranks.warn(message, InputWarning)

    def update(self, at: Evaluation, clock: Callable[[str], AbstractContextManager[None]]) -> None:
        """Form and factorise everything at an evaluation, which is that of the step's state.

        ``clock(name)`` measures the time of a part.
        """
        with clock("assembly"):
            self.linearise(at, everything=True)
            if self.hyper_tangent is not None:
                with self.ranks.together(np.linalg.LinAlgError):
                    self.hyper_tangent.update()
            matrix = self.operator.tangent(self.hyper_tangent)
        with clock("factorisation"):
            self.solver.factorise(matrix)

    def linearise(self, at: Evaluation, everything: bool) -> None:
        """Let the linear operator follow an evaluation, or what changes suddenly; the rest stays."""
        self.operator.update(at, everything)
        if everything:
            self.fields.renew()

    def __call__(self, at: Evaluation, tolerance: float, of_fields: float = TOLERANCE) -> np.ndarray:
        """The increment, packed; tolerances are those of the flow's linear system and of the fields' own."""
        op, operator, dim, size = self.op, self.operator, self.dim, self.operator.nv
        r, u, alone = at.residual, self.unknowns, None
        if self._relaxes:
            alone, r = self._relaxed(r)
            at = replace(at, residual=r)
        dflow = self._flow(self._rows_of_flow(at), tolerance)
        dv = dflow[:size].reshape(dim, size // dim)
        dPi = None
        if "Pi" in u.slices:
            dPi = op.of("Pi")[0](dflow[u.slices["Pi"]].reshape(u.components["Pi"], -1))
        dz = self.fields.z(np.ascontiguousarray(r.z.T) - operator.fields_rows(dv, dPi), of_fields)
        dz = dz if alone is None else dz + alone
        if not u.density:
            return np.concatenate([dflow, dz.T.ravel()])
        rho, dv_q, L = at.coefficients["rho"], op.v(dv), op.velocity_gradient(dv)
        drho = op.z(rho) * sum(L[i * (dim + 1)] for i in range(dim))
        drho += sum(D(rho) * dv_q[j] for j, D in enumerate(op.dz))
        density = r.density.copy()
        density[: rho.size] -= op.z.test(drho)
        return np.concatenate([dflow, self.fields.density(density, of_fields), dz.T.ravel()])

    def _relaxed(self, r: Residual) -> tuple[np.ndarray, Residual]:
        """What a cell does by itself of an increment of z, and what it leaves of the equations.

        What a steep flow rule takes from a stress that is off it is of the size of its slope: it is not to
        be carried to other cells by the transport before it is relaxed.
        """
        operator, points = self.operator, self.operator.points
        alone = points.tau * operator.residual.inverse_mass(r.z)
        dz = operator.resolved(np.ascontiguousarray(alone.T))
        of_z = r.z.T - self.fields.rows(dz)
        flow = r.flow.copy()
        flow[: operator.nv] -= self._of_velocity.sum(operator.force_of(dz)).ravel()
        flow[self._held] = 0.0
        return dz, replace(r, flow=flow, z=np.ascontiguousarray(of_z.T))

    def _rows_of_flow(self, at: Evaluation) -> np.ndarray:
        """What is left of the flow's and the normal derivatives' equations where the fields follow."""
        r, size = at.residual, self.operator.nv
        dz = self.sweep.fields(np.ascontiguousarray(r.z.T))
        rows = np.concatenate([r.flow, *([] if r.normals is None else [r.normals.ravel()])])
        rows[:size] -= self._of_velocity.sum(self.operator.force(dz)).ravel()
        rows[self._held] = 0.0
        return rows

    def _flow(self, right: np.ndarray, tolerance: float) -> np.ndarray:
        """The flow's unknowns by its tangent with the hyperviscosity's own derivative, by GMRES."""
        start = self._block(right)
        # lengths in units of each block's first increment, so that stresses do not drown velocities
        scale = np.ones_like(start)
        for where, length in zip(self._blocks, self._lengths, strict=True):
            scale[where] = self.exchange.norm(start, where) / np.sqrt(length) or 1.0
        # single precision does not hold directions apart down to the tolerances of a linear map
        kind = precision.SINGLE if tolerance > _LINEAR else np.float64
        y, self.iterations = gmres(
            lambda y: self._block(self._applied(scale * y)) / scale,
            (start / scale).astype(kind),
            rtol=tolerance,
            directions=self.options.flow_iterations,
            products=self.exchange.products,
        )
        # sums of directions may have other last bits on each rank, and a resumed run has the owner's
        return self.exchange.of_owners(y * scale)

    def _parts(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The unknowns of the tangent of v and, where there is a hyperviscosity, the normal derivatives."""
        count = len(self.free)
        normals = y[count:].reshape(self.dim, -1)
        return y[:count], None if self.hyper_tangent is None else normals

    def _applied(self, y: np.ndarray) -> np.ndarray:
        rows, of_a = self.operator(*self._parts(y))
        if of_a is not None:
            rows = np.concatenate([rows, of_a.ravel()])
        rows = self.exchange.sum(rows)
        rows[self._held] = 0.0
        return rows

    def _block(self, y: np.ndarray) -> np.ndarray:
        """The tangent of v solved, with the normal derivatives eliminated from it but between ranks."""
        rows, a = self._parts(y)
        if self.hyper_tangent is None or a is None:
            return self.solver(rows)
        tangent, dim, size = self.hyper_tangent, self.dim, self.operator.nv
        kept, others = a[:, tangent.kept], a[:, tangent.eliminated]
        rows = np.concatenate([rows, kept.ravel()])
        of_others = tangent.E_t(others)[:, : size // dim]
        rows[:size] += self._of_velocity.sum(of_others).ravel()
        increment = self.solver(rows)
        flow, kept = increment[: len(self.free)], increment[len(self.free) :].reshape(kept.shape)
        da = np.empty_like(a)
        da[:, tangent.kept] = kept
        beside = np.concatenate([flow[:size].reshape(dim, size // dim), kept], axis=1)
        da[:, tangent.eliminated] = tangent.of_velocity(beside) + tangent.of_rows(others)
        return np.concatenate([flow, da.ravel()])

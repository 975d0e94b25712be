"""Computes P^{-1} R, the split solver's increment of all unknowns.

First P^{-1} solves the flow's linear system, in which sweeps of the transport give the fields.  Then P^{-1}
solves the fields' linear equations with the increment of the velocity. The equations for dz are T dz - (K dz,
.) = rows, with the transport T (``TransportSweeps``) and the derivative K of rates and creep
(``PointTangent``); the equation for drho has no K. The inverse of T - K is approximated by sweeps, followed
by (1 - tau K)^{-1} in every cell. The errors are tau^2 times products of T and K, and the sweeps' remainder.
Sweeps are accurate if the Courant number and the strain of a step are below a half. If Courant number or
strain is above one, even in a single cell, as at a wall that starts to move at once, sweeps diverge. They
then serve only as a preconditioner of GMRES.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.factorised import Direct, TwoLevelSolver, direct_solver
from ngvisco.algebra.krylov import Operator, gmres
from ngvisco.algebra.sparse import apply, widened
from ngvisco.errors import InputWarning, StepError
from ngvisco.forms.mesh.mesh_arrays import mask_of, rigid_motions
from ngvisco.parallel.petsc import SumInverse
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.split.flow_operator import FlowSchurComplement
from ngvisco.solver.split.hyperviscosity import HyperDerivative, HyperTangent, hyper_matrix
from ngvisco.solver.split.point_tangent import PointTangent
from ngvisco.solver.split.transport import TransportSweeps

TOLERANCE, ITERATIONS = 0.05, 20
"""Tolerance of the increments of z and rho, and the largest number of their GMRES iterations."""
ENOUGH, ENOUGH_WHERE_STEEP = 0.15, 0.05
"""Largest relative residual with which sweeps are accepted without GMRES; Newton's iteration contracts by
about the same factor. The second value is for steep flow rules, which are local and not linear."""
_LINEAR = 1e-3
"""Tolerance of the flow's linear system above which GMRES directions are in single precision."""
JOINED = 4_000
"""Largest number of unknowns (v, a) in 2D with which the tangent has the hyperviscosity's whole derivative,
and is factorised with the normal derivatives a as unknowns."""
_IN_WORDS = {"wall_stress": "stresses of oblique or curved walls", "Pi": "a creep rate field"}


class FieldsSystem:
    """Solves the fields' linear equations, linearised at the last update of the operator."""

    def __init__(self, operator: FlowSchurComplement, enough: float) -> None:
        """``enough`` is the relative residual that sweeps alone may leave."""
        self.operator, self.sweep, self.enough = operator, operator.sweep, enough
        self.iterations = ITERATIONS
        self._swept_is_enough: set[Operator] = set()
        """Approximate inverses that one application has shown to be accurate enough, since the last update of
        the operator."""

    def renew(self) -> None:
        """Let the next solution of each system test anew whether sweeps suffice."""
        self._swept_is_enough.clear()

    def z(self, rows: np.ndarray, tolerance: float) -> np.ndarray:
        """Increments of z from rows of z, both (cells' unknowns, n)."""
        return self._solved(self.rows, self.approximate, rows, tolerance)

    def density(self, rows: np.ndarray, tolerance: float) -> np.ndarray:
        """Increments of the density's unknowns from their rows."""
        sweep = self.sweep
        if sweep.of_rho is None:
            return sweep.density(rows)
        return self._solved(sweep.of_rho, sweep.density, rows[:, None], tolerance)[:, 0]

    def _solved(self, matrix: Operator, swept: Operator, rows: np.ndarray, tolerance: float) -> np.ndarray:
        """Solve matrix(x) = rows up to ``tolerance``, with the swept inverse as preconditioner.

        The preconditioned residual is measured column by column, relative to the start value's column,
        because columns may have different units.
        """
        enough = self.enough if tolerance >= TOLERANCE else 0.0
        if enough and swept in self._swept_is_enough:
            return swept(rows)
        products = self.operator.residual.ranks.products

        def squares(columns: np.ndarray) -> np.ndarray:
            return products((columns * columns).T, np.ones(len(columns)))

        def mapped(x: np.ndarray) -> np.ndarray:
            return (swept(matrix(scale * x.reshape(start.shape))) / scale).ravel()

        start = swept(rows).astype(float)  # squares may exceed single precision
        scale = np.sqrt(squares(start))
        scale[scale == 0] = 1.0
        remaining = swept(rows - matrix(start)).astype(float) / scale
        size = float(np.sqrt(squares(remaining).sum()))
        if not max(tolerance, enough) < size < np.inf:  # the residual is small enough, or not finite
            self._swept_is_enough.add(swept)
            return start
        most = self.iterations
        x, _ = gmres(mapped, remaining.ravel(), rtol=tolerance / size, directions=most, products=products)
        return start + scale * x.reshape(start.shape)

    def approximate(self, rows: np.ndarray) -> np.ndarray:
        """Increments of z by sweeps of the transport, then by the resolvent of rates and creep in each
        cell."""
        return self.operator.points.resolved(self.sweep.fields(rows))

    def rows(self, dz: np.ndarray) -> np.ndarray:
        """Rows of z from increments of z, both (cells' unknowns, n)."""
        return self.sweep.rows(dz) - self.operator.points.fields_rows(dz)


class Preconditioner:
    """Solves the flow's linear system, in which sweeps of the transport give the fields, and then the fields'
    linear equations.

    One vector holds the flow's unknowns: v, wall stress, creep rate and the facets' normal derivatives of v.
    """

    def __init__(self, residual: ReducedResidual, options: NewtonOptions) -> None:
        step, unknowns, hyper = residual.step, residual.unknowns, residual.hyper
        self.unknowns, self.options, self.dim = unknowns, options.split, step.mesh.dim
        self._coarse = options.coarse
        self.without_multigrid: str | None = None
        """The reason why the vertices are factorised although the options ask for a multigrid."""
        k, m = step.discretisation.k, step.discretisation.m
        thick = step.model.viscosity
        bends = thick is not None and not thick.is_linear
        # on a coarse rule the increments of a slab would shrink only by the factor 0.99: the rule misses a
        # steep viscosity, and moduli of bodies that vary within a cell
        varies = len(step.model.bodies) > 1
        # on triangles and without hyperviscosity, a rule of degree 2 (k - 1) misses a part of convection: at
        # a Courant number of 0.2 a step takes 16 iterations and seven operators instead of 9 and one
        least = k if self.dim == 2 and hyper is None else k - 1
        self.op = residual.op if bends or varies else Operators(step, max(least, m), residual.op)
        self.sweep = TransportSweeps(residual)
        derivative = None if hyper is None else HyperDerivative(hyper, self.options.penalty_degree)
        tangent = PointTangent(residual, self.op)
        self._relaxes = tangent.collocated is not None
        self.operator = FlowSchurComplement(residual, tangent, self.sweep, derivative)
        self.fields = FieldsSystem(self.operator, ENOUGH_WHERE_STEEP if step.stresses else ENOUGH)
        self.ranks, count = residual.ranks, self.operator.size
        self._size = unknowns.density_slice.start if unknowns.density else unknowns.slices["z"].start
        """Number of the flow's unknowns with the normal derivatives; these come first among all unknowns."""
        self.exchange = residual.exchange.part(np.arange(self._size))
        self._of_velocity = self.exchange.part(np.arange(self.op.v.width))
        places = np.arange(count)
        self.hyper_tangent: HyperTangent | None = None
        self._hyper_matrix: Callable[[], sp.csr_matrix] | None = None
        """The hyperviscosity's part of a tangent of (v, a), on small meshes in place of ``hyper_tangent``."""
        names, is_alone = unknowns.velocity_block, not self.exchange.is_distributed
        is_small = self.dim == 2 and self._size <= JOINED and count <= self.options.direct_up_to[0]
        if derivative is not None and is_small and is_alone and names == ["v"]:
            self._hyper_matrix, places = hyper_matrix(derivative, count), np.arange(self._size)
            names = [*names, *unknowns.normals]
        elif derivative is not None:
            normals = np.arange(count, self._size).reshape(self.dim, -1)
            kept = self.exchange.part(normals[0]).places
            places = np.concatenate([places, normals[:, kept].ravel()])
            self.hyper_tangent = HyperTangent(derivative, kept)
        self._of_tangent = self.exchange.part(places)
        """Exchanges the tangent's unknowns: the flow's unknowns, and the normal derivatives on facets between
        ranks, or on all facets of a small mesh."""
        self.free = np.concatenate([mask_of(step.layout.blocks[name].FreeDofs()) for name in names])
        self._held = np.flatnonzero(~self.free)
        self._whole: Callable[[], Direct] | None = None
        """Makes a solver that factorises the whole tangent in place of two levels.

        It is None if the solver has no two levels, or if the unknowns are too many for a factorisation.
        """
        self._two_levels: Direct | None = None
        self.solver = self._solver(np.append(self.free, np.ones(len(places) - len(self.free), dtype=bool)))
        self._blocks = [unknowns.slices[name] for name in unknowns.velocity_block]
        if hyper is not None:
            self._blocks.append(unknowns.normal_slice)
        self._lengths = [self.exchange.length(where) for where in self._blocks]
        self.iterations = 0
        """Number of iterations of the flow's last linear system."""

    def _solver(self, free: np.ndarray) -> Direct:
        """Make a solver for the velocity tangent restricted to the unknowns ``free``."""
        exchange, operator, number = self._of_tangent, self.operator, np.arange(len(free))
        count = int(self.ranks.total(int((free & exchange.owned)[: operator.size].sum())))
        # two levels do not solve the flow's systems of bodies whose viscosities differ by 1e6
        jumps, options = self.dim == 2 and len(operator.residual.step.model.bodies) > 1, self.options
        whole = partial(direct_solver, free, exchange, self.unknowns.velocity_block == ["v"])
        largest = (options.direct_at_most if jumps else options.direct_up_to)[self.dim - 2]
        if count <= largest:
            self.without_multigrid = (
                f"the {count} unknowns of v are factorised as a whole, like all systems of up to {largest} "
                "unknowns"
            )
            return whole()
        if count <= options.direct_at_most[self.dim - 2]:
            self._whole = whole
        mesh, width = operator.residual.step.mesh, operator.op.v.width
        beside_v = (number >= operator.nv) & (number < operator.size)
        vertices = (number < operator.nv) & (number % width < mesh.nv)
        if self.ranks.any(beside_v.any()):
            others = " and ".join(_IN_WORDS.get(name, name) for name in self.unknowns.velocity_block[1:])
            self.without_multigrid = f"the matrix with {others} in addition to v is not positive definite"
        self._multigrid = self._coarse != "direct" and self.without_multigrid is None
        self._kernel = rigid_motions(mesh, width, len(free)) if self._multigrid else None
        return TwoLevelSolver(free, vertices, beside_v, self._factorised, exchange)

    def _factorised(self, free: np.ndarray, matrix: sp.csr_matrix, symmetric: bool) -> Direct:
        """The solver for the vertices. It is a multigrid if the options ask for one and the matrix allows it;
        else it is a factorisation."""
        solver: Direct
        if self._multigrid:
            solver = SumInverse(free, self._of_tangent, symmetric, self._coarse, self._kernel)
            try:
                solver.factorise(matrix)
                return solver
            except StepError as error:
                solver.release()
                how = (
                    f"coarse = {self._coarse!r} is not used ({error}); a direct solver factorises the matrix "
                    "of the vertices instead"
                )
                self.ranks.warn(how, InputWarning)
        solver = direct_solver(free, self._of_tangent, symmetric)
        solver.factorise(matrix)
        return solver

    def strengthen(self) -> bool:
        """Factorise the whole tangent from the next ``update`` on; return whether this is a change."""
        if self._whole is None or self._two_levels is not None:
            return False
        self._two_levels, self.solver = self.solver, self._whole()
        self._two_levels.release()
        return True

    def relax(self) -> bool:
        """Return to two levels from the next ``update`` on; return whether this is a change."""
        if self._two_levels is None:
            return False
        self.solver.release()
        self.solver, self._two_levels = self._two_levels, None
        return True

    def update(self, at: Evaluation) -> None:
        """Form operator and tangent at an evaluation, whose unknowns have to be the step's state."""
        self.linearise(at, everything=True)
        self.solver.forget()  # frees memory before the next tangent takes memory
        # two levels without PETSc work in single precision, all other solvers in double precision
        rounds = isinstance(self.solver, TwoLevelSolver) and not self.exchange.is_distributed
        kind = precision.SINGLE if rounds and not self._multigrid else np.float64
        matrix = self.operator.tangent(at, self.hyper_tangent, kind)
        if self._hyper_matrix is not None:
            matrix = widened(matrix, self._size, self._size) + self._hyper_matrix()
        self.solver.factorise(matrix)

    def linearise(self, at: Evaluation, everything: bool) -> None:
        """Linearise the operator at an evaluation.

        If ``everything`` is False, only the hyperviscosity and a nonlinear density equation are linearised.
        """
        self.operator.update(at, everything)
        if everything:
            self.fields.renew()

    def __call__(self, at: Evaluation, tolerance: float, of_fields: float = TOLERANCE) -> np.ndarray:
        """The packed increment of all unknowns. ``tolerance`` belongs to the flow's system, ``of_fields`` to
        the fields' systems."""
        op, operator, dim, u = self.op, self.operator, self.dim, self.unknowns
        of_z = np.ascontiguousarray(at.residual[u.slices["z"]].reshape(u.components["z"], -1).T)
        flow, alone = at.residual[: self._size].copy(), None
        if self._relaxes:
            # with a steep flow rule, residuals of stresses are as large as the slope of the rule: each cell
            # relaxes its own residual before the transport carries the rest to other cells
            alone = operator.points.tau * apply(operator.residual.inverse_mass, of_z.T)
            alone = operator.points.resolved(np.ascontiguousarray(alone.T))
            of_z = of_z - self.fields.rows(alone)
            flow[: operator.nv] -= self._of_velocity.sum(operator.force_of(alone)).ravel()
        flow[: operator.nv] -= self._of_velocity.sum(operator.force(self.sweep.fields(of_z))).ravel()
        flow[self._held] = 0.0
        dflow = self._flow(flow, tolerance)
        dv, dPi = dflow[: operator.nv].reshape(dim, -1), None
        if "Pi" in u.slices:
            dPi = op.of("Pi")(dflow[u.slices["Pi"]].reshape(u.components["Pi"], -1))
        dz = self.fields.z(of_z - operator.fields_rows(dv, dPi), of_fields)
        if alone is not None:
            dz = dz + alone
        if not u.density:
            return np.concatenate([dflow, dz.T.ravel()])
        rho = at.coefficients["rho"]
        drho = op.z(rho) * sum(D(dv_j) for D, dv_j in zip(op.slopes("v"), dv, strict=True))
        drho += sum(D(rho) * op.v(dv_j) for D, dv_j in zip(op.slopes("z"), dv, strict=True))
        density = at.residual[u.density_slice].copy()
        density[: rho.size] -= op.z.test(drho)
        return np.concatenate([dflow, self.fields.density(density, of_fields), dz.T.ravel()])

    def _flow(self, right: np.ndarray, tolerance: float) -> np.ndarray:
        """Solve the flow's system by GMRES, preconditioned with the tangent."""
        start = self._block(right)
        # each block is scaled by its first increment, so that stresses do not dominate velocities
        scale = np.ones_like(start)
        for where, length in zip(self._blocks, self._lengths, strict=True):
            scale[where] = self.exchange.norm(start, where) / np.sqrt(length) or 1.0
        # a linear problem has a small tolerance; single precision then does not keep directions orthogonal
        kind = precision.SINGLE if tolerance > _LINEAR else np.float64
        y, self.iterations = gmres(
            lambda y: self._block(self._applied(scale * y)) / scale,
            (start / scale).astype(kind),
            rtol=tolerance,
            directions=self.options.flow_iterations,
            products=self.exchange.products,
        )
        # ranks may differ in the last bits of a sum, and a checkpoint stores the owner's value
        return self.exchange.of_owners(y * scale)

    def _applied(self, y: np.ndarray) -> np.ndarray:
        rows = self.exchange.sum(self.operator(y))
        rows[self._held] = 0.0
        return rows

    def _block(self, y: np.ndarray) -> np.ndarray:
        """Apply the inverse of the velocity tangent to rows ``y`` of the flow and of the normal derivatives.

        With ``hyper_tangent``, only the normal derivatives on facets between ranks are unknowns of the
        tangent. All others follow from the velocity and their own rows.
        """
        tangent, dim, (rows, a) = self.hyper_tangent, self.dim, np.split(y, [len(self.free)])
        if tangent is None:
            return self.solver(y)
        a, size, result = a.reshape(dim, -1), self.operator.nv, np.empty_like(y)
        kept, eliminated = a[:, tangent.kept], a[:, tangent.eliminated]
        rows = np.append(rows, kept)
        rows[:size] += self._of_velocity.sum(tangent.E_t(eliminated)[:, : size // dim]).ravel()
        flow, increment = np.split(self.solver(rows), [len(self.free)])
        kept, da = increment.reshape(kept.shape), result[len(flow) :].reshape(a.shape)
        result[: len(flow)], da[:, tangent.kept] = flow, kept
        beside = np.concatenate([flow[:size].reshape(dim, size // dim), kept], axis=1)
        da[:, tangent.eliminated] = tangent.of_velocity(beside) + tangent.of_rows(eliminated)
        return result

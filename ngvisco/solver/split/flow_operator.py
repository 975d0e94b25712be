"""The flow's linear operator: dR/d(v, wall stress, Pi, a) with the fields carried along, and its derivatives.

An increment of v changes z by rate(z; grad dv) - (dv . grad) z, carried by the transport within the step
(``TransportSweeps``), and dz the elastic force: what remains of Newton's matrix when z is eliminated.

At a point (``PointTangent``) the fields follow an increment X = (grad dv, dPi), neither convected nor carried
through facets, as

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep + terms of z)/dz,

and with the elastic force zeta : rate(z; X) that makes the point's stiffness
C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX), not symmetric where there is stress or
creep.  What is integrated at the nodes (``Quadrature.nodes``), as nonlinear creep, has its part of K there.

Element matrices are of a coarse rule, but for inertia: a rule that does not see all of P_k
makes it singular.  They are of v, from v to the fields' rows, and back from the fields to v: a product of the
operator is three small dense products a cell, whatever the number of points.  In a cell, v's increment is
ordered by components and functions, (dim, local), its rows by functions and components, (local, dim), the
fields by functions and components, (q, n): orders in which the matrices come out of their products.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.sparse import ElementAssembly, widened
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.reduced.evaluation import CellTerms, derivative_of, incremented
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual, RestrictedForm
from ngvisco.reduced.slope import PointwiseSlope
from ngvisco.solver.split.hyperviscosity import HyperDerivative, HyperTangent
from ngvisco.solver.split.transport import TransportSweeps


class _AtPoints:
    """Values, phi'' and K at the points of one rule, at an evaluation."""

    rate_slope: np.ndarray
    """K, (points, n, n)."""

    def __init__(self, residual: ReducedResidual, terms: CellTerms, asked: list[PointTerm]) -> None:
        """``asked`` are the terms whose rows of z, and stresses, change with z."""
        self.residual, self.terms, self.op, self._asked = residual, terms, terms.op, asked
        self.components = residual.step.layout.states.size
        self.slope = PointwiseSlope(residual.step, self.op.points)
        z = self.op.z
        functions = z.blocks.swapaxes(1, 2)
        tests = functions * self.op.weights.reshape(z.cells, 1, z.per_cell)
        of_values = np.linalg.solve(tests @ z.blocks, tests)  # (cells, q, points)
        by_points = of_values[:, :, None] * functions[:, None]
        self._projecting = by_points.reshape(z.cells, z.local**2, z.per_cell)
        """Coefficients of products of values at the points and the cells' functions, (cells, q q, points)."""

    def _take(self, at: Evaluation) -> None:
        """The values there and phi'', (points, n, n)."""
        self.tau = self.residual.step.context.tau.Get()
        self.values = u = self.terms.fields(at.coefficients)
        self.z, self.zeta = u.z.value, u.zeta.value
        self.curvature = np.ascontiguousarray(self.slope.hessian(self.z).transpose(2, 0, 1))

    def _slopes(self) -> Iterator[tuple[slice, dict[str, np.ndarray]]]:
        """Derivatives of the asked terms' slots, and of creep, by some components of z, which zeta follows by
        phi''."""
        first, zeta = 0, self.curvature.transpose(2, 1, 0)
        for k, changed in incremented(self.values, z=np.eye(self.components)[:, :, None], zeta=zeta):
            some, first = slice(first, first + k), first + k
            yield some, {name: derivative_of(g, k) for name, g in self._read(changed).items()}

    def _read(self, u: Fields) -> dict[str, np.ndarray]:
        return self.terms.slots(self._asked, u)

    def tested(self) -> np.ndarray:
        """tau P K of the cells' coefficients, (cells, q q, n n)."""
        z, n = self.op.z, self.components
        values = (self.tau * self.rate_slope).reshape(z.cells, z.per_cell, n * n)
        kind = np.float64 if abs(values).max(initial=0.0) > 1 else precision.SINGLE
        return self._projecting.astype(kind) @ values.astype(kind)

    def rows(self, dz: np.ndarray) -> np.ndarray:
        """(K dz, .) of coefficients dz, both (cells' unknowns, n)."""
        values = self.op.z(np.ascontiguousarray(dz.T))
        return self.op.z.test(at_points(self.rate_slope, values)).T


class NodeTangent(_AtPoints):
    """The same at the nodes: of what is integrated by as many points as z has values in a cell."""

    def __init__(self, residual: ReducedResidual, terms: CellTerms) -> None:
        super().__init__(residual, terms, residual.claims.of_nodes())

    def update(self, at: Evaluation) -> None:
        """Form K, along the slopes of the flow rules at their stresses, which are made anew."""
        self.residual.step.stresses.linearise()
        self._take(at)
        self.rate_slope = np.zeros((self.op.points.count, self.components, self.components))
        for some, found in self._slopes():
            self.rate_slope[:, :, some] -= found["z"].transpose(2, 0, 1)

    def follow(self, dz: np.ndarray, length: float) -> None:
        """Let the flow rules' stresses follow ``length`` times an increment of z, coefficients (n, .)."""
        values = self.op.z(dz)
        self.residual.step.stresses.follow_fields(values, at_points(self.curvature, values), length)


class PointTangent(_AtPoints):
    """The same at the points of the coarse rule, and what both make of an increment in a cell."""

    def __init__(self, residual: ReducedResidual, operators: Operators) -> None:
        terms = CellTerms(residual.step, operators, residual.rates)
        super().__init__(residual, terms, residual.claims.of_state())
        self.nodes = None if residual.node_terms is None else NodeTangent(residual, residual.node_terms)
        rates = residual.rates
        self._creeps = bool(rates.flows) and rates.is_local and not rates.creeps_at_nodes

    def _read(self, u: Fields) -> dict[str, np.ndarray]:
        creep = {"creep": self.residual.rates.creep_components(u)} if self._creeps else {}
        return creep | super()._read(u)

    def update(self, at: Evaluation) -> None:
        """Form K's resolvent, d rate/dX and the force's derivative."""
        self._take(at)
        self.dz, radius = self.values.grad_z.value, self.values.layout.symmetry.radius
        self.radius = None if radius is None else self.values.context.given(radius).value
        """r of a body of revolution, (points,)."""
        self.columns = self.residual.rates.columns(self.z)  # (points, n, X)
        self.rate_slope, self.force = self._by_fields(self.values)
        if self.nodes is not None:
            self.nodes.update(at)
        self.resolvent = self._resolvent()

    def _by_fields(self, u: Fields) -> tuple[np.ndarray, np.ndarray]:
        """K, (points, n, n), and the force's derivative, (points, X, n); zeta follows z by phi''.

        Rates are constant tensors; creep and terms that read z or zeta are by complex increments of these.
        -(w . grad z) : zeta, with its share of the facets, is div w times phi'(z) : dz to leading order, and
        so is what densities have in their flux.
        """
        rates = self.residual.rates
        g, plane = rates.tensors.gradients, rates.dim**2
        X = np.zeros((self.columns.shape[2], self.z.shape[1]))
        X[:g] = rates.entries_of_L(u)
        if rates.flows and not rates.creeps_at_nodes:
            X[g:] = rates.creep_components(u)
        K, force = (each.transpose(2, 0, 1) for each in rates.slopes(self.z, X, self.zeta))
        force = force + np.matmul(self.columns.swapaxes(1, 2), self.curvature)
        force[:, rates.tensors.trace] += self.zeta.T[:, None]
        if not (self._asked or self._creeps):
            return np.ascontiguousarray(K), force
        K, of_creep = K.copy(), self.columns[:, :, g:]
        for some, found in self._slopes():
            if "creep" in found:
                K[:, :, some] += np.matmul(of_creep, found["creep"].transpose(2, 0, 1))
            if "z" in found:
                K[:, :, some] -= found["z"].transpose(2, 0, 1)
            if "grad v" in found:
                stress = found["grad v"]
                force[:, :plane, some] += stress.reshape(plane, *stress.shape[2:]).transpose(2, 0, 1)
            if self.radius is not None and "v" in found:
                force[:, plane, some] += (self.radius * found["v"][0]).T
        return K, force

    def fields_rows(self, dz: np.ndarray) -> np.ndarray:
        """(K dz, .) with what the nodes have of it."""
        return self.rows(dz) if self.nodes is None else self.rows(dz) + self.nodes.rows(dz)

    def stiffness(self) -> np.ndarray:
        """C of the module's docstring, (points, X, X)."""
        resolvent = np.linalg.inv(np.eye(self.components) - self.tau * self.rate_slope)
        return self.tau * self.force @ (resolvent @ self.columns)

    def _resolvent(self) -> np.ndarray:
        """(1 - tau P K)^{-1} of the cells' coefficients, (cells, q n, q n), P the projection to their space.

        Not of values at points: where some points of a cell yield and others do not, tau K is large at some.
        """
        z, n = self.op.z, self.components
        tested = self.tested() if self.nodes is None else self.tested() + self.nodes.tested()
        matrix = tested.reshape(z.cells, z.local, z.local, n, n).transpose(0, 1, 3, 2, 4)
        return _resolvents(matrix.reshape(z.cells, z.local * n, z.local * n))


def at_points(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrices (points, i, j) times values (j, points): (i, points)."""
    return np.ascontiguousarray(np.matmul(matrices, values.T[:, :, None])[:, :, 0].T)


def _resolvents(matrices: np.ndarray) -> np.ndarray:
    """(1 - N)^{-1} of stacked matrices N: (1 + N)(1 + N^2)(1 + N^4) ... where they are small.

    Products take a fifth of the time of factorisations; what they leave is below 1e-4.
    """

    def size(matrices: np.ndarray) -> float:
        return float(abs(matrices).sum(axis=2).max(initial=0.0))

    one = np.eye(matrices.shape[1])
    if not size(matrices) < 0.5:
        return np.linalg.inv(one - matrices)
    power = precision.single(matrices)
    result = power + one.astype(precision.SINGLE)
    while size(power) ** 2 > 1e-4:
        power = np.matmul(power, power)
        result += np.matmul(result, power)
    return result


class FlowSchurComplement:
    """The operator at the evaluation of the last ``update``, in element matrices.

    Attributes
    ----------
    own : array, (cells, local dim, dim local)
        Rows of v from v.
    to_fields : array, (cells, q n, dim local)
        Rows of the fields from v.
    from_fields : array, (cells, local dim, q n)
        Rows of v from what the transport makes of the fields' rows.
    """

    def __init__(
        self,
        residual: ReducedResidual,
        points: PointTangent,
        sweep: TransportSweeps,
        derivative: HyperDerivative | None,
    ) -> None:
        self.residual, self.points, self.sweep, self.derivative = residual, points, sweep, derivative
        u, self.op = residual.unknowns, points.op
        op, self.dim, self.components = self.op, residual.step.mesh.dim, points.components
        self.gradients = residual.rates.tensors.gradients
        """How many entries of grad v the fields follow."""
        self.nv, self.size = u.slices["v"].stop, u.flow_slice.stop
        """How many unknowns v has, and the flow, without the normal derivatives."""
        self.others: RestrictedForm | None = None
        if others := residual.claims.beside_the_points():
            self.others = RestrictedForm(residual.step, u.flow, others)
        self.leading, self.inertial = residual.claims.of_gradients(), residual.claims.of_inertia()
        self._assembled = ElementAssembly(op.v.unknowns, op.v.width)
        self.cells, per, self.local, self.functions = op.v.cells, op.v.per_cell, op.v.local, op.z.local
        # of a periodic strip of one cell, which has an unknown twice, by blocks that are filled up with zeros
        shapes = np.stack([each.blocks.reshape(-1, self.local) for each in (op.v, *op.dv)], axis=1)
        self._shapes = shapes.astype(precision.SINGLE)  # (points, 1 + d, local)
        tests = shapes * op.weights[:, None, None]
        tests = tests.reshape(self.cells, per * (1 + self.dim), self.local)
        self._tests = precision.single(tests.transpose(0, 2, 1))  # (cells, local, points (1 + d))
        z_tests = op.z.blocks * op.weights.reshape(self.cells, per, 1)
        self._z_tests = precision.single(z_tests.transpose(0, 2, 1))  # (cells, q, points)
        self._scatter = op.v.scatter.astype(precision.SINGLE)
        rows, of_fields = self.local * self.dim, self.functions * self.components
        self._of_velocity = np.empty((self.cells, rows + of_fields, rows), precision.SINGLE)
        """Rows of both, one after the other: what an increment of v makes is one product."""
        self.own, self.to_fields = self._of_velocity[:, :rows], self._of_velocity[:, rows:]

    def update(self, at: Evaluation, everything: bool = True) -> None:
        """Linearise at an evaluation.

        Without ``everything`` only hyperviscosity and a density equation that is not linear.
        """
        self.sweep.linearise()
        if self.derivative is not None and at.hyper is not None:
            self.derivative.update(at.hyper)
        if not everything:
            return
        self.points.terms.context.start()
        with self.residual.ranks.together(np.linalg.LinAlgError):
            self.sweep.update(at)
            self.points.update(at)
        self.form_elements(self._base(), self._inertia(at))
        self.rest = self._rest()

    def form_elements(self, base: np.ndarray, inertia: np.ndarray) -> None:
        """``base`` is dR/d(v, grad v) without the fields, (points, 0 or 1 + j, i, k, 0 or 1 + l).

        ``inertia`` are the coefficients of w . dv at the points of the residual's rule, (points,).
        """
        cells, d, n, local, q = self.cells, self.dim, self.components, self.local, self.functions
        p, count = self.points, len(base)
        right = np.matmul(precision.single(base).reshape(count, (1 + d) * d**2, 1 + d), self._shapes)
        own = np.matmul(self._tests, right.reshape(cells, self.op.v.per_cell * (1 + d), d * d * local))
        own = own.reshape(cells, local, d, d, local)
        shapes, weights = self.residual.op.v.blocks, inertia * self.residual.op.weights
        mass = np.matmul(shapes.transpose(0, 2, 1), weights.reshape(*shapes.shape[:2], 1) * shapes)
        for i in range(d):
            own[:, :, i, i] += mass
        self.own[...] = own.reshape(cells, local * d, d * local)
        # z's rows from (v, grad v): - rate(z; grad dv) + (dv . grad) z
        to_z = np.empty((count, n, d, 1 + d), precision.SINGLE)
        to_z[..., 0] = p.dz.transpose(2, 0, 1)
        to_z[..., 1:] = -p.columns[:, :, : d * d].reshape(count, n, d, d)
        if p.radius is not None:
            to_z[:, :, 0, 0] -= p.columns[:, :, d * d] / p.radius[:, None]
        right = np.matmul(to_z.reshape(count, n * d, 1 + d), self._shapes)
        to_fields = np.matmul(self._z_tests, right.reshape(cells, self.op.v.per_cell, n * d * local))
        self.to_fields[...] = to_fields.reshape(cells, q * n, d * local)
        # v's rows from z: the elastic force of (1 - tau P K)^{-1} dz
        force = precision.single(p.force[:, : d * d]).reshape(count, d, d, n).swapaxes(1, 2)
        shapes = self._shapes[:, 1:]
        if p.radius is not None:
            of_values = np.zeros((count, 1, d, n), precision.SINGLE)
            of_values[:, 0, 0] = p.force[:, d * d] / p.radius[:, None]
            force, shapes = np.concatenate([of_values, force], axis=1), self._shapes
        left = np.matmul(shapes.transpose(0, 2, 1), force.reshape(count, shapes.shape[1], d * n))
        back = np.matmul(self._z_tests, left.reshape(cells, self.op.v.per_cell, local * d * n))
        back = back.reshape(cells, q, local * d, n).transpose(0, 2, 1, 3).reshape(cells, local * d, q * n)
        self.from_fields = np.matmul(precision.single(back), precision.single(p.resolvent))

    def _inertia(self, at: Evaluation) -> np.ndarray:
        """What multiplies w . dv by inertia, (points of the residual's rule,)."""
        along = np.eye(self.dim)[:1, :, None]
        return self.residual.cell_terms.derivatives(self.inertial, at.cells, v=along)["v"][0, 0]

    def _base(self) -> np.ndarray:
        """dR/d(v, grad v) of convection and viscosity: (points, 0 or 1 + j, i, k, 0 or 1 + l)."""
        d, p = self.dim, self.points
        along = np.eye(d * (1 + d)).reshape(-1, d, 1 + d, 1)
        slots = p.terms.derivatives(self.leading, p.values, v=along[:, :, 0], grad_v=along[:, :, 1:])
        A = np.empty((self.op.points.count, 1 + d, d, d * (1 + d)))
        A[:, 0] = slots["v"].transpose(2, 0, 1)
        A[:, 1:] = slots["grad v"].transpose(3, 1, 0, 2)
        return A.reshape(-1, 1 + d, d, d, 1 + d)

    def _rest(self) -> sp.csr_matrix | None:
        """Walls, damping, the creep rate field and terms of others, as a matrix."""
        rest = None if self.others is None else self.others.jacobian()
        if "Pi" not in self.residual.unknowns.flow:
            return rest
        # what M takes from a creep rate field Pi within the step, coupling to v left out
        first, values = self.gradients, self.op.of("Pi")[0].matrix
        C = self.points.stiffness()[:, first:, first:] * self.op.weights[:, None, None]
        size = C.shape[1]
        blocks = [[values.T @ sp.diags(C[:, i, k]) @ values for k in range(size)] for i in range(size)]
        creep = sp.bmat(blocks)
        before = sp.csr_matrix((self.size - creep.shape[0],) * 2)
        creep = sp.block_diag([before, creep], format="csr")
        return creep if rest is None else (rest + creep).tocsr()

    def __call__(self, flow: np.ndarray) -> np.ndarray:
        """Rows of the flow's unknowns and of a, of an increment of these; over ranks in parts."""
        dv, result = flow[: self.nv].reshape(self.dim, -1), np.zeros(len(flow))
        if self.rest is not None:
            result[: self.size] = self.rest @ flow[: self.size]
        if self.derivative is None:
            result[: self.nv] += self._with_fields(dv).ravel()
            return result
        x, hyper = np.concatenate([dv, flow[self.size :].reshape(self.dim, -1)], axis=1), self.derivative
        rows, of_x = self._with_fields(dv), hyper(x)
        rows += of_x[:, : dv.shape[1]]
        result[: self.nv] += rows.ravel()
        result[self.size :] = of_x[:, dv.shape[1] :].ravel()
        return result

    def _gathered(self, dv: np.ndarray) -> np.ndarray:
        """The cells' unknowns of dv (dim, .), (cells, dim local, 1)."""
        local = np.take(precision.single(dv.T), self.op.v.unknowns, axis=0)
        return np.ascontiguousarray(local.swapaxes(1, 2)).reshape(self.cells, self.dim * self.local, 1)

    def _scattered(self, rows: np.ndarray) -> np.ndarray:
        """Sums over the cells of their rows (cells, local dim, 1), (dim, .)."""
        return (self._scatter @ rows.reshape(self.cells * self.local, self.dim)).T

    def _with_fields(self, dv: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), without hyperviscosity, with the fields carried along."""
        rows, own = np.matmul(self._of_velocity, self._gathered(dv)), self.dim * self.local
        carried = self.sweep.fields(-rows[:, own:].reshape(-1, self.components))
        of_cells = np.ascontiguousarray(rows[:, :own])
        of_cells += np.matmul(self.from_fields, carried.reshape(self.cells, self.from_fields.shape[2], 1))
        return self._scattered(of_cells)

    def force(self, dz: np.ndarray) -> np.ndarray:
        """Rows of v in parts, (dim, .), of what sweeps make of the fields' rows, (cells' unknowns, n)."""
        fields = dz.reshape(self.cells, self.from_fields.shape[2], 1)
        return self._scattered(np.matmul(self.from_fields, fields))

    def force_of(self, dz: np.ndarray) -> np.ndarray:
        """Rows of v in parts, (dim, .), of an increment of z, (cells' unknowns, n), in double precision."""
        op, p, d = self.op, self.points, self.dim
        plane = d * d
        values = at_points(p.force[:, : self.gradients], op.z(np.ascontiguousarray(dz.T)))
        rows = np.sum([D.test(values[:plane][j::d]) for j, D in enumerate(op.dv)], axis=0)
        if p.radius is not None:
            rows[:1] += op.v.test(values[plane:] / p.radius)
        return rows

    def fields_rows(self, dv: np.ndarray, dPi: np.ndarray | None) -> np.ndarray:
        """What the rows of z, (cells' unknowns, n), take from an increment of v (dim, .) and Pi."""
        rows = np.matmul(self.to_fields, self._gathered(dv)).reshape(-1, self.components)
        if dPi is not None:
            values = at_points(self.points.columns[:, :, self.gradients :], dPi)
            rows -= self.op.z.test(values).T
        return rows

    def resolved(self, dz: np.ndarray) -> np.ndarray:
        """(1 - tau P K)^{-1} dz of coefficients dz: both (cells' unknowns, n)."""
        cells = dz.reshape(*self.points.resolvent.shape[:2], 1)  # of a rank without cells too
        return np.matmul(self.points.resolvent, cells).reshape(dz.shape)

    def tangent(self, hyper: HyperTangent | None) -> sp.csr_matrix:
        """The velocity tangent: the operator with the fields predicted inside each cell, as a matrix.

        What a cell's increments change its fields by takes the inverse of the transport's own block, without
        what neighbours carry over: a sum over the cells.  Of the flow's unknowns and the normal derivatives
        that ``hyper`` keeps, last; the others are a = E v, with the mean of both sides' d_n v, weighted by
        the hyperviscosity's coefficient.  Over ranks in parts.
        """
        d, local = self.dim, self.local
        rows = self.to_fields.reshape(self.cells * self.functions, self.components * d * local)
        fields = self.sweep.in_cells(rows).reshape(self.to_fields.shape)
        cells = (self.own - self.from_fields @ fields).reshape(self.cells, local, d, d, local)
        blocks = [[self._assembled(cells[:, :, i, k]) for k in range(d)] for i in range(d)]
        if hyper is not None:
            n = self.op.v.width
            for i in range(d):
                blocks[i][i] = blocks[i][i] + hyper.matrix[:n, :n]
        matrix = widened(sp.bmat(blocks, format="csr"), self.size, self.size)
        if self.rest is not None:
            matrix = (matrix + self.rest).tocsr()
        return matrix if hyper is None or not len(hyper.kept) else hyper.bordered(matrix, d)

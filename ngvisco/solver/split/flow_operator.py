"""The flow's linear operator dR/d(v, wall stress, Pi, a), with the fields z eliminated.

An increment dv changes the rows of z by rate(z; grad dv) - (dv . grad) z. The transport within the step
carries this change (``TransportSweeps``), and the resulting dz changes the elastic force. The operator is the
Schur complement of Newton's matrix when z is eliminated. ``ngvisco.solver.split.point_tangent`` has the
fields' response to an increment at a point.

Element matrices are integrated by a coarse rule. The mass matrix is an exception: it would be singular by a
rule that does not determine all of P_k.  Each cell has three element matrices: from v to rows of v, from v to
rows of the fields, and from the fields to rows of v.  A product with the operator therefore takes three small
dense products a cell, whatever the number of points.  The order of unknowns in a cell follows from the
products that form the matrices.  An increment of v is ordered by components and then functions, (dim, local).
Rows of v, (local, dim), and fields, (q, n), are ordered by functions and then components.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.sparse import ElementAssembly, beside, stacked
from ngvisco.forms.upwinding import beyond_trace
from ngvisco.reduced.evaluation import CellTerms
from ngvisco.reduced.residual import CellPart, Evaluation, ReducedResidual
from ngvisco.reduced.restricted_form import RestrictedForm
from ngvisco.solver.split.hyperviscosity import HyperDerivative, HyperTangent
from ngvisco.solver.split.point_tangent import PointTangent, PointValues, at_points, radius_of
from ngvisco.solver.split.transport import TransportSweeps


class FlowSchurComplement:
    """The flow's linear operator, linearised at the evaluation of the last ``update``, as element matrices.

    ``to_velocity`` maps v to rows of v, (cells, local dim, dim local), and ``to_fields`` maps v to rows of
    the fields, (cells, q n, dim local). ``from_fields`` maps the fields' increments by the transport alone to
    rows of v, (cells, local dim, q n).
    """

    def __init__(
        self,
        residual: ReducedResidual,
        points: PointTangent,
        sweep: TransportSweeps,
        derivative: HyperDerivative | None,
    ) -> None:
        self.residual, self.points, self.sweep, self.derivative = residual, points, sweep, derivative
        self.has_interfaces = len(residual.step.model.bodies) > 1
        u, self.op = residual.unknowns, points.op
        op, self.dim, self.components = self.op, residual.step.mesh.dim, points.components
        self.nv, self.size = u.slices["v"].stop, u.flow_slice.stop
        """Number of unknowns of v, and number of the flow's unknowns without the normal derivatives a."""
        self.gradients = residual.rates.tensors.gradients
        """Number of entries of grad v on which the fields' rates depend."""
        self.by_forms: RestrictedForm | None = None
        if terms := residual.couplings.beside_the_points():
            self.by_forms = RestrictedForm(residual.step, u.velocity_block, terms)
        self.leading, self.inertial = residual.couplings.of_gradients(), residual.couplings.of_inertia()
        self._assembled = ElementAssembly(op.v.unknowns, op.v.width)
        self.cells, self.local, self.functions = op.v.cells, op.v.local, op.z.local
        # in a periodic strip of one cell, two local unknowns of a cell are the same: zeros fill up the blocks
        shapes = np.stack([part.blocks.reshape(-1, self.local) for part in (op.v, *op.slopes("v"))], axis=1)
        self._shapes = shapes.astype(precision.SINGLE)  # (points, 1 + d, local)
        self._scatter = op.v.scatter.astype(precision.SINGLE)
        rows, of_fields = self.local * self.dim, self.functions * self.components
        self._of_velocity = np.empty((self.cells, rows + of_fields, rows), precision.SINGLE)
        """The rows of ``to_velocity`` and below them the rows of ``to_fields``, so that one product gives
        both."""
        self.to_velocity, self.to_fields = self._of_velocity[:, :rows], self._of_velocity[:, rows:]
        self.from_fields = np.empty((self.cells, rows, of_fields), precision.SINGLE)

    def update(self, at: Evaluation, everything: bool = True) -> None:
        """Linearise at an evaluation.

        Unless ``everything``, only the hyperviscosity and a nonlinear density equation are linearised.
        """
        self.sweep.linearise()
        if self.derivative is not None and at.hyper is not None:
            self.derivative.update(at.hyper)
        if not everything:
            return
        self.points.terms.context.sampled.start()
        with self.residual.ranks.together(np.linalg.LinAlgError):
            self.sweep.update(at)
            self.points.begin(at)
            self.residual.share(lambda part: self._form(part, at), self.points.parts)
        self.rest = self._rest()

    def _form(self, part: tuple[slice, CellTerms, CellPart], at: Evaluation) -> None:
        """Form the element matrices of some cells. The inertia is integrated by the residual's rule, all
        other parts by the coarse rule."""
        where, terms, fine = part
        p = self.points.update(where, terms, at)
        d, n, local, q, per = self.dim, self.components, self.local, self.functions, self.op.v.per_cell
        cells, op = where.stop - where.start, p.terms.op
        count, shapes = cells * per, self._shapes[op.places]
        tests = shapes * precision.single(op.weights)[:, None, None]
        tests = tests.reshape(cells, per * (1 + d), local).transpose(0, 2, 1)
        z_tests = precision.single(op.z.blocks * op.weights.reshape(cells, per, 1)).transpose(0, 2, 1)
        base = precision.single(self._base(p)).reshape(count, (1 + d) * d**2, 1 + d)
        blocks = np.matmul(tests, np.matmul(base, shapes).reshape(cells, per * (1 + d), d * d * local))
        blocks = blocks.reshape(cells, local, d, d, local)
        mass = self._mass(fine, at)
        for i in range(d):
            blocks[:, :, i, i] += mass
        self.to_velocity[where] = blocks.reshape(cells, local * d, d * local)
        # from (v, grad v) to rows of z: - rate(z; grad dv) + (dv . grad) z
        to_z = np.empty((count, n, d, 1 + d), precision.SINGLE)
        to_z[..., 0] = p.fields.grad_z.value.transpose(2, 0, 1)
        to_z[..., 1:] = -p.columns[:, :, : d * d].reshape(count, n, d, d)
        if (radius := radius_of(p.fields)) is not None:
            to_z[:, :, 0, 0] -= p.columns[:, :, d * d] / radius[:, None]
        right = np.matmul(to_z.reshape(count, n * d, 1 + d), shapes)
        to_fields = np.matmul(z_tests, right.reshape(cells, per, n * d * local))
        to_fields = to_fields.reshape(cells, q * n, d, local)
        if self.has_interfaces:
            # only interfaces of bodies need this part: jumps within one body are small, and there the
            # upstream sides change while the iterate is far from the solution
            through = self._through_sides(fine, at)
            to_fields[..., : through.shape[3]] += through  # basis functions inside the cell come last
        self.to_fields[where] = to_fields.reshape(cells, q * n, d * local)
        # from z to rows of v: the elastic force of (1 - tau P K)^{-1} dz
        force = precision.single(p.force[:, : d * d]).reshape(count, d, d, n).swapaxes(1, 2)
        slopes = shapes[:, 1:]
        if radius is not None or "v" in p.beside:
            of_values = np.zeros((count, 1, d, n), precision.SINGLE)
            if "v" in p.beside:
                of_values[:, 0] = p.beside["v"]
            if radius is not None:
                of_values[:, 0, 0] += p.force[:, d * d] / radius[:, None]
            force, slopes = np.concatenate([of_values, force], axis=1), shapes
        left = np.matmul(slopes.transpose(0, 2, 1), force.reshape(count, slopes.shape[1], d * n))
        back = np.matmul(z_tests, left.reshape(cells, per, local * d * n))
        back = back.reshape(cells, q, local * d, n)
        for of_z, of_mean in self.points.of_means(p):  # means over cells add a dependence of rows of v on z
            size = of_z.shape[1]
            tested = shapes[:, 0, :, None, None] * (of_mean * op.weights[:, None, None])[:, None]
            rows = tested.reshape(cells, per, local * d, size).sum(axis=1)
            means = np.matmul(z_tests, of_z.reshape(cells, per, size * n)).reshape(cells, q, size, n)
            means /= op.weights.reshape(cells, per).sum(axis=1)[:, None, None, None]
            back = back + precision.single(np.matmul(rows[:, None], means))
        p.resolvent.astype(precision.SINGLE).after(precision.single(back), self.from_fields[where])

    def _through_sides(self, part: CellPart, at: Evaluation) -> np.ndarray:
        """The map from v on the cells' sides to rows of the fields, (cells, q n, dim, functions).

        B_h and upwinding carry (|v . n| - v . n) (z - z_hat) into a cell, whether a field is a density or
        not."""
        sides, u, cells = part.sides.op, part.sides.fields(at.coefficients), part.cells
        count, q, n, per = cells.stop - cells.start, self.functions, self.components, sides.z.per_cell
        flow = (sides.normals * u.v.value).sum(axis=0)
        inflow = sides.weights * sides.crossed * (np.sign(flow) - 1.0)
        jumps = beyond_trace(u).value.reshape(n, count, per).swapaxes(0, 1)
        tests = sides.z.blocks.swapaxes(1, 2)  # (cells, q, points)
        tests = precision.single(tests[:, :, None] * jumps[:, None]).reshape(count, q * n, per)
        along = (inflow * sides.normals).T.reshape(count, per, self.dim, 1) * sides.v.blocks[:, :, None]
        functions = sides.v.local
        result = np.matmul(tests, precision.single(along).reshape(count, per, self.dim * functions))
        return result.reshape(count, q * n, self.dim, functions)

    def _mass(self, part: CellPart, at: Evaluation) -> np.ndarray:
        """The mass matrix of one component of v, (cells, local, local)."""
        along, inside = np.eye(self.dim)[:1, :, None], part.inside
        u, blocks = inside.fields(at.coefficients), inside.op.v.blocks
        inertia = inside.derivatives(self.inertial, u, v=along)["v"][0, 0] * inside.op.weights
        return np.matmul(blocks.transpose(0, 2, 1), inertia.reshape(*blocks.shape[:2], 1) * blocks)

    def _base(self, p: PointValues) -> np.ndarray:
        """dR/d(v, grad v) of convection and viscosity: (points, 0 or 1 + j, i, k, 0 or 1 + l)."""
        d = self.dim
        along = np.eye(d * (1 + d)).reshape(-1, d, 1 + d, 1)
        factors = p.terms.derivatives(self.leading, p.fields, v=along[:, :, 0], grad_v=along[:, :, 1:])
        A = np.empty((len(p.columns), 1 + d, d, d * (1 + d)))
        A[:, 0] = factors["v"].transpose(2, 0, 1)
        A[:, 1:] = factors["grad v"].transpose(3, 1, 0, 2)
        return A.reshape(-1, 1 + d, d, d, 1 + d)

    def _rest(self) -> sp.csr_matrix | None:
        """The matrix of walls, damping, the creep rate field and users' terms."""
        matrix = None if self.by_forms is None else self.by_forms.jacobian()
        if "Pi" not in self.residual.unknowns.velocity_block:
            return matrix
        # the change of M by an increment of a creep rate field Pi; this matrix omits its coupling to v
        first, values = self.gradients, self.op.of("Pi").matrix
        C = self.points.stiffness()[:, first:, first:] * self.op.weights[:, None, None]
        size = C.shape[1]
        blocks = [[values.T @ sp.diags(C[:, i, k]) @ values for k in range(size)] for i in range(size)]
        creep = sp.bmat(blocks)
        creep = sp.block_diag([sp.csr_matrix((self.size - creep.shape[0],) * 2), creep], format="csr")
        return creep if matrix is None else (matrix + creep).tocsr()

    def __call__(self, flow: np.ndarray) -> np.ndarray:
        """Rows of the flow's unknowns and of the normal derivatives a from an increment ``flow`` of both.
        On each rank the rows are sums over that rank's cells."""
        dv, result = flow[: self.nv].reshape(self.dim, -1), np.zeros(len(flow))
        if self.rest is not None:
            result[: self.size] = self.rest @ flow[: self.size]
        if self.derivative is None:
            result[: self.nv] += self._with_fields(dv).ravel()
            return result
        x, hyper = np.concatenate([dv, flow[self.size :].reshape(self.dim, -1)], axis=1), self.derivative
        # only this thread may sum over ranks, and it calls the first function, the response of the fields
        rows, of_x = self.residual.at_once(lambda: self._with_fields(dv), lambda: hyper(x))
        rows += of_x[:, : dv.shape[1]]
        result[: self.nv] += rows.ravel()
        result[self.size :] = of_x[:, dv.shape[1] :].ravel()
        return result

    def _gathered(self, dv: np.ndarray) -> np.ndarray:
        """Gather dv, (dim, .), into the cells' unknowns, (cells, dim local, 1)."""
        local = np.take(precision.single(dv.T), self.op.v.unknowns, axis=0)
        return np.ascontiguousarray(local.swapaxes(1, 2)).reshape(self.cells, self.dim * self.local, 1)

    def _scattered(self, rows: np.ndarray) -> np.ndarray:
        """Sum the cells' rows, (cells, local dim, 1), into rows of v, (dim, .)."""
        return (self._scatter @ rows.reshape(self.cells * self.local, self.dim)).T

    def _with_fields(self, dv: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), from an increment of v. The rows contain the fields' response, and omit the
        hyperviscosity."""
        rows, height = np.matmul(self._of_velocity, self._gathered(dv)), self.dim * self.local
        carried = self.sweep.fields(-rows[:, height:].reshape(-1, self.components))
        of_cells = np.ascontiguousarray(rows[:, :height])
        of_cells += np.matmul(self.from_fields, carried.reshape(self.cells, self.from_fields.shape[2], 1))
        return self._scattered(of_cells)

    def force(self, dz: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), from the fields' increment by the transport alone, (cells' unknowns, n).

        On each rank the rows are sums over that rank's cells."""
        fields = dz.reshape(self.cells, self.from_fields.shape[2], 1)
        return self._scattered(np.matmul(self.from_fields, fields))

    def force_of(self, dz: np.ndarray) -> np.ndarray:
        """Rows of v, (dim, .), from the fields' whole increment, (cells' unknowns, n), in double precision.

        On each rank the rows are sums over that rank's cells."""
        op, p, d, plane = self.op, self.points, self.dim, self.dim**2
        assert p.force is not None
        values_of_z = op.z(np.ascontiguousarray(dz.T))
        values = at_points(p.force[:, : self.gradients], values_of_z)
        rows = np.sum([D.test(values[:plane][j::d]) for j, D in enumerate(op.slopes("v"))], axis=0)
        if p.weight is not None:
            rows += op.v.test(at_points(p.weight, values_of_z))
        if (radius := radius_of(p.terms.fields({}))) is not None:
            rows[:1] += op.v.test(values[plane:] / radius)
        return rows

    def fields_rows(self, dv: np.ndarray, dPi: np.ndarray | None) -> np.ndarray:
        """The change of the rows of z, (cells' unknowns, n), by increments of v, (dim, .), and of Pi."""
        rows = np.matmul(self.to_fields, self._gathered(dv)).reshape(-1, self.components)
        if dPi is not None and self.points.columns is not None:
            rows -= self.op.z.test(at_points(self.points.columns[:, :, self.gradients :], dPi)).T
        return rows

    def _rows_of(self, hyper_tangent: sp.csr_matrix | None, i: int, dtype: type) -> sp.csr_matrix:
        """Rows of component i of v: the sum of the element matrices and one component's hyperviscosity."""
        cells, n = self._in_cells(i), self.op.v.width
        blocks = [self._assembled(cells[:, :, k]) for k in range(self.dim)]
        del cells
        if hyper_tangent is not None:
            blocks[i] = blocks[i] + hyper_tangent[:n, :n]
        return beside(blocks, dtype)

    def _in_cells(self, i: int) -> np.ndarray:
        """Rows of component i of v in the tangent's element matrices without hyperviscosity, (cells, local,
        dim, local)."""
        d, local = self.dim, self.local
        cells = np.empty((self.cells, local, d, local), precision.SINGLE)
        for part in self.residual.parts:
            where, count = part.cells, part.cells.stop - part.cells.start
            fields = self.sweep.in_cells(self.to_fields[where], where)
            of_v, of_z = (
                matrix[where].reshape(count, local, d, matrix.shape[2])[:, :, i]
                for matrix in (self.to_velocity, self.from_fields)
            )
            cells[where] = (of_v - of_z @ fields).reshape(count, local, d, local)
        return cells

    def tangent(self, at: Evaluation, hyper: HyperTangent | None, dtype: type = np.float64) -> sp.csr_matrix:
        """The velocity tangent: a sparse matrix that approximates the operator, cell by cell.

        ``at`` is the evaluation of the last ``update``.  Each cell's own block replaces the transport, and
        the neighbours' contribution is left out, so that the tangent is a sum over the cells.  The tangent's
        unknowns are the flow's unknowns, followed by the normal derivatives that ``hyper`` keeps.  All other
        normal derivatives are a = E v: the mean of both sides' d_n v, weighted by the hyperviscosity's
        coefficient.  On each rank the sum is over that rank's cells.  If v is the only unknown with rows,
        entries have the precision ``dtype``.
        """
        d, hyper_tangent = self.dim, None
        if hyper is not None and at.hyper is not None:
            with self.residual.ranks.together(np.linalg.LinAlgError):
                hyper_tangent = hyper.update(at.hyper)
        matrix = stacked([self._rows_of(hyper_tangent, i, dtype) for i in range(d)])
        matrix.resize((self.size, self.size))
        if self.rest is not None:
            matrix = (matrix + self.rest).tocsr()
        return matrix if hyper is None or not len(hyper.kept) else hyper.bordered(matrix, hyper_tangent, d)

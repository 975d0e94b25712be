"""Computes the response of a cell's fields to an increment of X = (grad dv, dPi).

Without convection and fluxes through facets the fields follow

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep + terms of z)/dz.

With the elastic force zeta : rate(z; X) a point has the stiffness

    C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX),

which stress or creep make nonsymmetric.  Some terms, as nonlinear creep, are integrated by the collocated
rule (``Quadrature.collocated``). These terms contribute to K at the points of this rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ngvisco.algebra import precision
from ngvisco.algebra.resolvent import Resolvent, resolvents
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.arrays import Array
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.reduced.evaluation import CellTerms
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.point_fields import TOGETHER, derivative_of, incremented, repeated, repeated_along
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.reduced.slope import PointwiseSlope

_ENTRIES = 800_000
"""Largest number of entries of phi'', and of K, at the points of one part. Arrays of this size stay in the
processor's cache."""


class _AtPoints:
    """Computes phi'' and K at the points of one rule, at an evaluation."""

    tau: float
    rate_slope: np.ndarray
    """K, (points, n, n)."""

    def __init__(self, residual: ReducedResidual, terms: CellTerms, asked: list[PointTerm]) -> None:
        """``asked`` are the terms whose stresses or rows of z depend on z."""
        self.residual, self.terms, self.op, self._asked = residual, terms, terms.op, asked
        self.components = residual.step.layout.states.size
        self.slope = PointwiseSlope(residual.step, self.op.points)
        self._projection = self.op.projection()

    def _curvature(self, u: Fields) -> np.ndarray:
        """phi'', (points, n, n)."""
        return np.ascontiguousarray(self.slope.hessian(u.z.value).transpose(2, 0, 1))

    def _slopes(
        self, read: Callable[[Fields, int], dict[str, np.ndarray]], u: Fields, curvature: np.ndarray
    ) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
        """Yield the derivatives by z of the arrays that ``read`` returns, where d zeta = phi''(z) dz.

        Each item has the numbers of some components of z, and the derivatives by these components; all other
        derivatives vanish.  ``read`` is called with fields at repeated points, and with the number of
        repetitions. Many arrays do not depend on the components of z that belong to one branch or body. One
        random increment of all these components tests whether an array depends on them.
        """
        is_own, every = self.slope.owner >= 0, np.eye(self.components)
        probe = np.random.default_rng(0).standard_normal((1, self.components, 1)) * is_own[:, None]
        _, changed = next(incremented(u, z=probe, zeta=probe))
        depends = any(values.imag.any() for values in read(changed, 1).values())
        asked = np.flatnonzero(~is_own | depends)
        first, zeta = 0, curvature.transpose(2, 1, 0)[asked]
        for k, changed in incremented(u, z=every[asked, :, None], zeta=zeta):
            some, first = asked[first : first + k], first + k
            yield some, {name: derivative_of(g, k) for name, g in read(changed, k).items()}

    def _factors(self, terms: CellTerms, u: Fields) -> dict[str, np.ndarray]:
        """Factors of the tests in the terms ``asked``."""
        return terms.factors(self._asked, u)

    def _places(self, cells: slice) -> slice:
        """Numbers of the points in some cells."""
        return slice(self.op.z.per_cell * cells.start, self.op.z.per_cell * cells.stop)

    def tested(self, cells: slice, groups: Sequence[np.ndarray]) -> list[np.ndarray]:
        """tau P K for the coefficients of some cells, one array (cells, q n, q n) for each group of n
        components."""
        z = self.op.z.part(cells)
        values = self.tau * self.rate_slope[self._places(cells)]
        kind = np.float64 if abs(values).max(initial=0.0) > 1 else precision.SINGLE
        # values at the points are multiplied by each basis function, and projected onto the basis
        by_points = self._projection[cells][:, :, None] * z.blocks.swapaxes(1, 2)[:, None]
        by_points = by_points.reshape(z.cells, z.local**2, z.per_cell).astype(kind)
        results = []
        for some in groups:
            n = len(some)
            K = values if n == self.components else values[:, some[:, None], some]
            tested = by_points @ K.reshape(z.cells, z.per_cell, n * n).astype(kind)
            tested = tested.reshape(z.cells, z.local, z.local, n, n).transpose(0, 1, 3, 2, 4)
            results.append(tested.reshape(z.cells, z.local * n, z.local * n))
        return results

    def rows(self, dz: np.ndarray) -> np.ndarray:
        """Rows (K dz, .) from coefficients dz, both (cells' unknowns, n)."""
        values = self.op.z(np.ascontiguousarray(dz.T)).astype(self.rate_slope.dtype)
        return self.op.z.test(at_points(self.rate_slope, values)).T


class CollocatedTangent(_AtPoints):
    """The tangent of terms with a collocated rule, at the points of this rule."""

    def __init__(self, residual: ReducedResidual, terms: CellTerms) -> None:
        super().__init__(residual, terms, residual.couplings.collocated())

    def update(self, at: Evaluation) -> None:
        """Form K from the slopes of the flow rules, after the rules are linearised anew at their
        linearisation stresses."""
        self.tau = self.residual.step.context.tau.Get()
        self.residual.step.stresses.linearise()
        u = self.terms.fields(at.coefficients)
        self.curvature = self._curvature(u)
        self.rate_slope = np.zeros((self.op.points.count, self.components, self.components))
        for some, slopes in self._slopes(lambda u, _: self._factors(self.terms, u), u, self.curvature):
            self.rate_slope[:, :, some] -= slopes["z"].transpose(2, 0, 1)

    def follow(self, dz: np.ndarray, length: float) -> None:
        """Change the linearisation stresses by ``length`` times the increment dz, coefficients (n, .)."""
        values = self.op.z(dz)
        self.residual.step.stresses.follow_fields(values, at_points(self.curvature, values), length)


@dataclass
class PointValues:
    """Values at the points of some cells, for element matrices."""

    terms: CellTerms  # integrals over these cells
    fields: Fields
    columns: np.ndarray  # d rate/dX, (points, n, X)
    force: np.ndarray  # (points, X, n)
    beside: dict[str, np.ndarray]  # derivatives by z of rows of v, and of cell means, (points, d, n)
    resolvent: Resolvent  # see ``PointTangent.resolved``


class PointTangent(_AtPoints):
    """The tangent at the points of the coarse rule, and a cell's resolvent, with the collocated terms."""

    def __init__(self, residual: ReducedResidual, operators: Operators) -> None:
        terms = CellTerms(residual.step, operators, residual.rates)
        super().__init__(residual, terms, residual.couplings.of_state())
        collocated = residual.collocated_terms
        self.collocated = None if collocated is None else CollocatedTangent(residual, collocated)
        rates, count = residual.rates, operators.points.count
        self._creeps = bool(rates.mechanisms) and rates.is_local and not rates.creep_is_collocated
        fine = residual.divided(_ENTRIES / self.components**2)
        self.parts = [(part.cells, terms.part(part.cells), part) for part in fine]
        """Ranges of cells, with the terms at the points of the coarse rule and of the residual's rule."""
        self._stores = len(residual.parts) == 1
        """Whether all resolvents are stored, because the mesh is one part and they take little memory."""
        n, X = self.components, len(rates.tensors.constant)
        self.rate_slope = np.zeros((count, n, n), precision.SINGLE if self.collocated is None else np.float64)
        self._kept: dict[int, tuple[int, Resolvent | None]] = {}
        """Number of terms of the resolvent's series, and the resolvent (None if it is not stored); the key is
        the first cell of a part."""
        self.force: np.ndarray | None = None
        self.columns: np.ndarray | None = None
        self._of_mechanisms = [self._relaxed(i) for i in range(len(rates.mechanisms))]
        """Numbers of the components that each mechanism relaxes, and of the components on which its driving
        stress depends."""
        self._weighing = [term for term in self._asked if term.weighs]
        self._means = list(residual.couplings.of_kernel["cell means"]) if self._weighing else []
        self.weight: np.ndarray | None = None
        """Derivative by z of the inertia and the weight in the rows of v, (points, d, n)."""
        if self.collocated is not None or "Pi" in residual.unknowns.velocity_block:
            # steep rules or a creep rate field need the arrays at all points at once
            self.force, self.columns = np.zeros((count, X, n)), np.zeros((count, n, X))
            if self._weighing:
                self.weight = np.zeros((count, rates.dim, n))

    def _factors(self, terms: CellTerms, u: Fields) -> dict[str, np.ndarray]:
        return {mean.name: mean.value(u).value for mean in self._means} | super()._factors(terms, u)

    def begin(self, at: Evaluation) -> None:
        """Begin to linearise at an evaluation; linearise the collocated terms in all cells."""
        self.tau = self.residual.step.context.tau.Get()
        if self.collocated is not None:
            self.collocated.update(at)

    def update(self, cells: slice, terms: CellTerms, at: Evaluation) -> PointValues:
        """Form K and its resolvent in some cells; return the values at their points."""
        u = terms.fields(at.coefficients)
        rates, where = self.residual.rates, terms.op.places
        columns = rates.columns(u.z.value, rates.openings(u))
        K, force, beside = self._by_fields(terms, u, columns)
        self.rate_slope[where] = K
        if self.force is not None and self.columns is not None:
            self.force[where], self.columns[where] = force, columns
            if self.weight is not None:
                self.weight[where] = beside["v"]
        return PointValues(terms, u, columns, force, beside, self._resolvent(cells))

    def of_means(self, p: PointValues) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For each cell mean, yield its derivative by z at the points, (points, c, n), and the derivative of
        the rows of v by the mean, (points, d, c)."""
        for mean in self._means:
            size, kind = p.beside[mean.name].shape[1], mean.value(p.fields).value.shape[:-1]
            along = np.eye(size).reshape(size, *kind, 1)
            rows = p.terms.derivatives(self._weighing, p.fields, **{mean.name: along})["v"]
            yield p.beside[mean.name], rows.transpose(2, 0, 1)

    def _by_fields(
        self, terms: CellTerms, u: Fields, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """K, (points, n, n), the force's derivatives, (points, X, n), and the derivatives ``beside`` of
        ``PointValues``.

        All three are derivatives by z with d zeta = phi''(z) dz.

        Rates are products with constant tensors. Creep depends on z through its driving stress, whose
        derivatives are among those of the force.  Creep may depend on z and zeta in other ways; this
        dependence, and terms that depend on z or zeta, are differentiated by complex increments.  To leading
        order the increment of -(w . grad z) : zeta, with its part on facets, is div w times phi'(z) : dz. The
        flux of densities is approximated in the same way.
        """
        rates, curvature, z, zeta = self.residual.rates, self._curvature(u), u.z.value, u.zeta.value
        g, plane = rates.tensors.gradients, rates.dim**2
        X = np.zeros((columns.shape[2], z.shape[1]))
        X[:g] = rates.entries_of_L(u)
        if rates.mechanisms and not rates.creep_is_collocated:
            X[g:] = rates.creep_components(u)
        K, force = rates.slopes(z, X, zeta, rates.openings(u))
        force += np.matmul(columns.swapaxes(1, 2), curvature)
        if self._creeps:
            for i, of_stress in enumerate(self._creep_by_stress(u)):
                where, (rows, seen) = rates.components_of(i), self._of_mechanisms[i]
                driving = np.matmul(of_stress, np.ascontiguousarray(force[:, where, seen]))
                K[:, rows[:, None], seen] += np.matmul(columns[:, rows, where], driving)
            if not all(reads_stress_alone(m.rule) and m.body is None for m in rates.mechanisms):
                for some, slopes in self._slopes(self._creep_at_stress(u), u, curvature):
                    if slopes["creep"].any():
                        K[:, :, some] += np.matmul(columns[:, :, g:], slopes["creep"].transpose(2, 0, 1))
        force[:, rates.tensors.trace] += zeta.T[:, None]
        beside = dict[str, np.ndarray]()
        if not self._asked:
            return K, force, beside
        for some, slopes in self._slopes(lambda u, _: self._factors(terms, u), u, curvature):
            if "z" in slopes:
                K[:, :, some] -= slopes["z"].transpose(2, 0, 1)
            if "grad v" in slopes:
                stress = slopes["grad v"]
                force[:, :plane, some] += stress.reshape(plane, *stress.shape[2:]).transpose(2, 0, 1)
            if (radius := radius_of(u)) is not None and "v" in slopes:
                force[:, plane, some] += (radius * slopes["v"][0]).T
                slopes["v"][0] = 0.0
            for name in slopes.keys() - {"z", "grad z", "grad v"}:
                *kind, components, points = slopes[name].shape  # kind is empty for a number
                size = math.prod(kind)  # reshape could not infer a length -1 on a rank without cells
                of_name = beside.setdefault(name, np.zeros((len(K), size, len(z))))
                of_name[:, :, some] = slopes[name].reshape(size, components, points).transpose(2, 0, 1)
        return K, force, beside

    def _relaxed(self, mechanism: int) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the components that a mechanism relaxes, and of the components that the mechanism's
        driving stress reads."""
        rates, owner, every = self.residual.rates, self.slope.owner, np.arange(self.components)
        where = rates.components_of(mechanism)
        parts = [rates.tensors, *([] if rates.weighed is None else [rates.weighed])]
        linear = np.any([part.linear[where] != 0 for part in parts], axis=0)
        is_relaxed = linear.any(axis=(0, 2)) | np.any([part.constant[where] for part in parts], axis=(0, 1))
        branches = np.unique(owner[is_relaxed])
        if len(branches) != 1 or branches[0] < 0:
            return np.flatnonzero(is_relaxed), every
        is_read = (owner == branches[0]) | (owner < 0) | linear.any(axis=(0, 1))
        return np.flatnonzero(is_relaxed), np.flatnonzero(is_read)

    def _creep_at_stress(self, u: Fields) -> Callable[[Fields, int], dict[str, np.ndarray]]:
        """A function for ``_slopes`` that returns the creep rates Pi of all mechanisms at changed fields; the
        Mandel stresses stay those of ``u``."""
        rates = self.residual.rates
        stresses = [rates.mandel(u, mechanism).value for mechanism in rates.mechanisms]

        def read(changed: Fields, count: int) -> dict[str, np.ndarray]:
            parts = []
            for mechanism, stress in zip(rates.mechanisms, stresses, strict=True):
                M = rates.of_body(mechanism, Array(np.tile(stress, count), None), changed)
                parts.append(rates.creep_space.components(rates.creep_by(mechanism, M, changed)).value)
            return {"creep": np.concatenate(parts)}

        return read

    def _creep_by_stress(self, u: Fields) -> list[np.ndarray]:
        """Derivatives of each mechanism's Pi by the driving stress d(zeta : rate)/dPi, (points, p, p)."""
        rates, size = self.residual.rates, self.residual.rates.creep_space.size
        points, slopes = u.z.value.shape[1], list[np.ndarray]()
        units = rates.mandel_of(np.eye(size))
        for mechanism in rates.mechanisms:
            rule = mechanism.rule
            if reads_stress_alone(rule):
                of_units = rates.creep_space.components(rule.rate(units, None, {})).value
                share = rates.of_body(mechanism, Array(np.ones((1, points)), None), u).value
                slopes.append(of_units * share.T[:, :, None])
                continue
            M = rates.driving(mechanism, u)
            slopes.append(slope := np.empty((points, size, size)))
            for start in range(0, size, group := max(1, TOGETHER // max(points, 1))):
                along = units.value.transpose(2, 0, 1)[start : start + group, ..., None]
                many = repeated(u, len(along))
                if mechanism.body is not None:
                    along = along / mechanism.share(u.z_tensors).value
                Pi = rates.creep_by(mechanism, Array(repeated_along(M.value, along), None), many)
                of_stress = derivative_of(rates.creep_space.components(Pi).value, len(along))
                slope[:, :, start : start + len(along)] = of_stress.transpose(2, 0, 1)
        return slopes

    def fields_rows(self, dz: np.ndarray) -> np.ndarray:
        """Rows (K dz, .), with the rows of the collocated terms."""
        return self.rows(dz) if self.collocated is None else self.rows(dz) + self.collocated.rows(dz)

    def stiffness(self) -> np.ndarray:
        """C of the module's docstring, (points, X, X)."""
        assert self.force is not None and self.columns is not None
        resolvent = np.linalg.inv(np.eye(self.components) - self.tau * self.rate_slope)
        return self.tau * self.force @ (resolvent @ self.columns)

    def _resolvent(self, cells: slice) -> Resolvent:
        """The resolvent of some cells. It is stored if the mesh is one part, or if no series replaces it."""
        groups = self._groups(cells)
        tested = self.tested(cells, groups)
        if self.collocated is not None:
            pairs = zip(tested, self.collocated.tested(cells, groups), strict=True)
            tested = [first + second for first, second in pairs]
        blocks, counts = zip(*map(resolvents, tested), strict=True)
        resolvent = Resolvent(groups, blocks)
        terms = min(counts) and max(counts)
        is_kept = self._stores or terms == 0 or self.collocated is not None
        self._kept[cells.start] = terms, resolvent.astype(self.rate_slope.dtype) if is_kept else None
        return resolvent

    def _groups(self, cells: slice) -> list[np.ndarray]:
        """Groups of components by which the resolvent of some cells is inverted.

        A group is a branch together with the shared components. Each group has an inverse of its own, since
        products of the matrices do not mix groups. If the rate of a branch depends on another branch, or the
        rate of a shared component on a branch, there is one group of all components.
        """
        owner, every = self.slope.owner, np.arange(self.components)
        if owner.max(initial=-1) < 1:
            return [every]
        foreign = (owner[:, None] != owner) & (owner >= 0)
        slopes = [self.rate_slope[self._places(cells)]]
        if self.collocated is not None:
            slopes.append(self.collocated.rate_slope[self.collocated._places(cells)])
        if any(slope[:, foreign].any() for slope in slopes):
            return [every]
        return [np.flatnonzero((owner == i) | (owner < 0)) for i in range(owner.max() + 1)]

    def resolved(self, dz: np.ndarray) -> np.ndarray:
        """Return (1 - tau P K)^{-1} dz for coefficients dz, both (cells' unknowns, n); P projects onto the
        fields' space.

        The resolvent acts on coefficients, not on values at points: tau K may be large at single points of a
        cell, where matter yields.  On a mesh of several parts the cells' matrices would take too much memory.
        Where tau P K is small, a series then replaces them.
        """
        op, n, result = self.op.z, self.components, np.empty(dz.shape, self.rate_slope.dtype)
        for cells, *_ in self.parts:
            terms, resolvent = self._kept[cells.start]
            rows = slice(op.local * cells.start, op.local * cells.stop)
            if resolvent is not None:
                of_cells = dz[rows].reshape(resolvent.cells, op.local, n)  # a rank may have no cells
                result[rows] = resolvent(of_cells).reshape(-1, n)
                continue
            blocks = op.part(cells).blocks.astype(result.dtype)
            K = self.rate_slope[self._places(cells)]
            projection = self._projection[cells].astype(result.dtype)
            start = dz[rows].reshape(len(blocks), op.local, n).astype(result.dtype)
            x = start
            for _ in range(terms - 1):
                increment = np.matmul(K, np.matmul(blocks, self.tau * x).reshape(-1, n, 1))
                x = start + np.matmul(projection, increment.reshape(len(blocks), op.per_cell, n))
            result[rows] = x.reshape(-1, n)
        return result


def reads_stress_alone(rule: FlowRule) -> bool:
    """Whether Pi is a constant linear function of the driving stress."""
    return rule.is_linear and not rule.reads_conjugate


def at_points(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Multiply matrices (points, i, j) by values (j, points), to (i, points)."""
    return np.ascontiguousarray(np.matmul(matrices, values.T[:, :, None])[:, :, 0].T)


def radius_of(u: Fields) -> np.ndarray | None:
    """The radius r of a body of revolution at the points, (points,); None for other bodies."""
    radius = u.layout.symmetry.radius
    return None if radius is None else u.context.given(radius).value

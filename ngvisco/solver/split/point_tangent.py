"""What the fields at a point make of an increment of v and Pi, and the force that answers: of one cell alone.

The fields follow an increment X = (grad dv, dPi), neither convected nor carried
through facets, as

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep + terms of z)/dz,

and with the elastic force zeta : rate(z; X) that makes the point's stiffness
C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX), not symmetric where there is stress or
creep.

What is integrated at the nodes (``Quadrature.nodes``), as nonlinear creep, has its part of K there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ngvisco.algebra import precision
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.reduced.evaluation import CellTerms, derivative_of, incremented
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.reduced.slope import PointwiseSlope
from ngvisco.threads import product


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
        self.dz = self.values.grad_z.value
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
        g = rates.tensors.gradients
        X = np.zeros((self.columns.shape[2], self.z.shape[1]))
        X[:g] = u.grad_v.value.reshape(g, -1)
        if rates.flows and not rates.creeps_at_nodes:
            X[g:] = rates.creep_components(u)
        K, force = (each.transpose(2, 0, 1) for each in rates.slopes(self.z, X, self.zeta))
        force = force + product(self.columns.swapaxes(1, 2), self.curvature)
        force[:, : g : self.residual.step.mesh.dim + 1] += self.zeta.T[:, None]
        if not (self._asked or self._creeps):
            return np.ascontiguousarray(K), force
        K, of_creep = K.copy(), self.columns[:, :, g:]
        for some, found in self._slopes():
            if "creep" in found:
                K[:, :, some] += product(of_creep, found["creep"].transpose(2, 0, 1))
            if "z" in found:
                K[:, :, some] -= found["z"].transpose(2, 0, 1)
            if "grad v" in found:
                stress = found["grad v"]
                force[:, :g, some] += stress.reshape(g, *stress.shape[2:]).transpose(2, 0, 1)
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
    return np.ascontiguousarray(product(matrices, values.T[:, :, None])[:, :, 0].T)


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
        power = product(power, power)
        result += product(result, power)
    return result

"""Matrices of the scalar spaces that the fields and the velocity are made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, L2, BilinearForm, CoefficientFunction, FESpace

from ngvisco.forms.points import CellPoints, csr
from ngvisco.forms.system import Step
from ngvisco.physics.arrays import array_slope
from ngvisco.physics.material import component_count, components_of, conjugates, tensors_of
from ngvisco.physics.pointwise import respond
from ngvisco.solver.split.local import LocalMatrix

TINY = 1e-30
"""Length of a complex increment, relative to the direction."""


class ScalarForm:
    """A bilinear form over cell boundaries whose matrix is assembled again and again."""

    def __init__(self, trial: FESpace, test: FESpace, value: Any, measure: Any) -> None:
        """``value`` maps trial and test function to the integrand."""
        self.form = BilinearForm(trialspace=trial, testspace=test)
        self.form += value(trial.TrialFunction(), test.TestFunction()).Compile() * measure
        self.form.Assemble()
        self.matrix = csr(self.form.mat)

    def assemble(self) -> sp.csr_matrix:
        self.form.Assemble()
        self.matrix.data[:] = self.form.mat.AsVector().FV().NumPy()
        return self.matrix


class Operators:
    """Fields at the points of one rule, and tests there."""

    def __init__(self, step: Step, order: int) -> None:
        layout, mesh = step.layout, step.mesh
        self.points = points = CellPoints(mesh, order)
        self.scalar = L2(mesh, order=layout.discretisation.m)
        self.velocity, self.creep = layout.scalar_velocity_space(), layout.scalar_creep_space()
        self.weights = points.weights
        self.z, self.v = self.local(points.values(self.scalar)), self.local(points.values(self.velocity))
        self.dz = [self.local(D) for D in points.gradients(self.scalar)]
        self.dv = [self.local(D) for D in points.gradients(self.velocity)]

    def local(self, matrix: sp.csr_matrix) -> LocalMatrix:
        """A matrix whose rows are the points, with the rule's weights for tests."""
        return LocalMatrix(matrix, self.points.mesh.ne, self.weights)

    def gradients(self, operators: Sequence[LocalMatrix], rows: np.ndarray) -> np.ndarray:
        """Partial derivatives of each of ``rows``, (rows, dim, points)."""
        result = np.empty((len(rows), len(operators), self.points.count))
        for j, D in enumerate(operators):
            D(rows, out=result[:, j])
        return result

    def velocity_gradient(self, v: np.ndarray) -> np.ndarray:
        """L_ij = d_j v_i row by row at the points, (dim^2, points)."""
        return self.gradients(self.dv, v).reshape(-1, self.points.count)


def apply(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """matrix @ each row, (rows, height)."""
    return np.stack([matrix @ row for row in rows])


def together(matrix: sp.csr_matrix, rows: np.ndarray) -> np.ndarray:
    """The same, of few rows by one pass through the matrix."""
    return np.ascontiguousarray((matrix @ np.ascontiguousarray(rows.T, matrix.dtype)).T)


class Conjugation:
    """phi'(z) at the points of a rule, in components."""

    def __init__(self, step: Step, points: CellPoints) -> None:
        self.material, self.dim = material, dim = step.model.material, step.mesh.dim
        self.n, self.points = component_count(material, dim), points
        self.response = self._curvature = material.response(dim)
        if self.response is not None:
            return
        self.arrays, self.is_checked = array_slope(material, dim), False
        self.at, self.slope = points.function(self.n), points.function(self.n)
        tensors = tensors_of(material, self.at, dim)
        expression = components_of(material, conjugates(material, tensors), dim)
        if self.n == 1:
            expression = CF((expression[0], 0.0))
        self.expression: CoefficientFunction = expression.Compile()

    def __call__(self, z_values: np.ndarray) -> np.ndarray:
        """phi'(z), (n, points), for z at the points, (n, points)."""
        if self.response is not None:
            return np.ascontiguousarray(self.response(z_values.T).slope.T)
        if self.arrays is None:
            return self._by_expression(z_values)
        slope = self.arrays(z_values)
        if not self.is_checked:
            self.is_checked = True
            expected = self._by_expression(z_values)
            if not np.allclose(slope, expected, rtol=1e-9, atol=1e-12 * abs(expected).max(initial=0.0)):
                self.arrays = None  # an energy that means something else with arrays
                return expected
        return slope

    def derivative(self, z_values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The map dz -> phi''(z) dz at the points, both (n, points), for z as above."""
        arrays = self.arrays if self.response is None else None
        if arrays is not None:
            # the imaginary part of a tiny complex increment: no difference is taken, nothing cancels
            return lambda dz: arrays(z_values + (TINY * 1j) * dz).imag / TINY
        if self._curvature is None:
            self._curvature = respond(self.material, self.dim)
        hessian = self._curvature(z_values.T).hessian
        return lambda dz: np.einsum("pnm,mp->np", hessian, dz)

    def _by_expression(self, z_values: np.ndarray) -> np.ndarray:
        self.points.read(self.at, self.n)[:] = z_values
        self.slope.Interpolate(self.expression)
        return self.points.read(self.slope, self.n).copy()


def mass_matrix(values: sp.csr_matrix, weights: np.ndarray) -> sp.csr_matrix:
    """The mass matrix of functions with these values at the points."""
    return (values.T @ sp.diags(weights) @ values).tocsr()


def pruned(matrix: sp.csr_matrix) -> sp.csr_matrix:
    """Without the entries that are rounding: a side sees the normal derivative of its own facet alone."""
    matrix.data[abs(matrix.data) <= 1e-14 * abs(matrix.data).max(initial=0.0)] = 0.0
    matrix.eliminate_zeros()
    return matrix

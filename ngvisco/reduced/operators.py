"""Matrices that take the fields' coefficients to values at the points of cells and sides, and test there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import L2

from ngvisco.algebra.local import LocalMatrix
from ngvisco.forms.mesh.points import CellPoints
from ngvisco.forms.mesh.side_points import SidePoints
from ngvisco.forms.system import Step


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

    @cached_property
    def creep_values(self) -> LocalMatrix:
        """Values of a component of a creep rate field."""
        return self.local(self.points.values(self.creep))

    @cached_property
    def dcreep(self) -> list[LocalMatrix]:
        """Partial derivatives of the same."""
        return [self.local(D) for D in self.points.gradients(self.creep)]

    def local(self, matrix: sp.csr_matrix) -> LocalMatrix:
        """A matrix whose rows are the points, with the rule's weights for tests."""
        return LocalMatrix(matrix, self.points.mesh.ne, self.weights)

    def gradients(self, operators: Sequence[LocalMatrix], rows: np.ndarray) -> np.ndarray:
        """Partial derivatives of each of ``rows``, (rows, dim, points)."""
        result = np.empty((len(rows), len(operators), self.points.count), rows.dtype)
        for j, D in enumerate(operators):
            D(rows, out=result[:, j])
        return result

    def velocity_gradient(self, v: np.ndarray) -> np.ndarray:
        """L_ij = d_j v_i row by row at the points, (dim^2, points)."""
        return self.gradients(self.dv, v).reshape(len(v) * len(self.dv), self.points.count)


class SideOperators:
    """Fields at the points of the cells' sides, and tests there."""

    def __init__(self, step: Step, cells: Operators) -> None:
        mesh, context = step.mesh, step.context
        self.points = points = SidePoints(mesh, step.quadrature.facet_degree)
        self.z, self.hat, self.v = (
            LocalMatrix(points.values(space), mesh.ne, points.weights)
            for space in (cells.scalar, step.layout.scalar_facet_space(), cells.velocity)
        )
        self.inner = np.round(points.sample(context.inner))
        """1 between two cells, 0 on walls."""
        self.h = np.repeat(context.h.vec.FV().NumPy(), self.z.per_cell)

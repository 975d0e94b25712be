"""Values at the quadrature points of the cells' sides by sparse matrices.

What ``CellPoints`` is for the cells, for the integrals over both sides of all facets
(``Quadrature.facets``).  NGSolve has no space of values at these points; a matrix is put together from one
assembly for each point of the rule, with a rule of that point alone and one constant test on each side.

Arrays are (components, points), points side by side, sides cell by cell in the cell's own order.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    CF,
    ET,
    BilinearForm,
    CoefficientFunction,
    Discontinuous,
    FacetFESpace,
    FESpace,
    IntegrationRule,
    LinearForm,
    Mesh,
    dx,
    specialcf,
)

from ngvisco.forms.mesh.points import csr

NEGLIGIBLE = 1e-14
"""Entries smaller than this, relative to the largest, are rounding: a side sees its own facet alone."""


class SidePoints:
    """The points of the rule of degree ``degree`` on every side of every simplex of a mesh."""

    def __init__(self, mesh: Mesh, degree: int) -> None:
        self.mesh = mesh
        self.shape = ET.SEGM if mesh.dim == 2 else ET.TRIG
        rule = IntegrationRule(self.shape, degree)
        self.rules = [
            IntegrationRule(points=[tuple(point[: mesh.dim - 1])], weights=[1.0]) for point in rule.points
        ]
        self.per_side = len(self.rules)
        self._tests = Discontinuous(FacetFESpace(mesh, order=0))
        self.sides = self._tests.ndof
        self._measure = self._loads(CF(1.0))
        self.weights = (np.array(rule.weights)[None] * self._measure).ravel()

    @cached_property
    def count(self) -> int:
        return self.weights.size

    def _dx(self, rule: IntegrationRule) -> object:
        return dx(element_boundary=True, intrules={self.shape: rule})

    def _loads(self, value: CoefficientFunction) -> np.ndarray:
        """Values times the facets' Jacobians, (sides, points of a side)."""
        result = np.empty((self.sides, self.per_side))
        for q, rule in enumerate(self.rules):
            form = LinearForm(self._tests)
            form += value * self._tests.TestFunction() * self._dx(rule)
            form.Assemble()
            result[:, q] = form.vec.FV().NumPy()
        return result

    def sample(self, value: CoefficientFunction) -> np.ndarray:
        """A scalar function at the points, (points,)."""
        return (self._loads(value) / self._measure).ravel()

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit outer normals of the cells, (dim, points)."""
        n = specialcf.normal(self.mesh.dim)
        return np.stack([self.sample(n[i]) for i in range(self.mesh.dim)])

    def values(self, space: FESpace) -> sp.csr_matrix:
        """The matrix that takes coefficients of a scalar space to values at the points."""
        return self.operator(space, lambda u: u)

    def operator(
        self, space: FESpace, value: Callable[[CoefficientFunction], CoefficientFunction]
    ) -> sp.csr_matrix:
        """The matrix (points, unknowns) of a scalar ``value``, linear in the space's functions."""
        form_value = value(space.TrialFunction())
        data, columns, rows = [], [], []
        for q, rule in enumerate(self.rules):
            form = BilinearForm(trialspace=space, testspace=self._tests)
            form += form_value * self._tests.TestFunction() * self._dx(rule)
            form.Assemble()
            part = csr(form.mat).tocoo()
            data.append(part.data / self._measure[part.row, q])
            columns.append(part.col)
            rows.append(part.row * self.per_side + q)
        values = np.concatenate(data)
        keep = abs(values) > NEGLIGIBLE * abs(values).max(initial=0.0)
        where = (np.concatenate(rows)[keep], np.concatenate(columns)[keep])
        return sp.csr_matrix((values[keep], where), shape=(self.count, space.ndof))

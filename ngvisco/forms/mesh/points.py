"""Values at the quadrature points of the cells and of their sides by sparse matrices.

The split solver evaluates the transported fields' part of the residual hundreds of times on one mesh.  A
symbolic form evaluates its whole integrand for each component of each test function. Here every field is
evaluated at the points once, the integrand is formed once, and the transposed matrices test it.  The matrices
are assembled, once, from the spaces of the step by the rules of its forms. They therefore include curved
cells, identified unknowns and NGSolve's numbering.

Arrays are (components, points), with points ordered by cells, and points of sides by the cell's sides.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    CF,
    ET,
    BaseMatrix,
    BilinearForm,
    CoefficientFunction,
    Discontinuous,
    FacetFESpace,
    FESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Mesh,
    VectorValued,
    dx,
    grad,
    specialcf,
)
from ngsolve.comp import IntegrationRuleSpace

from ngvisco.errors import MeshError
from ngvisco.forms.mesh.symmetry import Symmetry

NEGLIGIBLE = 1e-14
"""Relative size below which entries are rounding, and are removed, so that a side reads the unknowns of its
facet only."""


def csr(matrix: BaseMatrix) -> sp.csr_matrix:
    """Copy an NGSolve sparse matrix, or this rank's part of a distributed one, to a scipy matrix."""
    values, columns, rows = getattr(matrix, "local_mat", matrix).CSR()
    parts = values.NumPy().copy(), columns.NumPy().copy(), np.asarray(rows.NumPy(), dtype=np.int64)
    return sp.csr_matrix(parts, shape=(matrix.height, matrix.width))


class CellPoints:
    """The points of the rule of even degree 2 ``order`` on a mesh of simplices."""

    def __init__(self, mesh: Mesh, order: int, symmetry: Symmetry) -> None:
        self.mesh, self.symmetry = mesh, symmetry
        self.shape = ET.TRIG if mesh.dim == 2 else ET.TET
        self.rules = {self.shape: IntegrationRule(self.shape, 2 * order)}
        self.per_cell = len(self.rules[self.shape])
        self.space = IntegrationRuleSpace(mesh, order=order)
        if self.space.ndof != mesh.ne * self.per_cell:
            raise MeshError("the split solver needs a mesh of triangles or tetrahedra only")
        self.count, self.dx = self.space.ndof, dx(intrules=self.rules)

    @cached_property
    def weights(self) -> np.ndarray:
        """Weight times Jacobian at every point, (points,), m^dim; times r in a body of revolution."""
        weight = self.symmetry.radius
        return self._measure if weight is None else self._loads(weight)

    @cached_property
    def _measure(self) -> np.ndarray:
        return self._loads(CF(1.0))

    def _loads(self, value: CoefficientFunction) -> np.ndarray:
        return LinearForm(value * self.space.TestFunction() * self.dx).Assemble().vec.FV().NumPy().copy()

    def values(self, space: FESpace) -> sp.csr_matrix:
        """The matrix that takes coefficients of a scalar space to values at the points."""
        return self._operator(space, space.TrialFunction())

    def gradients(self, space: FESpace) -> list[sp.csr_matrix]:
        """Matrices from coefficients of a scalar space to partial derivatives d_1 ... d_dim at the points."""
        return [self._operator(space, grad(space.TrialFunction())[j]) for j in range(self.mesh.dim)]

    def _operator(self, space: FESpace, value: CoefficientFunction) -> sp.csr_matrix:
        form = BilinearForm(trialspace=space, testspace=self.space)
        form += value * self.space.TestFunction() * self.dx
        matrix = csr(form.Assemble().mat)
        matrix.data /= np.repeat(self._measure, np.diff(matrix.indptr))
        return matrix

    def function(self, components: int) -> GridFunction:
        """A grid function of vectors at the points, to be used in coefficient functions.

        The function has at least two components, because NGSolve cannot differentiate a vector of one
        component at points.
        """
        return GridFunction(VectorValued(self.space, max(2, components)))

    def read(self, function: GridFunction, components: int) -> np.ndarray:
        """Values of a function made by ``function``, (components, points), as a view."""
        return function.vec.FV().NumPy().reshape(function.dim, self.count)[:components]


class SidePoints:
    """The points of the rule of degree ``degree`` on every side of every simplex of a mesh.

    NGSolve has no space of values at these points.  A matrix is therefore composed of one assembly for each
    point of the rule. This assembly has a rule of the one point, and a constant test on each side.
    """

    def __init__(self, mesh: Mesh, degree: int, symmetry: Symmetry) -> None:
        self.mesh = mesh
        self.shape = ET.SEGM if mesh.dim == 2 else ET.TRIG
        rule = IntegrationRule(self.shape, degree)
        self.rules = [
            IntegrationRule(points=[tuple(point[: mesh.dim - 1])], weights=[1.0]) for point in rule.points
        ]
        self.per_side = len(self.rules)
        self._tests = Discontinuous(FacetFESpace(mesh, order=0))
        self.sides = self._tests.ndof
        self.per_cell = self.sides // max(mesh.ne, 1)
        """Number of sides of a cell."""
        self._is_straight = mesh.GetCurveOrder() <= 1
        self._measure = self._constant(self._loads(CF(1.0)))
        self.weights = (np.array(rule.weights)[None] * self._measure).ravel()
        """Weight times Jacobian, (points,), m^(dim - 1); times r in a body of revolution."""
        if symmetry.on_facets is not None:
            self.weights = self.weights * self.sample(symmetry.on_facets)
        self.count = self.weights.size

    def _dx(self, rule: IntegrationRule) -> object:
        return dx(element_boundary=True, intrules={self.shape: rule})

    def _loads(self, value: CoefficientFunction) -> np.ndarray:
        """Products of a function's values and the facets' Jacobians, (sides, points of a side)."""
        result = np.empty((self.sides, self.per_side))
        for q, rule in enumerate(self.rules):
            form = LinearForm(self._tests)  # with its space: a zero value has no test function
            form += value * self._tests.TestFunction() * self._dx(rule)
            result[:, q] = form.Assemble().vec.FV().NumPy()
        return result

    def _constant(self, values: np.ndarray) -> np.ndarray:
        """``values``, (..., points of a side). If sides are straight, only the first point's values are
        returned, because the values are constant on a side."""
        return values[..., :1].copy() if self._is_straight else values

    def sample(self, value: CoefficientFunction) -> np.ndarray:
        """Values of a scalar function at the points, (points,)."""
        return (self._loads(value) / self._measure).ravel()

    @cached_property
    def _normals(self) -> np.ndarray:
        n, shape = specialcf.normal(self.mesh.dim), (self.sides, self.per_side)
        samples = (self.sample(n[i]).reshape(shape) for i in range(self.mesh.dim))
        return np.stack([self._constant(sample) for sample in samples])

    def normals_of(self, points: slice) -> np.ndarray:
        """Unit outer normals of the cells at a range of points of whole sides, (dim, points).

        One normal is stored for a straight side."""
        sides = self._normals[:, points.start // self.per_side : points.stop // self.per_side]
        shape = self.mesh.dim, sides.shape[1], self.per_side
        return np.broadcast_to(sides, shape).reshape(self.mesh.dim, sides.shape[1] * self.per_side)

    @property
    def normals(self) -> np.ndarray:
        """Unit outer normals of the cells, (dim, points)."""
        return self.normals_of(slice(0, self.count))

    def values(self, space: FESpace) -> sp.csr_matrix:
        """The matrix that takes coefficients of a scalar space to values at the points."""
        return self.operator(space, lambda u: u)

    def gradients(self, space: FESpace) -> list[sp.csr_matrix]:
        """Matrices from coefficients of a scalar space to partial derivatives, taken in the side's cell."""

        def slope(j: int) -> sp.csr_matrix:
            return self.operator(space, lambda u: grad(u)[j])

        return [slope(j) for j in range(self.mesh.dim)]

    def operator(
        self, space: FESpace, value: Callable[[CoefficientFunction], CoefficientFunction]
    ) -> sp.csr_matrix:
        """The matrix (points, unknowns) of a scalar ``value``, linear in the space's functions."""
        form_value = value(space.TrialFunction())
        data, columns, rows = [], [], []
        measure = np.broadcast_to(self._measure, (self.sides, self.per_side))
        for q, rule in enumerate(self.rules):
            form = BilinearForm(trialspace=space, testspace=self._tests)
            form += form_value * self._tests.TestFunction() * self._dx(rule)
            part = csr(form.Assemble().mat).tocoo()
            data.append(part.data / measure[part.row, q])
            columns.append(part.col)
            rows.append(part.row * self.per_side + q)
        values = np.concatenate(data)
        keep = abs(values) > NEGLIGIBLE * abs(values).max(initial=0.0)
        where = (np.concatenate(rows)[keep], np.concatenate(columns)[keep])
        return sp.csr_matrix((values[keep], where), shape=(self.count, space.ndof))

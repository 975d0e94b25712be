"""Values at the cells' quadrature points by sparse matrices.

The split solver evaluates the transported fields' part of the residual hundreds of times on one mesh.
A symbolic form evaluates its whole integrand for each component of each test function; here every field
is carried to the points once, the integrand is formed once, and the transposed matrices test it.  The
matrices are assembled, once, from the spaces of the step by the rule of its forms, so that they know of
curved cells, of identified unknowns and of NGSolve's numbering.

Arrays are (components, points), points cell by cell.
"""

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    ET,
    BaseMatrix,
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Mesh,
    VectorValued,
    dx,
    grad,
)
from ngsolve.comp import IntegrationRuleSpace

from ngvisco.errors import MeshError


def csr(matrix: BaseMatrix) -> sp.csr_matrix:
    """An NGSolve sparse matrix as a scipy one, sharing no memory; of a distributed one this rank's part."""
    values, columns, rows = getattr(matrix, "local_mat", matrix).CSR()
    return sp.csr_matrix(
        (values.NumPy().copy(), columns.NumPy().copy(), np.asarray(rows.NumPy(), dtype=np.int64)),
        shape=(matrix.height, matrix.width),
    )


class CellPoints:
    """The points of the rule of even degree 2 ``order`` on a mesh of simplices."""

    def __init__(self, mesh: Mesh, order: int) -> None:
        self.mesh = mesh
        self.shape = ET.TRIG if mesh.dim == 2 else ET.TET
        self.rules = {self.shape: IntegrationRule(self.shape, 2 * order)}
        self.per_cell = len(self.rules[self.shape])
        self.space = IntegrationRuleSpace(mesh, order=order)
        if self.space.ndof != mesh.ne * self.per_cell:
            raise MeshError("the split solver needs a mesh of triangles or tetrahedra only")
        self.dx = dx(intrules=self.rules)

    @cached_property
    def count(self) -> int:
        return self.space.ndof

    @cached_property
    def weights(self) -> np.ndarray:
        """Weight times Jacobian at every point, (points,), m^dim."""
        form = LinearForm(self.space)
        form += self.space.TestFunction() * self.dx
        form.Assemble()
        return form.vec.FV().NumPy().copy()

    def values(self, space: FESpace) -> sp.csr_matrix:
        """The matrix that takes coefficients of a scalar space to values at the points."""
        return self._operator(space, space.TrialFunction())

    def gradients(self, space: FESpace) -> list[sp.csr_matrix]:
        """The same for the partial derivatives d_1 ... d_dim."""
        return [self._operator(space, grad(space.TrialFunction())[j]) for j in range(self.mesh.dim)]

    def _operator(self, space: FESpace, value: CoefficientFunction) -> sp.csr_matrix:
        form = BilinearForm(trialspace=space, testspace=self.space)
        form += value * self.space.TestFunction() * self.dx
        form.Assemble()
        matrix = csr(form.mat)
        matrix.data /= np.repeat(self.weights, np.diff(matrix.indptr))
        return matrix

    def function(self, components: int) -> GridFunction:
        """A grid function of vectors at the points, to be used in coefficient functions.

        It has two components at least: a vector of one cannot be differentiated by NGSolve here.
        """
        return GridFunction(VectorValued(self.space, max(2, components)))

    def read(self, function: GridFunction, components: int) -> np.ndarray:
        """The values of such a function, (components, points), as a view."""
        return function.vec.FV().NumPy().reshape(function.dim, self.count)[:components]

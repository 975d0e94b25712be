"""The hyperviscosity with its local unknowns as functions of (v, a), by matrices.

Lifting and jump are linear in (v, a) and the same for every component of v; their matrices are assembled
once.  What is nonlinear is in scalars on cells (see ``ngvisco.forms.hyperviscosity``):

    Hs = lifting(v, a),  s = P |Hs|^2,  c_s = P c(s) + facets,  S = P (c_s Hs),

P the cellwise L2 projections.  The penalty is formed at the sides' points, by the rule of the forms.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    CF,
    L2,
    BilinearForm,
    CoefficientFunction,
    Grad,
    NormalFacetFESpace,
    Periodic,
    VectorValued,
    grad,
    specialcf,
)

from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.points import CellPoints, csr
from ngvisco.forms.side_points import SidePoints
from ngvisco.forms.spaces import contraction, hessian_basis
from ngvisco.forms.system import Step
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.local import LocalMatrix
from ngvisco.solver.split.operators import mass_matrix, pruned


class SideJumps:
    """Jumps j = a - d_n v, and what the penalty needs besides, at the sides' points of one rule."""

    def __init__(self, hyper: MatrixHyperviscosity, points: SidePoints) -> None:
        mesh, n = points.mesh, specialcf.normal(points.mesh.dim)
        self.points, self.weights = points, points.weights
        self.of_v = points.operator(hyper.velocity, lambda u: -(grad(u) * n))
        self.of_a = points.operator(hyper.normal, lambda b: b * n)
        self.matrix = sp.hstack([self.of_v, self.of_a], format="csr")
        self.h = np.repeat(hyper.term.context.h.vec.FV().NumPy(), points.count // mesh.ne)
        self.penalty = hyper.law.penalty / self.h
        if not hyper.law.is_linear:
            self.scalar = LocalMatrix(points.values(hyper.squares), mesh.ne, self.weights)

    @cached_property
    def jump(self) -> LocalMatrix:
        """j of (v, a) side by side."""
        return LocalMatrix(self.matrix, self.points.mesh.ne, self.weights)


class MatrixHyperviscosity:
    """Rows of v and a of one step's hyperviscosity."""

    def __init__(self, step: Step, term: Hyperviscosity, points: CellPoints, sides: SidePoints) -> None:
        self.step, self.term, self.law = step, term, term.law
        layout, self.dim = step.layout, step.mesh.dim
        k = layout.discretisation.k
        # Hs and all that is made of it are cellwise constant for k = 2: one point does
        constant = k == 2 and step.mesh.GetCurveOrder() <= 1
        self.points = CellPoints(step.mesh, 0) if constant else points
        self.velocity = layout.scalar_velocity_space()
        normal_space = NormalFacetFESpace(step.mesh, order=k - 1)
        self.normal = Periodic(normal_space) if layout.periodic else normal_space
        self.squares = L2(step.mesh, order=2 * k - 4)
        state = step.state.vec.FV().NumPy()
        self.v = state[layout.ranges["v"]].reshape(self.dim, -1)
        start = layout.ranges["a_1"].start
        stop = layout.ranges[f"a_{self.dim}"].stop
        self.a = state[start:stop].reshape(self.dim, -1)
        self._lifting(k)
        self.sides = SideJumps(self, sides)
        self.hess = state[layout.ranges["hess"]].reshape(self.dim * self.size, -1)
        self.stress = state[layout.ranges["hyperstress"]].reshape(self.dim * self.size, -1)
        if not self.law.is_linear:
            self.s = state[layout.ranges["hess_square"]]
            self.c = state[layout.ranges["hyper_coefficient"]]
            self.s_values = self._local(self.points.values(self.squares))
            mass = mass_matrix(self.s_values.matrix, self.points.weights)
            self.s_inverse = BlockInverse(mass)
            self.s_inverse.update(mass)

    def _local(self, matrix: sp.csr_matrix) -> LocalMatrix:
        return LocalMatrix(matrix, self.step.mesh.ne, self.points.weights)

    def _lifting(self, k: int) -> None:
        """L_v, L_a with  mass Hs_i = L_v v_i + L_a a_i,  and the lifting of (v, a)."""
        dim, facets = self.dim, self.step.quadrature.facets
        mesh, n = self.step.mesh, self.term.context.normal
        scalar = L2(mesh, order=k - 2)
        size = hessian_basis(dim).shape[1]
        tests = VectorValued(scalar, size)
        X, phi, b = tests.TestFunction(), self.velocity.TrialFunction(), self.normal.TrialFunction()
        X_n = contraction(n, dim).trans * X
        of_v = BilinearForm(trialspace=self.velocity, testspace=tests)
        of_v += (X_n * grad(phi) - (X_n * n) * (grad(phi) * n)) * facets
        if k > 2:
            of_v += -(grad(phi) * _divergence(X, dim)) * self.step.quadrature.cells
        of_a = BilinearForm(trialspace=self.normal, testspace=tests)
        of_a += (X_n * n) * (b * n) * facets
        self.L_v, self.L_a = pruned(csr(of_v.Assemble().mat)), pruned(csr(of_a.Assemble().mat))
        self.h_values = self._local(self.points.values(scalar))
        mass = mass_matrix(self.h_values.matrix, self.points.weights)
        self.h_inverse = BlockInverse(mass)
        self.h_inverse.update(mass)
        self.h_inverse_matrix = self.h_inverse.matrix()
        self.size, self.h_count = size, scalar.ndof
        # rows cell by cell, the components of Hs after each other in a cell
        loads = sp.hstack([self.L_v, self.L_a], format="csr")
        inverse = sp.block_diag([self.h_inverse_matrix] * size, format="csr")
        order = np.arange(size * self.h_count).reshape(size, mesh.ne, -1).transpose(1, 0, 2).ravel()
        self.lift = LocalMatrix((inverse @ loads).tocsr()[order], mesh.ne)

    def lifted(self, x: np.ndarray) -> np.ndarray:
        """Hs of x = (v, a) side by side, (dim, .): coefficients (dim size, h_count)."""
        by_cells = self.lift(x).reshape(self.dim, self.step.mesh.ne, self.size, -1)
        return by_cells.swapaxes(1, 2).reshape(-1, self.h_count)

    def tested(self, loads: np.ndarray) -> np.ndarray:
        """Rows of (v, a) side by side of a stress's integrals against the functions of Hs."""
        by_components = loads.reshape(self.dim, self.size, self.step.mesh.ne, -1)
        return self.lift.test(by_components.swapaxes(1, 2).reshape(self.dim, -1))

    def set_local(self) -> None:
        """Hs, s, c_s, S and the jumps from v and a, into the state."""
        law, sides = self.law, self.sides
        x = np.concatenate([self.v, self.a], axis=1)
        self.hess[:] = self.lifted(x)
        self.j = sides.jump(x)
        if law.is_linear:
            self.stress[:] = (law.mu + law.mu_1) * self.hess
            self._loads = (law.mu + law.mu_1) * self.h_values.test(self.h_values(self.hess))
            self.stiffness = sides.penalty * (law.mu + law.mu_1)
            return
        at_points = self.h_values(self.hess)
        self.s[:] = self.s_inverse(self.s_values.test(np.einsum("bp,bp->p", at_points, at_points)))
        squares = np.einsum("ip,ip->p", self.j, self.j)
        size = sides.scalar(self.s) + squares / sides.h**2 + self.term.context.curvature.Get() ** 2
        slope = sides.penalty * law.slope(size)
        self.stiffness = sides.penalty * law.coefficient(size) + slope * squares / sides.h**2
        values = law.coefficient(self.s_values(self.s))
        self.c[:] = self.s_inverse(self.s_values.test(values) + sides.scalar.test(slope * squares))
        at_points *= self.s_values(self.c)
        self._loads = self.h_values.test(at_points)
        self.stress[:] = self.h_inverse(self._loads)

    def residual(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of v and of a, (dim, velocity's unknowns) and (dim, facets' unknowns)."""
        rows = self.tested(self._loads) + self.sides.jump.test(self.stiffness * self.j)
        return rows[:, : self.v.shape[1]], rows[:, self.v.shape[1] :]


def _divergence(X: CoefficientFunction, dim: int) -> CoefficientFunction:
    """div of the symmetric matrix with components X, length dim."""
    basis = hessian_basis(dim)
    size = basis.shape[1]
    matrix = np.zeros((dim, size * dim))
    for j in range(dim):
        for b in range(size):
            matrix[j, b * dim : (b + 1) * dim] = basis[j * dim : (j + 1) * dim, b]
    return CF(tuple(matrix.ravel()), dims=matrix.shape) * Grad(X).Reshape((size * dim,))

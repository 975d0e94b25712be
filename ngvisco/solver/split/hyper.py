"""The hyperviscosity with its local unknowns as functions of (v, a), by matrices.

Lifting and jump are linear in (v, a) and the same for every component of v; their matrices are assembled
once.  What is nonlinear is in scalars on cells (see ``ngvisco.forms.hyperviscosity``):

    Hs = lifting(v, a),  s = P |Hs|^2,  c_s = P c(s) + facets,  S = P (c_s Hs),

P the cellwise L2 projections.  The penalty's integrals over facets are NGSolve's, of the jump as a field
on each side of each facet; on curved cells, where it is no polynomial, of v and a themselves.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import (
    CF,
    L2,
    BilinearForm,
    CoefficientFunction,
    Discontinuous,
    FacetFESpace,
    Grad,
    GridFunction,
    LinearForm,
    NormalFacetFESpace,
    Periodic,
    TaskManager,
    VectorValued,
    grad,
)

from ngvisco.forms.hyperviscosity import Hyperviscosity
from ngvisco.forms.points import CellPoints, csr
from ngvisco.forms.spaces import Fields, contraction, hessian_basis
from ngvisco.forms.system import Step
from ngvisco.physics.tensors import inner
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.operators import apply, mass_matrix


class MatrixHyperviscosity:
    """Rows of v and a, and the element matrices' ingredients, of one step's hyperviscosity."""

    def __init__(self, step: Step, term: Hyperviscosity, points: CellPoints) -> None:
        self.step, self.term, self.law, self.points = step, term, term.law, points
        layout, self.dim = step.layout, step.mesh.dim
        k = layout.discretisation.k
        self.velocity = layout.scalar_velocity_space()
        normal_space = NormalFacetFESpace(step.mesh, order=k - 1)
        self.normal = Periodic(normal_space) if layout.periodic else normal_space
        state = step.state.vec.FV().NumPy()
        self.v = state[layout.ranges["v"]].reshape(self.dim, -1)
        start = layout.ranges["a_1"].start
        stop = layout.ranges[f"a_{self.dim}"].stop
        self.a = state[start:stop].reshape(self.dim, -1)
        self._lifting(k)
        self._jumps(k)
        self._scalars(k)

    def _lifting(self, k: int) -> None:
        """L_v, L_a with  mass Hs_i = L_v v_i + L_a a_i."""
        dim, n, facets = self.dim, self.term.context.normal, self.step.quadrature.facets
        scalar = L2(self.step.mesh, order=k - 2)
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
        with TaskManager():
            self.L_v, self.L_a = csr(of_v.Assemble().mat), csr(of_a.Assemble().mat)
        self.L_v_t, self.L_a_t = self.L_v.T.tocsr(), self.L_a.T.tocsr()
        self.h_values = self.points.values(scalar)
        self.h_test = (sp.diags(self.points.weights) @ self.h_values).T.tocsr()
        mass = mass_matrix(self.h_values, self.points.weights)
        self.h_inverse = BlockInverse(mass)
        self.h_inverse.update(mass)
        self.h_inverse_matrix = self.h_inverse.matrix()
        self.size, self.h_count = size, scalar.ndof

    def _jumps(self, k: int) -> None:
        """J_v, J_a with  j_i = J_v v_i + J_a a_i  on each side of each facet."""
        facets, n = self.step.quadrature.facets, self.term.context.normal
        sides = Discontinuous(FacetFESpace(self.step.mesh, order=k - 1))
        t, phi, b = sides.TestFunction(), self.velocity.TrialFunction(), self.normal.TrialFunction()
        of_v = BilinearForm(trialspace=self.velocity, testspace=sides)
        of_v += -(grad(phi) * n) * t * facets
        of_a = BilinearForm(trialspace=self.normal, testspace=sides)
        of_a += (b * n) * t * facets
        mass = BilinearForm(sides)
        mass += sides.TrialFunction() * t * facets
        with TaskManager():
            inverse = BlockInverse(csr(mass.Assemble().mat))
            inverse.update(csr(mass.mat))
            J_v, J_a = csr(of_v.Assemble().mat), csr(of_a.Assemble().mat)
        self.side_mass = csr(mass.mat)
        self.J_v, self.J_a = (inverse.matrix() @ J_v).tocsr(), (inverse.matrix() @ J_a).tocsr()
        self.J_v_t, self.J_a_t = self.J_v.T.tocsr(), self.J_a.T.tocsr()
        self.jump = GridFunction(VectorValued(sides, self.dim))
        self.j = self.jump.vec.FV().NumPy().reshape(self.dim, -1)

    def _scalars(self, k: int) -> None:
        """Forms of the penalty, and the projections of s and c_s."""
        layout, facets = self.step.layout, self.step.quadrature.facets
        state = self.step.state.vec.FV().NumPy()
        parts = dict(zip(layout.names, self.step.state.components, strict=True))
        curved = self.step.mesh.GetCurveOrder() > 1
        u = self.step.now if curved else SideFields(layout, parts, self.jump)
        stiffness, coupling = self.term.penalty(u)
        if coupling is not None:
            h = self.term.context.h
            stiffness = stiffness + coupling / (h * h)
            squares = layout.blocks["hess_square"]
            self.coupling = LinearForm(squares)
            self.coupling += coupling.Compile() * squares.TestFunction() * facets
            self.s = state[layout.ranges["hess_square"]]
            self.c = state[layout.ranges["hyper_coefficient"]]
            self.s_values = self.points.values(L2(self.step.mesh, order=2 * k - 4))
            self.s_test = (sp.diags(self.points.weights) @ self.s_values).T.tocsr()
            mass = mass_matrix(self.s_values, self.points.weights)
            self.s_inverse = BlockInverse(mass)
            self.s_inverse.update(mass)
        n = self.term.context.normal
        if curved:
            w, b = self.step.layout.blocks["v"].TestFunction(), self.normal.TestFunction()
            self._curved_v = LinearForm(self.step.layout.blocks["v"])
            self._curved_v += (-stiffness * inner(u.jump, Grad(w) * n)).Compile() * facets
            self._curved_a = []
            for i in range(self.dim):
                form = LinearForm(self.normal)
                form += (stiffness * u.jump[i] * (b * n)).Compile() * facets
                self._curved_a.append(form)
        else:
            tests = self.jump.space
            self.penalty = LinearForm(tests)
            self.penalty += (stiffness * inner(self.jump, tests.TestFunction())).Compile() * facets
        self.curved = curved
        self.hess = state[layout.ranges["hess"]].reshape(self.dim * self.size, -1)
        self.stress = state[layout.ranges["hyperstress"]].reshape(self.dim * self.size, -1)

    def set_local(self) -> None:
        """Hs, s, c_s, S and the jumps from v and a, into the state."""
        loads = apply(self.L_v, self.v) + apply(self.L_a, self.a)
        self.hess[:] = self.h_inverse(loads.reshape(self.dim * self.size, -1))
        self.j[:] = apply(self.J_v, self.v) + apply(self.J_a, self.a)
        law = self.law
        if law.is_linear:
            self.stress[:] = (law.mu + law.mu_1) * self.hess
            return
        at_points = apply(self.h_values, self.hess)
        self.s[:] = self.s_inverse(self.s_test @ np.einsum("bp,bp->p", at_points, at_points))
        self.coupling.Assemble()
        values = law.coefficient(self.s_values @ self.s)
        self.c[:] = self.s_inverse(self.s_test @ values + self.coupling.vec.FV().NumPy())
        at_points *= (self.s_values @ self.c)[None]
        self.stress[:] = self.h_inverse(apply(self.h_test, at_points))

    def residual(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of v and of a, (dim, velocity's unknowns) and (dim, facets' unknowns)."""
        stress = self.stress.reshape(self.dim, -1)
        rows_v, rows_a = apply(self.L_v_t, stress), apply(self.L_a_t, stress)
        if self.curved:
            self._curved_v.Assemble()
            rows_v += self._curved_v.vec.FV().NumPy().reshape(self.dim, -1)
            for form, row in zip(self._curved_a, rows_a, strict=True):
                form.Assemble()
                row += form.vec.FV().NumPy()
            return rows_v, rows_a
        self.penalty.Assemble()
        loads = self.penalty.vec.FV().NumPy().reshape(self.dim, -1)
        return rows_v + apply(self.J_v_t, loads), rows_a + apply(self.J_a_t, loads)

    def side_squares(self, j: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Means of j . other over the sides, (sides,); both are (dim, sides' coefficients)."""
        product = (j * (self.side_mass @ other.T).T).sum(axis=0)
        return product.reshape(len(self.areas), -1).sum(axis=1) / self.areas

    @cached_property
    def areas(self) -> np.ndarray:
        """Measure of every side of every cell, (sides,)."""
        one = GridFunction(self.jump.space.components[0])
        one.Set(1.0, dual=True)
        values = one.vec.FV().NumPy()
        return (values * (self.side_mass @ values)).reshape(-1, self.per_side).sum(axis=1)

    @property
    def per_side(self) -> int:
        return self.j.shape[1] // (self.step.mesh.ne * (self.dim + 1))

    def cell_means(self, values: np.ndarray) -> np.ndarray:
        """Means over the cells of values at the points."""
        weights = self.points.weights.reshape(self.step.mesh.ne, -1)
        return (values.reshape(weights.shape) * weights).sum(axis=1) / weights.sum(axis=1)

    def linearise(self) -> None:
        """Keep what ``derivative`` needs of the present state."""
        law, sides = self.law, self.dim + 1
        h = np.repeat(self.term.context.h.vec.FV().NumPy(), sides)
        self._at = apply(self.h_values, self.hess)
        self._j, self._h = self.j.copy(), h
        if law.is_linear:
            self._c = np.full(self.points.count, law.mu + law.mu_1)
            self._weight = law.penalty / h * (law.mu + law.mu_1)
            return
        s = self.s_values @ self.s
        self._c, self._slope = self.s_values @ self.c, law.slope(s)
        q = self.side_squares(self._j, self._j)
        size = np.repeat(self.cell_means(s), sides) + q / h**2 + self.term.context.curvature.Get() ** 2
        slope = law.slope(size)
        bend = 0.5 * (law.p - 4) * slope / size * q  # c'' |j|^2
        weight = law.penalty / h
        self._weight = weight * (law.coefficient(size) + slope * q / h**2)
        self._weight_s, self._weight_q = (
            weight * (slope + bend / h**2),
            weight * (2 * slope + bend / h**2) / h**2,
        )
        self._own_s, self._own_q = weight * bend, weight * (slope + bend / h**2)

    def derivative(self, dv: np.ndarray, da: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The rows' derivative in the direction (dv, da), with means over the sides in the penalty."""
        dim, sides = self.dim, self.dim + 1
        loads = apply(self.L_v, dv) + apply(self.L_a, da)
        hess = self.h_inverse(loads.reshape(dim * self.size, -1))
        dj = apply(self.J_v, dv) + apply(self.J_a, da)
        at = apply(self.h_values, hess)
        stress = self._c * at
        weighted = np.repeat(self._weight, self.per_side) * (self.side_mass @ dj.T).T
        if not self.law.is_linear:
            ds = 2 * np.einsum("bp,bp->p", self._at, at)
            dq = 2 * self.side_squares(self._j, dj)
            mean = np.repeat(self.cell_means(ds), sides)
            change = self._weight_s * mean + self._weight_q * dq
            weighted += np.repeat(change, self.per_side) * (self.side_mass @ self._j.T).T
            volume = self.points.weights.reshape(self.step.mesh.ne, -1).sum(axis=1)
            coupling = (self._own_s * mean + self._own_q * dq) * self.areas
            from_sides = coupling.reshape(-1, sides).sum(axis=1) / volume
            stress += self._at * (self._slope * ds + np.repeat(from_sides, self.points.per_cell))
        coefficients = self.h_inverse(apply(self.h_test, stress)).reshape(dim, -1)
        rows_v = apply(self.L_v_t, coefficients) + apply(self.J_v_t, weighted)
        rows_a = apply(self.L_a_t, coefficients) + apply(self.J_a_t, weighted)
        return rows_v, rows_a

    def hess_cells(self) -> np.ndarray:
        """The cell of every coefficient of a component of Hs."""
        return np.arange(self.h_count) // (self.h_count // self.step.mesh.ne)

    def sides(self) -> np.ndarray:
        """The side of every coefficient of a jump."""
        return np.arange(self.j.shape[1]) // self.per_side

    def tangent_coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Cellwise coefficients of |Hs|^2 and of the penalty in the tangent, (cells,) each."""
        law, cells = self.law, self.step.mesh.ne
        h = self.term.context.h.vec.FV().NumPy()
        if law.is_linear:
            c = np.full(cells, law.mu + law.mu_1)
            return c, np.repeat(law.penalty / h * c, self.dim + 1)
        s, c = (np.maximum(self.cell_means(self.s_values @ q), 0) for q in (self.s, self.c))
        sides = self.dim + 1
        size = np.repeat(s, sides) + self.side_squares(self.j, self.j) / np.repeat(h, sides) ** 2
        c_penalty = law.coefficient(size + self.term.context.curvature.Get() ** 2)
        stretch = 0.5 * law.p
        c, c_penalty = (law.mu_1 + stretch * (value - law.mu_1) for value in (c, c_penalty))
        return c, law.penalty / np.repeat(h, sides) * c_penalty


class SideFields(Fields):
    """Fields whose jump of the normal derivative is a field on the sides of facets."""

    def __init__(self, layout: Any, parts: dict[str, Any], jump: GridFunction) -> None:
        super().__init__(layout, parts)
        self.__dict__["jump"] = jump  # in place of the cached property


def _divergence(X: CoefficientFunction, dim: int) -> CoefficientFunction:
    """div of the symmetric matrix with components X, length dim."""
    basis = hessian_basis(dim)
    size = basis.shape[1]
    matrix = np.zeros((dim, size * dim))
    for j in range(dim):
        for b in range(size):
            matrix[j, b * dim : (b + 1) * dim] = basis[j * dim : (j + 1) * dim, b]
    return CF(tuple(matrix.ravel()), dims=matrix.shape) * Grad(X).Reshape((size * dim,))

"""Derivatives of a stage's equations, and of a combined end, by the states from which they start."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse.linalg as spl
from ngsolve import BilinearForm, GridFunction, Parameter

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.term import GivenParts
from ngvisco.physics.tensors import inner
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.trajectory import Stage


class Starts:
    """Products with the transpose of R_y, the derivative of a stage's equations by one of its start states y.

    R depends on sum w_k y_k, and on sum w_k rho_k v_k at the points.  The linearisation of a form with y_k as
    trial function and other states fixed is R_y.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, self.step = follower, follower.step
        layout, quadrature = self.step.layout, self.step.quadrature
        self.evolving = np.zeros(layout.space.ndof, dtype=bool)
        """Whether a step reads each coefficient of its start state, (unknowns,)."""
        for name in layout.evolving:
            self.evolving[layout.ranges[name]] = True
        self._weight = Parameter(1.0)
        self._others = GridFunction(layout.space)
        self._other_momentum = quadrature.vectors(self.step.mesh.dim)
        self._at = self.step.state.vec.CreateVector()
        self._product = self.step.state.vec.CreateVector()

    @cached_property
    def _form(self) -> BilinearForm:
        step, layout = self.step, self.step.layout
        trial = dict(zip(layout.names, layout.space.TrialFunction(), strict=True))
        components = dict(zip(layout.names, self._others.components, strict=True))
        parts = {name: components[name] + self._weight * trial[name] for name in layout.evolving}
        y = Fields(layout, trial)
        old = Fields(layout, GivenParts(parts, "it reads the old value of {name}, which does not evolve"))
        u = step.fields_from(old, self._other_momentum + self._weight * (y.rho * y.v))
        form, w = BilinearForm(layout.space), step.tests()
        for term in step.terms:
            step.quadrature.add(form, term.form(u, w))
        return form

    def transposed(self, stage: Stage, states: list[np.ndarray], number: int, rows: np.ndarray) -> np.ndarray:
        """Products R_y^T of each of ``rows``, (numbers, unknowns); y is the stage's start state of this
        ``number``.

        The stage has to be posed, with its solution as the present state.
        """
        weights, step = stage.starts, self.step
        fixed = [(w, y) for k, (w, y) in enumerate(zip(weights, states, strict=False)) if k != number]
        self._others.vec.FV().NumPy()[:] = sum((w * y for w, y in fixed), np.zeros(rows.shape[1]))
        self._weight.Set(float(weights[number]))
        self._state.vec.FV().NumPy()[:] = states[number]
        y = Fields.of(step.layout, self._state.components)
        self._momentum.Interpolate(y.rho * y.v)
        remaining = step.momentum_old.vec.FV().NumPy() - weights[number] * self._momentum.vec.FV().NumPy()
        self._other_momentum.vec.FV().NumPy()[:] = remaining
        self._form.AssembleLinearization(self._state.vec)
        return self._products(self._form, rows)

    def _products(self, form: BilinearForm, rows: np.ndarray) -> np.ndarray:
        """Products of the transposed linearisation with ``rows``, by the unknowns that a step reads."""
        result = np.zeros_like(rows)
        for product, weights in zip(result, rows, strict=True):
            self._at.FV().NumPy()[:] = weights
            self._product.data = form.mat.T * self._at
            product[:] = self._product.FV().NumPy()
        return np.where(self.evolving, result, 0.0)

    @cached_property
    def _state(self) -> GridFunction:
        return GridFunction(self.step.layout.space)

    @cached_property
    def _momentum(self) -> GridFunction:
        return self.step.quadrature.vectors(self.step.mesh.dim)

    def momentum_transposed(self, state: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Products of ``rows``, (numbers, unknowns), with the transposed derivative of int rho v . w by a
        state."""
        form = self.follower.momentum
        self._at.FV().NumPy()[:] = state
        form.AssembleLinearization(self._at)
        return self._products(form, rows)

    @cached_property
    def _functions(self) -> tuple[BilinearForm, np.ndarray]:
        """Equations of dependent unknowns, functions of other unknowns, and a mask of their coefficients."""
        step, layout = self.step, self.step.layout
        u, w = step.linearised_fields(layout.space.TrialFunction()), step.tests()
        form, dependent = BilinearForm(layout.space), np.zeros(layout.space.ndof, dtype=bool)
        for term in step.point_terms:
            for name, load in term.projections(u):
                form += step.quadrature.cells(inner(u.parts[name], w.parts[name]).Compile())
                step.quadrature.add(form, load(-1 * w.parts[name]))
                dependent[layout.ranges[name]] = True
        return form, dependent

    def through_functions(self, slope: np.ndarray) -> np.ndarray:
        """Slope by the independent unknowns, of which dependent ones are functions, at the present state."""
        form, dependent = self._functions
        if not slope[dependent].any():
            return slope
        form.AssembleLinearization(self.step.state.vec)
        rows = csr(form.mat)[dependent]
        multiplier = spl.splu(rows[:, dependent].T.tocsc()).solve(slope[dependent])
        result = slope - rows.T @ multiplier
        result[dependent] = 0.0
        return np.asarray(result)

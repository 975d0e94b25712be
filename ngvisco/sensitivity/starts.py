"""Derivatives of a stage's equations, and of a combined end, by the states from which they start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import cast

import numpy as np
import scipy.sparse.linalg as spl
from ngsolve import BaseVector, BilinearForm, Grad, GridFunction, Parameter

from ngvisco.forms.context import AskedContext, Context
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.term import GivenParts, Integrand
from ngvisco.physics.tensors import inner
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.variations import Slope, Variations

_READ = {"old", "momentum_old"}
"""Attributes of a context in which terms find the state from which a stage starts."""


class Starts:
    """Derivatives by one start state y of a stage, and products with R_y^T.

    The residual R of the stage depends on the start states y_k through sum w_k y_k, and through sum w_k rho_k
    v_k at the points.  With y_k as trial function and other states fixed, R . lambda is an integral with a
    slope by y_k.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, self.step = follower, follower.step
        layout, quadrature = self.step.layout, self.step.quadrature
        self.evolving = np.zeros(layout.space.ndof, dtype=bool)
        """Whether a step reads each coefficient of its start state, (unknowns,)."""
        for name in layout.evolving:
            self.evolving[layout.ranges[name]] = True
        self._weight = Parameter(1.0)
        self._others, self._state, self._multiplier = (GridFunction(layout.space) for _ in range(3))
        self._other_momentum, self._momentum = (quadrature.vectors(self.step.mesh.dim) for _ in range(2))
        self._at = self.step.state.vec.CreateVector()

    def fields(self) -> tuple[Fields, Callable[[], bool]]:
        """Fields of the present state in a step whose start state y_k is a trial function, and a function
        that tells whether the start was read."""
        step, layout = self.step, self.step.layout
        trial = dict(zip(layout.names, layout.space.TrialFunction(), strict=True))
        components, weight = dict(zip(layout.names, self._others.components, strict=True)), self._weight
        parts = {name: components[name] + weight * trial[name] for name in layout.evolving}
        old = Fields(
            layout,
            GivenParts(parts, "the term reads the old value of {name}, which does not evolve"),
            gradient=lambda name: Grad(components[name]) + weight * Grad(trial[name]),
        )
        y = Fields(layout, trial)
        u = step.fields_from(old, self._other_momentum + weight * (y.rho * y.v))
        context = AskedContext(u.context)
        return Fields(layout, u.parts, cast(Context, context)), lambda: not _READ.isdisjoint(context.names)

    @cached_property
    def variations(self) -> Variations:
        """Slopes of integrals by the start state."""
        return Variations(self.step, self.fields()[0], self._state.vec, self._weight)

    @cached_property
    def _slope(self) -> Slope:
        layout, integrands = self.step.layout, list[Integrand]()
        parts = dict(zip(layout.names, self._multiplier.components, strict=True))
        for term in self.step.terms:
            u, reads_start = self.fields()
            integrands += [part for part in term.form(u, Tests(layout, parts, u.context)) if reads_start()]
        return self.variations.of_sum(integrands)

    def put(self, weights: np.ndarray, states: Sequence[np.ndarray], number: int) -> None:
        """Choose the start state y by which derivatives are taken.

        ``number`` is the place of y among the start states ``states``, which have the weights ``weights``.

        The step has to start from the weighted sum of the states.
        """
        step = self.step
        fixed = [(w, y) for k, (w, y) in enumerate(zip(weights, states, strict=False)) if k != number]
        self._others.vec.FV().NumPy()[:] = sum((w * y for w, y in fixed), np.zeros(len(self.evolving)))
        self._weight.Set(float(weights[number]))
        self._state.vec.FV().NumPy()[:] = states[number]
        y = Fields.of(step.layout, self._state.components)
        self._momentum.Interpolate(y.rho * y.v)
        remaining = step.momentum_old.vec.FV().NumPy() - weights[number] * self._momentum.vec.FV().NumPy()
        self._other_momentum.vec.FV().NumPy()[:] = remaining

    def transposed(self, rows: np.ndarray) -> np.ndarray:
        """Products of R_y^T with each of ``rows``, (numbers, unknowns), for the y that ``put`` chose.

        Before the call the step has to be set up for the stage, with the stage's solution as the present
        state.
        """
        return self._products(self._multiplier.vec, self._slope, rows)

    def _products(self, at: BaseVector, product: Slope, rows: np.ndarray) -> np.ndarray:
        """Results of ``product`` after each of ``rows`` is copied to the vector ``at``; zero for unknowns of
        the start that a step does not read."""
        result = np.zeros_like(rows)
        for values, weights in zip(result, rows, strict=True):
            at.FV().NumPy()[:] = weights
            values[:] = product()
        return np.where(self.evolving, result, 0.0)

    def momentum_transposed(self, state: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Products of ``rows``, (numbers, unknowns), with the transposed derivative of int rho v . w by a
        state."""
        form = self.follower.momentum
        self._at.FV().NumPy()[:] = state
        form.AssembleLinearization(self._at)
        return self._products(self._at, lambda: (form.mat.T * self._at).Evaluate().FV().NumPy(), rows)

    @cached_property
    def _functions(self) -> tuple[BilinearForm, np.ndarray]:
        """Equations that determine the dependent unknowns from the other ones, and a mask of the coefficients
        of dependent unknowns."""
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
        """The slope by the independent unknowns, at the present state.

        ``slope`` is by all unknowns.  The result includes the change of dependent unknowns, which are
        functions of the independent unknowns.
        """
        form, dependent = self._functions
        if not slope[dependent].any():
            return slope
        form.AssembleLinearization(self.step.state.vec)
        rows = csr(form.mat)[dependent]
        result = slope - rows.T @ spl.splu(rows[:, dependent].T.tocsc()).solve(slope[dependent])
        result[dependent] = 0.0
        return np.asarray(result)

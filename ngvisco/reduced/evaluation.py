"""Terms of a step by arrays: their values at all points of a rule at once, and the rows that these make.

A term's ``cells`` and ``facets`` are evaluated with arrays in place of coefficient functions.  What they give
is linear in the tests; what multiplies each of these is tested with the functions of its space by the
matrices of ``Operators`` and ``SideOperators``.  With complex coefficients all values are complex, and the
imaginary parts of the rows are their derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, CoefficientFunction, GridFunction, specialcf

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import TabulatedRates
from ngvisco.forms.system import Step
from ngvisco.forms.term import PointTerm, Where
from ngvisco.forms.upwinding import Incoming, Upwinding
from ngvisco.physics.arrays import Array
from ngvisco.reduced.operators import Operators, SideOperators
from ngvisco.reduced.unknowns import derived_in_cells, in_cells
from ngvisco.reduced.values import (
    CELLS,
    FACETS,
    Coefficients,
    derivative_of,
    fields_of,
    incremented,
    on_sides,
    slots_of,
    tests_of,
)

Rows = dict[str, np.ndarray]
"""Rows of a residual by the tests' unknowns, in the same shapes."""


class CellContext:
    """What is known through a step at the points of the cells; the arrays' counterpart of ``Context``."""

    def __init__(self, step: Step, operators: Operators, rates: TabulatedRates) -> None:
        self._step, self._op, self.rates, self.terms = step, operators, rates, step.terms
        self.h = Array(np.repeat(step.context.h.vec.FV().NumPy(), operators.points.per_cell), None)
        # by the function itself and no longer than it lives: a term may make a new one at each evaluation
        self._averages = WeakKeyDictionary[CoefficientFunction, GridFunction]()
        self._given = WeakKeyDictionary[CoefficientFunction, GridFunction]()

    def start(self) -> None:
        """Evaluate what is known through the step: old fields, old momentum and averaged loads."""
        step, layout = self._step, self._step.layout
        state, old = step.state_old.vec.FV().NumPy(), {}
        for name in set(layout.evolving).intersection(in_cells(layout)):
            size = layout.unknowns[name].size
            of_name = state[layout.ranges[name]].copy()
            old[name] = of_name if size is None else of_name.reshape(size, -1)
        self.old = _in_cells(self._op, old, old, "of the old state", self)
        for value, function in self._averages.items():
            _put(function, step.context.average_now(value))
        for value, function in self._given.items():
            _put(function, value)

    @property
    def momentum_old(self) -> Array:
        """m_old, kg/(m^2 s); it is known at the points of the forms' rule only."""
        step, points = self._step, self._op.points
        if points.per_cell * step.mesh.dim * step.mesh.ne == step.momentum_old.space.ndof:
            return Array(points.read(step.momentum_old, step.mesh.dim), None)
        return self.old.rho * self.old.v  # of a coarser rule, for tangents only

    def rate(self, difference: Any) -> Any:
        """difference/tau, of numbers, arrays of values or linear forms."""
        return _rate(self._step, difference)

    def average(self, value: CoefficientFunction) -> Array:
        """The mean over the step of a scalar, a vector or a matrix, see ``Context.average``."""
        return self._read(self._averages, value, self._step.context.average_now)

    def given(self, value: CoefficientFunction) -> Array:
        """The same at the end of the step, see ``Context.given``."""
        return self._read(self._given, value, self._step.context.given)

    def _read(
        self,
        known: WeakKeyDictionary[CoefficientFunction, GridFunction],
        value: CoefficientFunction,
        made: Callable[[CoefficientFunction], CoefficientFunction],
    ) -> Array:
        if value not in known:
            known[value] = self._op.points.function(value.dim)
            _put(known[value], made(value))
        values = self._op.points.read(known[value], value.dim)
        return Array(values.reshape(*value.dims, -1), None)


def _put(function: GridFunction, value: CoefficientFunction) -> None:
    """Values at points; grid functions there have two components at least."""
    function.Interpolate(CF((value, 0.0)) if value.dim == 1 else value)


class SideContext:
    """What is known on the cells' sides."""

    def __init__(self, step: Step, operators: SideOperators) -> None:
        self._step, self._op, self._points = step, operators, operators.points
        self._given = WeakKeyDictionary[CoefficientFunction, Array]()
        self.normal = Array(operators.points.normals, None)
        self.inner, self.crossed = Array(operators.inner, None), Array(operators.crossed, None)
        self.rates = step.tabulated_rates
        self.h, self.terms = Array(operators.h, None), step.terms

    def rate(self, difference: Any) -> Any:
        """difference/tau."""
        return _rate(self._step, difference)

    def start(self) -> None:
        """Let what is given, and the side of upwinding, be that of the step."""
        self._given.clear()
        flux, wind = self._step.through, self._step.wind.vec.FV().NumPy()
        if flux is None:
            v = self._op.v(wind.reshape(self._step.mesh.dim, -1))
            through = (self._points.normals * v).sum(axis=0)
        else:
            through = self._through @ flux.function.vec.FV().NumPy()
        eta = self._step.context.eta.Get()
        self.upwinding = Upwinding(Array(through, None), self.crossed, eta, self._incoming())

    @cached_property
    def _through(self) -> sp.csr_matrix:
        """Takes what goes through facets to v* . n at the points."""
        assert self._step.through is not None
        space, n = self._step.through.function.space, specialcf.normal(self._step.mesh.dim)
        return self._points.operator(space, lambda v: v * n)

    def _incoming(self) -> Incoming | None:
        """What flows in through walls; None where nothing crosses them."""
        incoming = self._step.context.upwinding.incoming
        if incoming is None:
            return None
        parts = {}
        for name, value in incoming.parts.items():  # NGSolve has no vectors of one component, as z may be
            values = self.given(value).value
            parts[name] = Array(values.reshape(*self._step.layout.unknowns[name].shape, -1), None)
        return Incoming(self.given(incoming.where), parts)

    def given(self, value: CoefficientFunction) -> Array:
        """A scalar, a vector or a matrix at the end of the step, see ``Context.given``."""
        if value not in self._given:
            entries = [value[index] for index in np.ndindex(*value.dims)] if value.dims else [value]
            values = np.stack([self._points.sample(entry) for entry in entries])
            self._given[value] = Array(values.reshape(*value.dims, -1), None)
        return self._given[value]

    @property
    def curvature(self) -> float:
        """See ``Context.curvature``."""
        return self._step.context.curvature.Get()


class CellTerms:
    """Integrals over the cells."""

    def __init__(
        self, step: Step, operators: Operators, rates: TabulatedRates, place: Where = "cells"
    ) -> None:
        """``place`` is "cells" or "nodes": which of the terms' integrals over cells."""
        self.layout, self.op, self.place = step.layout, operators, place
        self.context = CellContext(step, operators, rates)
        self._tests = tests_of(step, True, self.context)

    def fields(self, c: Coefficients) -> Fields:
        """The unknowns with these coefficients at the points."""
        names = (*in_cells(self.layout), *derived_in_cells(self.layout))
        return _in_cells(self.op, c, names, CELLS, self.context)

    def slots(self, terms: Iterable[PointTerm], u: Fields) -> dict[str, np.ndarray]:
        """What multiplies each test and its gradient, (..., points)."""
        return slots_of([part for term in terms for part in getattr(term, self.place)(u, self._tests)])

    def derivatives(
        self, terms: Sequence[PointTerm], u: Fields, **along: np.ndarray
    ) -> dict[str, np.ndarray]:
        """The slots' derivatives, (..., k, points), in k directions of values as for ``incremented``."""
        parts = [
            {name: derivative_of(g, k) for name, g in self.slots(terms, changed).items()}
            for k, changed in incremented(u, **along)
        ]
        return {name: np.concatenate([part[name] for part in parts], axis=-2) for name in parts[0]}

    def rows(self, terms: Iterable[PointTerm], u: Fields) -> Rows:
        """Rows of the terms' integrals over the cells."""
        op, rows = self.op, Rows()
        found = self.slots(terms, u)
        for name in in_cells(self.layout):
            parts = []
            value, derivatives = op.of(name)
            if name in found:
                parts.append(value.test(_full(found[name], op.points.count)))
            if f"grad {name}" in found:
                gradient = _full(found[f"grad {name}"], op.points.count)
                for j, D in enumerate(derivatives):
                    parts.append(D.test(gradient[..., j, :]))
            if parts:
                rows[name] = sum(parts[1:], parts[0])
        return rows


class FacetTerms:
    """Integrals over both sides of all facets."""

    def __init__(self, step: Step, operators: SideOperators) -> None:
        self.layout, self.op = step.layout, operators
        self.context = SideContext(step, operators)
        self._tests, self._names = tests_of(step, False, self.context), (*on_sides(step), "zeta")

    def fields(self, c: Coefficients) -> Fields:
        """The unknowns with these coefficients on the sides."""
        names = (*self._names, *derived_in_cells(self.layout))
        makers = {name: partial(lambda name: self.op.of(name)(c[name]), name) for name in names}
        slopes = {"zeta": lambda: np.stack([D(c["zeta"]) for D in self.op.dz], axis=1)}
        return fields_of(self.layout, makers, slopes, FACETS, self.context)

    def slots(self, terms: Iterable[PointTerm], u: Fields) -> dict[str, np.ndarray]:
        """What multiplies each test, (..., points)."""
        return slots_of([part for term in terms for part in term.facets(u, self._tests)])

    def rows(self, terms: Iterable[PointTerm], u: Fields) -> Rows:
        """Rows of the terms' integrals over the facets, those of traces left out."""
        op = self.op
        values, found = {"v": op.v, "rho": op.z, "z": op.z}, self.slots(terms, u)
        return {
            name: space.test(_full(found[name], op.points.count))
            for name, space in values.items()
            if name in found
        }


def _in_cells(op: Operators, c: Coefficients, names: Iterable[str], place: str, context: Any) -> Fields:
    """Values and gradients of the unknowns ``names``; their coefficients are read when one is asked for."""

    def values(name: str) -> np.ndarray:
        return op.of(name)[0](c[name])

    def gradients(name: str) -> np.ndarray:
        rows = np.atleast_2d(c[name])
        return op.gradients(op.of(name)[1], rows).reshape(*c[name].shape[:-1], len(op.dv), -1)

    makers, slopes = ({name: partial(make, name) for name in names} for make in (values, gradients))
    return fields_of(op.layout, makers, slopes, place, context)


def _rate(step: Step, difference: Any) -> Any:
    """``Context.rate`` for arrays, also of a number."""
    known = Array.constant(difference) if isinstance(difference, (int, float)) else difference
    return step.context.rate(known)


def _full(values: np.ndarray, count: int) -> np.ndarray:
    """Values at all points, of values that may be the same at all."""
    return values if values.shape[-1] == count else np.broadcast_to(values, (*values.shape[:-1], count))

"""Evaluates a step's terms by arrays at all points of a quadrature rule, and integrates their rows.

A term's methods ``cells`` and ``facets`` get arrays in place of coefficient functions. The integrands are
linear in the tests. The factor of each test is integrated against the basis functions of the test's space, by
the matrices of ``Operators`` and ``SideOperators``. Complex coefficients give complex values: the imaginary
part of a row is the row's derivative along the imaginary part of the coefficients.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, TypeAlias, cast
from weakref import WeakKeyDictionary

import numpy as np
from ngsolve import CF, CoefficientFunction, GridFunction

from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.impulses import OnSides
from ngvisco.forms.rates import TabulatedRates
from ngvisco.forms.system import Step
from ngvisco.forms.term import PointRule, PointTerm
from ngvisco.physics.arrays import Array, ConstantInCells, Linear, factors_of_tests
from ngvisco.physics.recording import called, datum
from ngvisco.reduced.operators import Operators, PointOperators, SideOperators
from ngvisco.reduced.point_fields import CELLS, FACETS, Lazy, derivative_of, incremented, lazy_fields
from ngvisco.reduced.unknowns import derived_in_cells, in_cells
from ngvisco.threads import ALONE

Coefficients = Mapping[str, np.ndarray]
"""Coefficients of unknowns by name, (components, functions), or (functions,) for a scalar."""

Rows = dict[str, np.ndarray]
"""Rows of a residual by the name of the tested unknown, in the shapes of ``Coefficients``."""


def shapes_of(step: Step) -> dict[str, tuple[int, ...]]:
    """Shapes of the values of the unknowns that have tests, by name."""
    names = dict.fromkeys((*in_cells(step.layout), *on_sides(step)))
    return {name: step.layout.unknowns[name].shape for name in names if name != "zeta"}


def on_sides(step: Step) -> list[str]:
    """Names of the unknowns with tests on facets: v, the fields in cells, and means of both sides' fields."""
    means = (term.facet_mean for term in step.point_terms if term.facet_mean is not None)
    return ["v", *[name for name in ("rho", "rho_hat") if name in step.layout.unknowns], "z", *means]


def names_of(step: Step, inside: bool) -> tuple[list[str], list[str]]:
    """Two lists of names: of the unknowns with values at points, in cells or on sides, and of the unknowns
    with gradients there."""
    cells, derived = in_cells(step.layout), derived_in_cells(step.layout)
    names = [*(cells if inside else (*on_sides(step), "zeta")), *derived]
    return names, cells if inside else [name for name in ("rho", "z", "zeta") if name in names]


def tests_of(step: Step, inside: bool, context: Any) -> Fields:
    """Tests of the unknowns. Each test records its factor in an integrand.

    The tests are in cells if ``inside`` is True, otherwise on facets. Tests in cells also have gradients.
    Tests on facets include the tests of facet means.
    """
    shapes, d = shapes_of(step), step.mesh.dim
    names = [name for name in in_cells(step.layout) if name in shapes] if inside else on_sides(step)

    def value(name: str) -> Linear:
        return Linear(shapes[name], test=name)

    def gradient(name: str) -> Linear:
        return Linear((*shapes[name], d), test=f"grad {name}")

    sloping = gradient, names if inside else []
    return lazy_fields(Tests, step.layout, (value, names), sloping, CELLS if inside else FACETS, context)


def factors_of(parts: Sequence[Linear]) -> dict[str, np.ndarray]:
    """Factors of the tests in a sum of linear forms, (..., points), by the tests' names."""
    return factors_of_tests(sum(parts[1:], parts[0])) if parts else {}


class Sampled:
    """Values of a step's data at all points of a rule; each datum is sampled when it is first read."""

    def __init__(self, step: Step, operators: Operators) -> None:
        self._step, self._points, self.old = step, operators.points, dict[str, np.ndarray]()
        self._now: dict[str, Callable[[CoefficientFunction], CoefficientFunction]] = {
            "average": step.context.average_now,
            "given": lambda value: value,
        }
        # the keys are weak references to functions: a term may make a new function at each evaluation
        self._functions = {how: WeakKeyDictionary[CoefficientFunction, GridFunction]() for how in self._now}

    def start(self) -> None:
        """Evaluate the data that are constant during the step: old fields, averaged loads, given
        functions."""
        step, layout = self._step, self._step.layout
        state = step.state_old.vec.FV().NumPy()
        for name in set(layout.evolving).intersection(in_cells(layout)):
            size = layout.unknowns[name].size
            of_name = state[layout.ranges[name]].copy()
            self.old[name] = of_name if size is None else of_name.reshape(size, -1)
        for how, functions in self._functions.items():
            for value, function in functions.items():
                _put(function, self._now[how](value))

    @property
    def knows_momentum(self) -> bool:
        """Whether this rule is the rule of the forms. Only at its points is m_old known."""
        return self._points.count * self._step.mesh.dim == self._step.momentum_old.space.ndof

    def momentum_old(self) -> np.ndarray:
        """m_old, (dim, points), kg/(m^2 s)."""
        return self._points.read(self._step.momentum_old, self._step.mesh.dim)

    def of_old(self, name: str) -> np.ndarray:
        """Coefficients of an unknown in the old state, see ``Coefficients``."""
        return self.old[name]

    def values(self, how: str, value: CoefficientFunction) -> np.ndarray:
        """Values of a function at the points, (components, points).

        ``how`` is ``"average"`` or ``"given"``, see these methods of ``CellContext``."""
        functions = self._functions[how]
        with ALONE:
            if value not in functions:
                function = self._points.function(value.dim)
                _put(function, self._now[how](value))
                functions[value] = function
        return self._points.read(functions[value], value.dim)


class _PointContext:
    """The data of a step at the points of one rule; the counterpart of ``Context`` for arrays."""

    def __init__(self, step: Step, operators: PointOperators, rates: TabulatedRates) -> None:
        self._step, self._op, self.rates, self.terms = step, operators, rates, step.terms

    @property
    def h(self) -> Array:
        """Sizes of the points' cells, m."""
        return Array(datum(partial(getattr, self._op, "h"), id(self._op), "h"), None)

    def rate(self, difference: Any) -> Any:
        """Return difference/tau for a number, an array of values or a linear form."""
        is_number = isinstance(difference, (int, float))
        return self._step.context.rate(Array.constant(difference) if is_number else difference)

    def _here(self, values: np.ndarray, dims: Sequence[int]) -> Array:
        """Values at the points of this part, from ``values`` (components, points) at all points."""
        return Array(values[:, self._op.places].reshape(*dims, -1), None)


class CellContext(_PointContext):
    """The data of a step at the points of the cells.

    Values at points are not stored: each access to an old field evaluates it again.
    """

    def __init__(self, step: Step, operators: Operators, rates: TabulatedRates, sampled: Sampled) -> None:
        super().__init__(step, operators, rates)
        self.sampled, self.recovered_slopes = sampled, step.context.recovered_slopes

    @property
    def old(self) -> Fields:
        """The old state."""
        sampled = self.sampled
        old = {name: datum(partial(sampled.of_old, name), sampled, name) for name in sampled.old}
        return _fields(self._op, old, (old, old), "of the old state", self)

    @property
    def momentum_old(self) -> Array:
        """m_old, kg/(m^2 s)."""
        sampled = self.sampled
        if sampled.knows_momentum:
            momentum = datum(sampled.momentum_old, sampled, "momentum")
            return self._here(momentum, [len(momentum)])
        old = self.old  # this rule is coarser than that of the forms, and is used for tangents only
        return old.rho * old.v

    def average(self, value: CoefficientFunction) -> Array:
        """The mean over the step of a scalar, a vector or a matrix, see ``Context.average``."""
        return self._sampled("average", value)

    def given(self, value: CoefficientFunction) -> Array:
        """The value at the end of the step, see ``Context.given``."""
        return self._sampled("given", value)

    def _sampled(self, how: str, value: CoefficientFunction) -> Array:
        values = datum(partial(self.sampled.values, how, value), self.sampled, how, value)
        return self._here(values, value.dims)


def _put(function: GridFunction, value: CoefficientFunction) -> None:
    """Interpolate ``value`` at the points; a scalar gets a second component, which NGSolve requires."""
    function.Interpolate(CF((value, 0.0)) if value.dim == 1 else value)


Samples: TypeAlias = WeakKeyDictionary[CoefficientFunction, np.ndarray]
"""Values of functions at points, (components, points)."""


class SideContext(_PointContext):
    """The data of a step at the points of the cells' sides."""

    _op: SideOperators

    def __init__(self, step: Step, operators: SideOperators, samples: Samples) -> None:
        """``samples`` holds values of functions at the points of all sides, sampled once a step."""
        super().__init__(step, operators, step.tabulated_rates)
        self.samples, self.reach = samples, step.context.reach

    def start(self) -> None:
        """Forget the sampled functions of the last step."""
        self.samples.clear()

    def _of_sides(self, name: str) -> Array:
        """Values of an attribute of ``SideOperators``; within a program every access gives the same array."""
        return Array(datum(partial(getattr, self._op, name), id(self._op), name), None)

    @property
    def normal(self) -> Array:
        """See ``SideOperators``."""
        return self._of_sides("normals")

    @property
    def inner(self) -> Array:
        """See ``SideOperators``."""
        return self._of_sides("inner")

    @property
    def crossed(self) -> Array:
        """See ``SideOperators``."""
        return self._of_sides("crossed")

    def given(self, value: CoefficientFunction) -> Array:
        """The value of a scalar, a vector or a matrix at the end of the step, see ``Context.given``."""
        return self._here(datum(partial(self._sample, value), id(self.samples), value), value.dims)

    def _sample(self, value: CoefficientFunction) -> np.ndarray:
        """Values of a function at the points of all sides, (components, points)."""
        with ALONE:
            if value not in self.samples:
                entries = [value[index] for index in np.ndindex(*value.dims)] if value.dims else [value]
                self.samples[value] = np.stack([self._op.points.sample(entry) for entry in entries])
        return self.samples[value]

    @property
    def curvature(self) -> float:
        """The value of ``Context.curvature``."""
        return self._step.context.curvature.Get()


class _Terms:
    """Evaluates the terms' integrals over the cells, or over both sides of all facets.

    ``place`` is the name of the terms' method that returns the integrands.
    """

    op: Any
    context: Any
    place: PointRule | Literal["facets"]

    def _begin(self, step: Step, inside: bool) -> None:
        self.layout, self._step, self._inside = step.layout, step, inside
        self._tests, self._names = tests_of(step, inside, self.context), names_of(step, inside)

    @property
    def names(self) -> list[str]:
        """Names of the unknowns with values at the points."""
        return list(self._names[0])

    def fields(self, c: Coefficients) -> Fields:
        """The unknowns with the coefficients ``c`` at the points."""
        return _fields(self.op, c, self._names, CELLS if self._inside else FACETS, self.context)

    def factors(self, terms: Iterable[PointTerm], u: Fields) -> dict[str, np.ndarray]:
        """Factors of each test and of its gradient, summed over the terms, (..., points)."""
        # u may repeat the cells' points, once for each direction of an increment
        tests = tests_of(self._step, True, u.context) if self._inside else self._tests
        return factors_of([part for term in terms for part in getattr(term, self.place)(u, tests)])

    def loads(self, terms: Iterable[PointTerm], u: Fields) -> Rows:
        """Integrals of the terms against the basis functions of each cell, see ``LocalMatrix.loads``.

        Rows of unknowns on facets are left out.
        """
        rows = Rows()
        for name, values in self.factors(terms, u).items():
            unknown = name.removeprefix("grad ")
            if self.layout.unknowns[unknown].place == "facets":
                continue
            tested = [(self.op.of(unknown), values)]
            if unknown != name:
                tested = [(D, values[..., j, :]) for j, D in enumerate(self.op.slopes(unknown))]
            for operator, part in tested:
                load = called(operator.loads, self._full(part))
                rows[unknown] = rows[unknown] + load if unknown in rows else load
        return rows

    def _full(self, values: np.ndarray) -> np.ndarray:
        """Broadcast ``values``, which may be constant, to all points."""
        count = len(self.op.weights)
        return values if values.shape[-1] == count else np.broadcast_to(values, (*values.shape[:-1], count))

    def summed(self, loads: Rows) -> Rows:
        """Rows of all unknowns, assembled from the loads of all cells."""
        return {name: self.op.of(name).summed(values) for name, values in loads.items()}

    def rows(self, terms: Iterable[PointTerm], u: Fields) -> Rows:
        """Rows of the terms' integrals."""
        return self.summed(self.loads(terms, u))


class CellTerms(_Terms):
    """Evaluates the terms' integrals over the cells."""

    def __init__(
        self,
        step: Step,
        operators: Operators,
        rates: TabulatedRates,
        place: PointRule = "cells",
        sampled: Sampled | None = None,
    ) -> None:
        """``place`` is the name of the terms' method that returns integrands, "cells" or "collocated"."""
        self.op, self.place = operators, place
        self.context = CellContext(step, operators, rates, sampled or Sampled(step, operators))
        self._begin(step, True)

    def part(self, cells: slice) -> CellTerms:
        """The terms over the range ``cells`` only; ``summed`` and ``rows`` are for all cells."""
        operators, context = self.op.part(cells), self.context
        return CellTerms(self._step, operators, context.rates, self.place, context.sampled)

    def derivatives(
        self, terms: Sequence[PointTerm], u: Fields, **along: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Derivatives of ``factors`` in k directions, (..., k, points).

        ``along`` has the directions by the names of unknowns, as in ``incremented``."""
        parts = [
            {name: derivative_of(g, k) for name, g in self.factors(terms, changed).items()}
            for k, changed in incremented(u, **along)
        ]
        return {name: np.concatenate([part[name] for part in parts], axis=-2) for name in parts[0]}


class FacetTerms(_Terms):
    """Evaluates the terms' integrals over both sides of all facets."""

    place = "facets"

    def __init__(self, step: Step, operators: SideOperators, samples: Samples | None = None) -> None:
        self.op = operators
        self.context = SideContext(step, operators, Samples() if samples is None else samples)
        self._begin(step, False)

    def part(self, cells: slice) -> FacetTerms:
        """The terms over the sides of the range ``cells`` only. They give loads; ``summed`` and ``rows`` are
        for all cells."""
        return FacetTerms(self._step, self.op.part(cells), self.context.samples)

    def loads_by(self, integrands: OnSides, u: Fields) -> Rows:
        """Loads of v by the given integrands, under the integrands' names."""
        return {
            name: self.op.v.loads(self._full(factors_of(parts)["v"]))
            for name, parts in integrands(u, self._tests).items()
            if parts
        }

    def loads_of(self, term: PointTerm, name: str, u: Fields) -> np.ndarray:
        """Loads in the equation of the facet unknown ``name``, with this unknown set to zero.

        ``u`` keeps the values that are computed for this equation, so that other equations can use them.
        """
        shape, parts = self.layout.unknowns[name].shape, cast(Lazy, u.parts)
        parts[name] = Array(np.zeros((*shape, 1)), None)
        factors = self.factors([term], u)
        del parts[name]  # the next access reads the coefficients, which are known by then
        return called(self.op.of(name).loads, self._full(factors[name]))


def _fields(
    op: PointOperators, c: Coefficients, names: tuple[Iterable[str], Iterable[str]], place: str, context: Any
) -> Fields:
    """Unknowns at the points, see ``names_of``; values and gradients are computed at first access."""

    def value(name: str) -> Array:
        return Array(called(op.of(name), c[name]), None)

    def gradient(name: str) -> Array:
        slopes, of_name = op.slopes(name), c[name]
        if of_name.ndim == 2 and not np.iscomplexobj(of_name) and all(D.is_constant for D in slopes):
            by_cells = np.stack([called(D.of_nodes, of_name)[..., 0] for D in slopes], axis=1)
            return ConstantInCells(by_cells, op.z.per_cell)
        return Array(np.stack([called(D, of_name) for D in slopes], axis=-2), None)

    of_values, sloping = names
    return lazy_fields(Fields, op.layout, (value, of_values), (gradient, sloping), place, context)

"""Terms of a step by arrays: their values at all points of a rule at once, and the rows that these make.

A term's ``cells`` and ``facets`` are evaluated with arrays in place of coefficient functions.  What they give
is linear in the tests; what multiplies each of these is tested with the functions of its space by the
matrices of ``Operators`` and ``SideOperators``.  With complex coefficients all values are complex, and the
imaginary parts of the rows are their derivative.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, CoefficientFunction, GridFunction, specialcf

from ngvisco.errors import NgviscoError
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.rates import TabulatedRates
from ngvisco.forms.system import Step
from ngvisco.forms.term import PLACES, PointTerm, Where
from ngvisco.forms.upwinding import Incoming, SideMean, Upwinding
from ngvisco.physics.arrays import Array, Linear, slots
from ngvisco.physics.increments import TINY
from ngvisco.reduced.operators import Operators, SideOperators
from ngvisco.reduced.unknowns import derived_in_cells, in_cells

Coefficients = Mapping[str, np.ndarray]
"""Coefficients of unknowns by name, (components, functions); of scalars (functions,)."""

Rows = dict[str, np.ndarray]
"""Rows of a residual by the tests' unknowns, in the same shapes."""


TOGETHER = 8192
"""Points of all directions that are taken together: what is made of them stays in the processor's cache."""

_CELLS, _FACETS = "in cells", "on facets"


class NotAtPointsError(NgviscoError, LookupError):
    """A term asks for something that there is not at the points of a rule."""


class Lazy(Mapping[str, Any]):
    """Values by name that are made when they are asked for."""

    def __init__(self, make: Mapping[str, Callable[[], Any]], place: str) -> None:
        self._make, self._made, self._place = make, {}, place  # type: ignore[var-annotated]

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            if name not in self._make:
                raise NotAtPointsError(f"there is no {name} {self._place}")
            self._made[name] = self._make[name]()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make)

    def __len__(self) -> int:
        return len(self._make)


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
        self._tests = _tests(step, True, self.context)

    def fields(self, c: Coefficients) -> Fields:
        """The unknowns with these coefficients at the points."""
        names = (*in_cells(self.layout), *derived_in_cells(self.layout))
        return _in_cells(self.op, c, names, _CELLS, self.context)

    def slots(self, terms: Iterable[PointTerm], u: Fields) -> dict[str, np.ndarray]:
        """What multiplies each test and its gradient, (..., points)."""
        return _slots([part for term in terms for part in getattr(term, self.place)(u, self._tests)])

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
        self._tests, self._names = _tests(step, False, self.context), (*_on_sides(step), "zeta")

    def fields(self, c: Coefficients) -> Fields:
        """The unknowns with these coefficients on the sides."""
        names = (*self._names, *derived_in_cells(self.layout))
        makers = {name: partial(lambda name: self.op.of(name)(c[name]), name) for name in names}
        slopes = {"zeta": lambda: np.stack([D(c["zeta"]) for D in self.op.dz], axis=1)}
        return _fields(self.layout, makers, slopes, _FACETS, self.context)

    def slots(self, terms: Iterable[PointTerm], u: Fields) -> dict[str, np.ndarray]:
        """What multiplies each test, (..., points)."""
        return _slots([part for term in terms for part in term.facets(u, self._tests)])

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
    return _fields(op.layout, makers, slopes, place, context)


def with_values(u: Fields, grad_v: np.ndarray | None = None, **given: np.ndarray) -> Fields:
    """The same fields with other values of some unknowns, or of grad v."""
    parts = {name: Array(values, None) for name, values in given.items()}
    other = Fields(u.layout, ChainMap(parts, u.parts), u.context, u.gradient)  # type: ignore[arg-type]
    if grad_v is not None:
        other.__dict__["grad_v"] = Array(grad_v, None)
    return other


def incremented(u: Fields, **along: np.ndarray) -> Iterator[tuple[int, Fields]]:
    """``u`` with imaginary increments in directions, some at a time, which are counted.

    Each direction has the points for itself, all of the next one following: an operation on few points
    takes no longer on many.

    Parameters
    ----------
    along
        Directions (k, ..., points or 1), of unknowns by name or of ``grad_v``.
    """
    first = next(iter(along))
    points = getattr(u, first).value.shape[-1]
    size = max(1, TOGETHER // max(points, 1))
    for start in range(0, len(along[first]), size):
        changed = {}
        for name, directions in along.items():
            value, some = getattr(u, name).value, directions[start : start + size]
            each = value[..., None, :] + (TINY * 1j) * np.moveaxis(some, 0, -2)
            changed[name] = each.reshape(*value.shape[:-1], -1)
        yield len(some), with_values(u if len(some) == 1 else _repeated(u, len(some)), **changed)


def derivative_of(values: np.ndarray, directions: int) -> np.ndarray:
    """(..., directions, points) of what came of ``incremented`` fields."""
    return values.imag.reshape(*values.shape[:-1], directions, -1) / TINY


def _repeated(u: Fields, times: int) -> Fields:
    """The same fields, and what is known, at their points ``times`` times over."""

    def over(value: Array) -> Array:
        return value if value.value.shape[-1] == 1 else Array(np.tile(value.value, times), None)

    c = u.context
    known = {name: partial(lambda name: over(getattr(c, name)), name) for name in ("h", "momentum_old")}
    context: Any = _Known(
        known | {"old": lambda: _repeated(c.old, times)},
        rate=c.rate,
        rates=c.rates,
        terms=c.terms,
        average=lambda value: over(c.average(value)),
        given=lambda value: over(c.given(value)),
    )
    parts = Lazy({name: partial(lambda name: over(u.parts[name]), name) for name in u.parts}, _CELLS)
    return Fields(u.layout, parts, context, lambda name: over(u.gradient(name)))


class _Known(SimpleNamespace):
    """A context some of which is made where it is asked for."""

    def __init__(self, made: Mapping[str, Callable[[], Any]], **known: Any) -> None:
        super().__init__(_made=made, **known)

    def __getattr__(self, name: str) -> Any:
        value = self._made[name]()
        setattr(self, name, value)
        return value


def _fields(
    layout: Any, makers: Mapping[str, Any], gradients: Mapping[str, Any], place: str, context: Any
) -> Fields:
    def constant(make: Callable[[], np.ndarray]) -> Callable[[], Array]:
        return lambda: Array(make(), None)

    parts = Lazy({name: constant(make) for name, make in makers.items()}, place)
    slopes = Lazy({name: constant(make) for name, make in gradients.items()}, f"{place}, as a gradient")
    return Fields(layout, parts, context, lambda name: slopes[name])


def _shapes(step: Step) -> dict[str, tuple[int, ...]]:
    """Shapes of the values of the unknowns that have tests, by name."""
    names = dict.fromkeys((*in_cells(step.layout), *_on_sides(step)))
    return {name: step.layout.unknowns[name].shape for name in names if name != "zeta"}


def _on_sides(step: Step) -> list[str]:
    """Unknowns with tests on facets: of cells, and means of both sides."""
    means = (term.name for term in step.terms if isinstance(term, SideMean))
    density = [name for name in ("rho", "rho_hat") if name in step.layout.unknowns]
    return ["v", *density, "z", *means]


def _tests(step: Step, inside: bool, context: Any) -> Fields:
    """Tests that record what multiplies them: with gradients in cells, with those of traces on facets."""
    shapes, d = _shapes(step), step.mesh.dim
    place = _CELLS if inside else _FACETS
    names = [name for name in in_cells(step.layout) if name in shapes] if inside else _on_sides(step)
    parts = {name: partial(Linear, shapes[name], slot=name) for name in names}
    slopes = {
        name: partial(Linear, (*shapes[name], d), slot=f"grad {name}") for name in (names if inside else ())
    }
    gradients = Lazy(slopes, f"{place}, as a gradient")
    return Tests(step.layout, Lazy(parts, place), context, lambda name: gradients[name])


def _slots(parts: list[Linear]) -> dict[str, np.ndarray]:
    if not parts:
        return {}
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return slots(total)


def _rate(step: Step, difference: Any) -> Any:
    """``Context.rate`` for arrays, also of a number."""
    known = Array.constant(difference) if isinstance(difference, (int, float)) else difference
    return step.context.rate(known)


def _full(values: np.ndarray, count: int) -> np.ndarray:
    """Values at all points, of values that may be the same at all."""
    return values if values.shape[-1] == count else np.broadcast_to(values, (*values.shape[:-1], count))


def asked_slots(
    step: Step, term: PointTerm, rates: TabulatedRates, places: Collection[Where] = PLACES
) -> dict[str, bool]:
    """Names of the tests that a term has rows of at some places, and whether these rows read z or zeta.

    Found by evaluating it at one point with all values one, z and zeta complex.

    Raises
    ------
    NotAtPointsError
        When the term asks for something that arrays do not have.
    """
    d, shapes, derived = step.mesh.dim, _shapes(step), derived_in_cells(step.layout)
    shapes |= {name: step.layout.unknowns[name].shape for name in ("zeta", *derived)}

    def ones(shape: tuple[int, ...], dtype: type = float) -> Array:
        return Array(np.ones((*shape, 1), dtype), None)

    def fields(
        context: Any, names: Iterable[str], sloping: Iterable[str], place: str, state: type = complex
    ) -> Fields:
        dtypes = {"z": state, "zeta": state}
        parts = {name: partial(ones, shapes[name], dtypes.get(name, float)) for name in names}
        slopes = {name: partial(ones, (*shapes[name], d)) for name in sloping}
        gradients = Lazy(slopes, f"{place}, as a gradient")
        return Fields(step.layout, Lazy(parts, place), context, lambda name: gradients[name])

    inside = SimpleNamespace(
        momentum_old=ones((d,)),
        rate=lambda difference: difference,
        average=lambda value: ones(tuple(value.dims)),
        given=lambda value: ones(tuple(value.dims)),
        h=ones(()),
        rates=rates,
        terms=step.terms,
    )
    evolving, cells = set(step.layout.evolving).intersection(shapes), in_cells(step.layout)
    inside.old = fields(inside, evolving, evolving, _CELLS, float)
    side = SimpleNamespace(
        normal=ones((d,)),
        inner=ones(()),
        crossed=ones(()),
        upwinding=SimpleNamespace(share=ones(()), inflow=ones(())),
        rates=rates,
        h=ones(()),
        eta=1.0,
        curvature=1.0,
        rate=inside.rate,
        given=inside.given,
        terms=step.terms,
    )
    try:
        with np.errstate(all="ignore"):  # all values one need not be in a law's domain
            u, w = fields(inside, (*cells, *derived), cells, _CELLS), _tests(step, True, inside)
            inside_cells = (place for place in ("cells", "nodes") if place in places)
            found = _slots([part for place in inside_cells for part in getattr(term, place)(u, w)])
            if "facets" not in places:
                return {name: np.iscomplexobj(g) for name, g in found.items()}
            names = (*_on_sides(step), "zeta", *derived)
            u, w = fields(side, names, ["zeta"], _FACETS), _tests(step, False, side)
            u.__dict__["jump"] = ones((d,))
            found |= {name: g for name, g in _slots(list(term.facets(u, w))).items() if name not in found}
            return {name: np.iscomplexobj(g) for name, g in found.items()}
    except NotAtPointsError:
        raise
    except Exception as error:  # whatever a term raises at values that it does not know
        raise NotAtPointsError(f"it does not take arrays ({why(error)})") from error


def why(error: Exception) -> str:
    """One line on what a term or a law raised at arrays."""
    lines = str(error).splitlines() or [""]
    if "incompatible function arguments" in lines[0]:
        return "it combines values with a coefficient function of its own"
    return f"{type(error).__name__}: {lines[0]}"

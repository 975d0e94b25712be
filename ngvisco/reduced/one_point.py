"""Finds a term's rows, and the unknowns that they depend on, by evaluating the term at one point."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.term import PointTerm
from ngvisco.physics.arrays import TINY, Array
from ngvisco.reduced.evaluation import factors_of, names_of, shapes_of, tests_of
from ngvisco.reduced.point_fields import CELLS, FACETS, NotAtPointsError, lazy_fields
from ngvisco.reduced.unknowns import derived_in_cells


@dataclass(frozen=True)
class TermRows:
    """The rows of a term."""

    names: dict[str, bool]  # for each test, by name: whether its rows depend on z or zeta
    components: frozenset[int]  # numbers of the components of z that have rows
    collocated: bool  # whether a row is integrated by a collocated rule: one point per coefficient of a field


class OnePoint:
    """Evaluates terms at one point in a cell and one on a side, with all values near one."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self._shapes = shapes_of(step)
        derived = derived_in_cells(step.layout)
        self._shapes |= {name: step.layout.unknowns[name].shape for name in ("zeta", *derived)}

    def rows(self, term: PointTerm) -> TermRows:
        """Rows of a term; raises NotAtPointsError if the term asks for a value that arrays cannot give."""

        def marked(name: str, values: np.ndarray) -> np.ndarray:
            return values.astype(complex) if name in ("z", "zeta") else values

        rows, collocated = self._evaluated(term, marked)
        names, components = dict[str, bool](), set[int]()
        for name, g in rows:
            names[name] = names.get(name, False) or np.iscomplexobj(g)
            if name in ("z", "grad z"):
                components |= set(np.flatnonzero((g.reshape(len(g), -1) != 0).any(axis=1)).tolist())
        return TermRows(names, frozenset(components), collocated)

    def read(self, terms: Iterable[PointTerm], names: Iterable[str]) -> list[tuple[str, int]]:
        """Unknowns among ``names``, and their components, on which the terms' rows depend.

        A dependence through gradients counts too."""
        terms, shapes = list(terms), {name: self._shapes[name] or (1,) for name in names}
        parts = [(name, i) for name, shape in shapes.items() for i in range(shape[0])]
        return [(name, i) for name, i in parts if any(self._changes(term, name, i) for term in terms)]

    def _changes(self, term: PointTerm, unknown: str, component: int) -> bool:
        def increased(name: str, values: np.ndarray) -> np.ndarray:
            if name != unknown:
                return values
            values = values.astype(complex)
            np.atleast_2d(values)[component if self._shapes[name] else ...] += TINY * 1j
            return values

        rows, _ = self._evaluated(term, increased)
        return any((g.imag != 0).any() for _, g in rows)  # NaN counts as a dependence

    def _evaluated(
        self, term: PointTerm, along: Callable[[str, np.ndarray], np.ndarray]
    ) -> tuple[list[tuple[str, np.ndarray]], bool]:
        """Factors of the tests by name, in the cell and on the side; and whether the term has integrands for
        a collocated rule.

        ``along`` maps an unknown's name and its values, or its gradient, to the values to be used.
        """
        step = self.step
        d, layout, random = step.mesh.dim, step.layout, np.random.default_rng(0)

        def ones(*shape: int) -> np.ndarray:
            return 1.0 + 0.1 * random.random((*shape, 1))

        def datum(*shape: int) -> Array:
            return Array(ones(*shape), None)

        def fields(
            context: Any, names: tuple[Iterable[str], Iterable[str]], place: str, old: bool = False
        ) -> Fields:
            changed = (lambda name, values: values) if old else along

            def value(name: str) -> Array:
                return Array(changed(name, ones(*self._shapes[name])), None)

            def gradient(name: str) -> Array:
                return Array(changed(name, ones(*self._shapes[name], d)), None)

            return lazy_fields(Fields, layout, (value, names[0]), (gradient, names[1]), place, context)

        data = {
            "rate": lambda difference: difference,
            "given": lambda value: datum(*value.dims),
            "h": datum(),
            "rates": step.tabulated_rates,
            "terms": step.terms,
        }
        slope = step.context.recovered_slopes
        inside = SimpleNamespace(momentum_old=datum(d), average=data["given"], recovered_slopes=slope, **data)
        evolving = set(layout.evolving).intersection(self._shapes)
        inside.old = fields(inside, (evolving, evolving), CELLS, old=True)
        one = Array(np.ones(1), None)
        reach = step.context.reach
        side = SimpleNamespace(normal=datum(d), inner=one, crossed=one, curvature=1.0, reach=reach, **data)
        try:
            with np.errstate(all="ignore"):  # a law may not be defined at these values
                u, w = fields(inside, names_of(step, True), CELLS), tests_of(step, True, inside)
                in_all, collocated = list(term.cells(u, w)), list(term.collocated(u, w))
                u, w = fields(side, names_of(step, False), FACETS), tests_of(step, False, side)
                u.__dict__["jump"] = datum(d)
                factors = factors_of(in_all + collocated), factors_of(list(term.facets(u, w)))
                _require_dissipation(term, u)
                return [factor for part in factors for factor in part.items()], bool(factors_of(collocated))
        except NotAtPointsError:
            raise
        except Exception as error:  # a user's term may raise anything
            raise NotAtPointsError(f"the term cannot be evaluated with arrays ({why(error)})") from error


def _require_dissipation(term: PointTerm, u: Fields) -> None:
    """Raise NotAtPointsError unless a term's dissipation on facets maps names to arrays at points.

    A dissipation may read values that only forms have: the ledger then integrates it by its form.
    """
    try:
        of_names = dict(term.dissipated_on_facets(u))
    except NotAtPointsError:
        return
    except Exception as error:  # a user's term may raise anything
        raise NotAtPointsError(_DISSIPATED.format(why(error))) from error
    for name, power in of_names.items():
        if not isinstance(power, Array):
            raise NotAtPointsError(_DISSIPATED.format(f"{name!r} is of type {type(power).__name__}"))


_DISSIPATED = (
    "dissipated_on_facets(u) cannot be evaluated with arrays ({}); it has to return a mapping of names of "
    "ledger columns to functions of u, which may use only operations that arrays have"
)


def why(error: Exception) -> str:
    """One line that describes an error of a term or a law that was evaluated with arrays."""
    if isinstance(error, AttributeError) and isinstance(error.obj, SimpleNamespace):
        return f"there is no array of {error.name}"
    lines = str(error).splitlines() or [""]
    if "incompatible function arguments" in lines[0]:
        return "values are combined with another coefficient function"
    return f"{type(error).__name__}: {lines[0]}"

"""The energy of a state and the Bregman distance of two states, summed over the terms.

    B(a, b) = E(a) - E(b) - E'(b)[a - b] >= 0,    E(rho, m, z) = max_w <m, w> - 1/2 int rho |w|^2 + int phi(z)

(paper: Euler-ED-basic-convexity-calculus).  An implicit step from a to b dissipates B(a, b). The numerical
dissipation of every time scheme is a sum of such distances (``ngvisco.timestepping.integrator``).  A further
term with an evolving unknown adds its share of E.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add
from typing import cast

import numpy as np
from ngsolve import FESpace, GridFunction

from ngvisco.errors import ParameterError
from ngvisco.forms.entry_integrals import EntryIntegrals
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Evolved, Step
from ngvisco.forms.term import Entry, GivenParts, Integrand, Storing, Term, refused_by_name

ENERGIES = ("kinetic", "stored")
"""Ledger columns of the parts of the energy, J."""

NUMERICAL = ("inertial", "bregman")
"""Ledger columns of the numerical dissipation of each part of the energy, J a step."""

_METHODS = ("energy", "slope", "distance")


def storing(terms: Sequence[Term]) -> list[Storing]:
    """The terms that have a share of the energy.

    Raises ParameterError for a term with some, but not all, of the methods of ``Storing``: its energy would
    be lost.
    """
    storing: list[Storing] = []
    for term in terms:
        missing = [name for name in _METHODS if not hasattr(term, name)]
        if not missing:
            storing.append(cast(Storing, term))
        elif len(missing) < len(_METHODS):
            name = type(term).__name__
            expected = (
                f"a term that has all of the methods {', '.join(_METHODS)}, or none of them; this term lacks "
                f"{', '.join(missing)}"
            )
            raise ParameterError("Simulation.terms", name, expected)
    return storing


def energies(step: Step, u: Fields) -> dict[str, Integrand]:
    """Densities of the kinetic and the stored energy at ``u``, Pa in cells and N/m on walls."""
    return _by_columns(ENERGIES, [(term, term.energy(u)) for term in storing(step.terms)])


class BregmanDistance:
    """Bregman distance B(a, b) of states of one step, J, by the ledger's columns."""

    def __init__(self, step: Step) -> None:
        self.step, layout = step, step.layout
        space = FESpace([layout.blocks[name] for name in layout.evolving])
        self._states = [GridFunction(space) for _ in range(2)]
        ranges = (space.Range(i) for i in range(len(layout.evolving)))
        self._ranges = {name: slice(r.start, r.stop) for name, r in zip(layout.evolving, ranges, strict=True)}
        parts = [dict(zip(layout.evolving, state.components, strict=True)) for state in self._states]
        a, b = self.fields = tuple(Fields(layout, named) for named in parts)
        for u in self.fields:
            step.energy.follow(u)
        terms = storing(step.terms)
        parts_of = _by_columns(NUMERICAL, [(term, term.distance(a, b)) for term in terms])
        entries = {name: Entry(name, "numerical", part) for name, part in parts_of.items()}
        self._distance = EntryIntegrals(step.quadrature, entries)
        fault = "has a slope that reads the change of {name}, although a slope is taken at fixed momentum"
        moved = GivenParts({**parts[0]}, fault)
        del moved["v"]
        d, slopes = Fields(layout, moved), []
        for term in terms:
            with refused_by_name(term):
                slopes.append(term.slope(b, d))
        self._slope = EntryIntegrals(step.quadrature, {"slope": Entry("slope", "monitor", _sum(slopes))})

    def __call__(self, a: Evolved, b: Evolved) -> dict[str, float]:
        """Distance B(a, b) by ledger columns, J (per metre of thickness in plane strain)."""
        for i, state in enumerate((a, b)):
            self._put(i, state.values)
            self.step.energy.refresh(self.fields[i])
        return self._distance()

    def slope(self, b: Evolved, change: Mapping[str, np.ndarray]) -> float:
        """Derivative E'(b) at fixed m in the direction of a change of coefficients, by name, J."""
        self._put(0, change)
        self._put(1, b.values)
        self.step.energy.refresh(self.fields[1])
        return self._slope()["slope"]

    def _put(self, i: int, values: Mapping[str, np.ndarray]) -> None:
        array = self._states[i].vec.FV().NumPy()
        for name, of_name in values.items():
            array[self._ranges[name]] = of_name


def _by_columns(columns: Sequence[str], entries: Sequence[tuple[Storing, Entry]]) -> dict[str, Integrand]:
    """Sum of the entries' integrands in each column."""
    integrands: dict[str, list[Integrand]] = {name: [] for name in columns}
    for term, entry in entries:
        if entry.name not in integrands:
            expected = " or ".join(map(repr, columns))
            raise ParameterError(f"{type(term).__name__}: name of an entry", entry.name, expected)
        integrands[entry.name].append(entry.integrand)
    return {name: _sum(parts) for name, parts in integrands.items()}


def _sum(parts: Sequence[Integrand]) -> Integrand:
    cells = [part.cells for part in parts if part.cells is not None]
    facets = [part.facets for part in parts if part.facets is not None]
    return Integrand(reduce(add, cells) if cells else None, reduce(add, facets) if facets else None)

"""The rows of the residual term by term, by the terms' own forms.

What a term leaves of Newton's increment f, with slopes along f by central differences, is

    R_T(u - f) - R_T(u) + R_T'(u) f.

The sum over the terms is what the increment leaves of the residual R(u), if R' f = R.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from ngsolve import BaseVector, BilinearForm

from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand, PointTerm, named

_RELATIVE, _LARGEST = 1e-5, 1e-3
"""Change of the state over which a slope is taken, in its norm, and in units of f at most: rounding leaves
1e-11 of the rows, and a jump of upwinding, 1e-4 of the velocity wide, is resolved."""

LINEAR = "the linear system of the increment"
_NAMED, _COUNTS = 3, 0.2
"""Terms that are named, and the share of the largest from which one is."""


class TermRows:
    """Forms of the terms of a step, each under its name; in cells, and across facets."""

    def __init__(self, step: Step) -> None:
        trial, test = step.layout.space.TnT()
        u, w = step.layout.fields(trial), step.layout.fields(test)
        parts: dict[str, list[Integrand]] = defaultdict(list)
        for term in step.terms:
            if isinstance(term, PointTerm):
                parts[named(term)] += [Integrand(part) for part in term.cells(u, w)]
                across = [Integrand(facets=part) for part in term.facets(u, w)]
                parts[f"{named(term)} across facets"] += across
            else:
                parts[named(term)] += term.form(u, w)
        self.step = step
        self.forms = dict(self._forms(parts))

    def _forms(self, parts: dict[str, list[Integrand]]) -> Iterator[tuple[str, BilinearForm]]:
        for name, integrands in parts.items():
            if integrands:
                form = BilinearForm(self.step.layout.space, check_unused=False)
                self.step.quadrature.add(form, integrands)
                yield name, form

    def __call__(self, u: BaseVector) -> dict[str, BaseVector]:
        """Rows at u, which becomes the step's state; its local unknowns are taken as they are."""
        self.step.state.vec.data = u
        self.step.eliminate.refresh()
        rows = {}
        for name, form in self.forms.items():
            rows[name] = u.CreateVector()
            form.Apply(self.step.state.vec, rows[name])
        return rows

    def left_by(self, u: BaseVector, f: BaseVector, size: float) -> dict[str, BaseVector]:
        """What an increment f at u, of this size in its norm, leaves of the residual, by terms.

        Under the name ``LINEAR`` is R - R' f, which is zero where f is Newton's.  The step's state is then
        u - f with its local unknowns.
        """
        share = min(_LARGEST, _RELATIVE / size)
        at = u.CreateVector()
        before = self(u)
        at.data = u + share * f
        ahead = self(at)
        at.data = u - share * f
        behind = self(at)
        state = self.step.state.vec
        state.data = u - f
        self.step.eliminate()
        at.data = state
        left, rest = self(at), u.CreateVector()
        rest[:] = 0.0
        for name, rows in left.items():
            slope = ahead[name]
            slope.data = 0.5 / share * (slope - behind[name])
            rows.data += slope - before[name]
            rest.data += before[name] - slope
        return left | {LINEAR: rest}


def in_words(sizes: dict[str, float], before: float) -> str:
    """What the next increment comes from, the largest parts in words, in units of the increment before."""
    sizes = dict(sorted(sizes.items(), key=lambda item: -item[1]))
    largest = max(sizes.values(), default=0.0)
    if not largest > 0:
        return ""
    if largest == np.inf:
        names = [name for name, size in sizes.items() if size == np.inf]
        return f"not a number at the next iterate: {', '.join(names[:_NAMED])}"
    parts = [f"{name} ({size / before:.2g})" for name, size in sizes.items() if size >= _COUNTS * largest]
    return f"against it stand, in units of the smallest increment: {', '.join(parts[:_NAMED])}"

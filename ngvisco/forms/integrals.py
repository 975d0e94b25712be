"""Integrals of entries over cells and facets, compiled together."""

from collections.abc import Mapping

from ngsolve import CF

from ngvisco.forms.system import Step
from ngvisco.forms.term import Entry


class EntryIntegrals:
    """Integrals of entries at the present state of a step, compiled together."""

    def __init__(self, step: Step, entries: Mapping[str, Entry]) -> None:
        self.step = step
        cells = {name: e.integrand.cells for name, e in entries.items() if e.integrand.cells is not None}
        self._cell_names = list(cells)
        self._cells = CF((*cells.values(), 0.0, 0.0)).Compile()  # a vector, however few there are
        facets = {name: e.integrand.facets for name, e in entries.items() if e.integrand.facets is not None}
        self._facets = {name: integrand.Compile() for name, integrand in facets.items()}
        self._evaluated = {name: e.evaluate for name, e in entries.items() if e.evaluate is not None}

    def __call__(self) -> dict[str, float]:
        quadrature = self.step.quadrature
        totals = quadrature.integrate_cells(self._cells)
        values = {name: float(t) for name, t in zip(self._cell_names, totals, strict=False)}
        for name, integrand in self._facets.items():
            values[name] = values.get(name, 0.0) + quadrature.integrate_facets(integrand)
        return values | {name: evaluate() for name, evaluate in self._evaluated.items()}

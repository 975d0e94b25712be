"""The Bregman distance of the energy between two states, by the terms that have a share of it.

    B(a, b) = E(a) - E(b) - E'(b)[a - b] >= 0,    E(rho, m, z) = max_w <m, w> - 1/2 int rho |w|^2 + int phi(z)

(paper: Euler-ED-basic-convexity-calculus): what an implicit step from a to b dissipates, and what the
numerical dissipation of every time scheme is summed of (``ngvisco.timestepping.integrator``).
"""

from __future__ import annotations

from ngsolve import CF, FESpace, GridFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Evolved, Step
from ngvisco.forms.term import Storing

_EVOLVED = ("v", "rho", "z")


class BregmanDistance:
    """B(a, b) of states of one step, J, split into the ledger's entries."""

    def __init__(self, step: Step) -> None:
        self.step = step
        space = FESpace([step.layout.blocks[name] for name in _EVOLVED])
        self._states = [GridFunction(space) for _ in range(2)]
        self._ranges = [slice(space.Range(i).start, space.Range(i).stop) for i in range(len(_EVOLVED))]
        self.fields = tuple(
            Fields(step.layout, dict(zip(_EVOLVED, state.components, strict=True))) for state in self._states
        )
        for u in self.fields:
            step.energy.follow(u)
        entries = [term.distance(*self.fields) for term in step.terms if isinstance(term, Storing)]
        self.names = tuple(entry.name for entry in entries)
        self._integrand = CF(tuple(entry.integrand.cells for entry in entries)).Compile()

    def __call__(self, a: Evolved, b: Evolved) -> dict[str, float]:
        """B(a, b) by ledger columns, J (per metre of thickness in plane strain)."""
        for state, fields, values in zip(self._states, self.fields, (a, b), strict=True):
            array = state.vec.FV().NumPy()
            for name, where in zip(_EVOLVED, self._ranges, strict=True):
                array[where] = getattr(values, name)
            self.step.energy.refresh(fields)
        totals = self.step.quadrature.integrate_cells(self._integrand)
        return {name: float(total) for name, total in zip(self.names, totals, strict=True)}

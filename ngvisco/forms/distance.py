"""The Bregman distance of the energy between two states, by the terms that have a share of it.

    B(a, b) = E(a) - E(b) - E'(b)[a - b] >= 0,    E(rho, m, z) = max_w <m, w> - 1/2 int rho |w|^2 + int phi(z)

(paper: Euler-ED-basic-convexity-calculus): what an implicit step from a to b dissipates, and what the
numerical dissipation of every time scheme is summed of (``ngvisco.timestepping.integrator``).
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF, FESpace, GridFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Evolved, Step
from ngvisco.forms.term import Storing
from ngvisco.physics.tensors import inner, square

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
        a, b = self.fields
        self._slope = CF((-0.5 * a.rho * square(b.v), inner(step.energy.slope(b), a.z))).Compile()

    def __call__(self, a: Evolved, b: Evolved) -> dict[str, float]:
        """B(a, b) by ledger columns, J (per metre of thickness in plane strain)."""
        for i, values in enumerate((a, b)):
            self._put(i, v=values.v, rho=values.rho, z=values.z)
            self.step.energy.refresh(self.fields[i])
        totals = self.step.quadrature.integrate_cells(self._integrand)
        return {name: float(total) for name, total in zip(self.names, totals, strict=True)}

    def slope(self, b: Evolved, rho: np.ndarray, z: np.ndarray) -> float:
        """E'(b) in the direction of coefficients (rho, z) with m kept, J.

        int phi'(z_b):z - 1/2 rho |v_b|^2.
        """
        self._put(0, rho=rho, z=z)
        self._put(1, v=b.v, rho=b.rho, z=b.z)
        self.step.energy.refresh(self.fields[1])
        return float(sum(self.step.quadrature.integrate_cells(self._slope)))

    def _put(self, i: int, **values: np.ndarray) -> None:
        array = self._states[i].vec.FV().NumPy()
        for name, where in zip(_EVOLVED, self._ranges, strict=True):
            if name in values:
                array[where] = values[name]

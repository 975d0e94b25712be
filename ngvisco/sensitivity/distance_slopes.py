"""Slopes of the scheme's dissipation, a sum of Bregman distances B(a, b), by the states a and b."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from ngsolve import GridFunction

from ngvisco.forms.distance import NUMERICAL, storing
from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Integrand
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.variations import Slope, Variations


class DistanceSlopes:
    """Slopes of the parts of B(a, b) by the coefficients of a and of b."""

    def __init__(self, follower: Follower) -> None:
        self.follower, self.step = follower, follower.step
        layout = self.step.layout
        self._states = [GridFunction(layout.space) for _ in range(2)]
        self._fields = [Fields.of(layout, state.components) for state in self._states]
        for u in self._fields:
            self.step.energy.follow(u)
        self._slopes = [self._by(0), self._by(1)]

    def _by(self, number: int) -> dict[str, Slope]:
        """Slopes of the parts of B(a, b) by a (``number`` 0) or by b (1), by the names of the ledger's
        columns."""
        step, variations = self.step, Variations(self.step, at=self._states[number].vec)
        fields = list(self._fields)
        fields[number] = Fields(step.layout, variations.trial.parts)
        context = copy.copy(step.layout.context)
        context.energy = _Differentiable(step.energy, self._fields)  # type: ignore[assignment]
        a, b = (Fields(step.layout, u.parts, context) for u in fields)
        context.energy.known |= {a: fields[0], b: fields[1]}  # type: ignore[attr-defined]
        parts: dict[str, list[Integrand]] = {name: [] for name in NUMERICAL}
        for term in storing(step.terms):
            entry = term.distance(a, b)
            parts[entry.name].append(entry.integrand)
        return {name: variations.of_sum(integrands) for name, integrands in parts.items()}

    def __call__(self, name: str, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes of a column by a and by b, (unknowns,) each. The call overwrites the present state."""
        for state, values, u in zip(self._states, (a, b), self._fields, strict=True):
            state.vec.FV().NumPy()[:] = values
            self.step.energy.refresh(u)
        slopes = []
        for values, of_columns in zip((a, b), self._slopes, strict=True):
            self.follower.state[:] = values
            self.step.local_unknowns.update_energy()
            slopes.append(of_columns[name]())
        return slopes[0], slopes[1]


class _Differentiable:
    """The energy of a step for states that contain trial functions: the values are those of the known state,
    with the energy's derivative by the trial functions."""

    def __init__(self, energy: StoredEnergy, followed: list[Fields]) -> None:
        self._energy, self._followed, self.known = energy, followed, dict[Fields, Fields]()

    def density(self, u: Fields) -> Any:
        known = self.known[u]
        return self._energy.density(known) if known in self._followed else self._energy.near(known)

    def slope(self, u: Fields) -> Any:
        return self._energy.slope(self.known[u])

"""The start value of a step: the state extrapolated in time through the last two solutions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from ngsolve import BaseVector

from ngvisco.forms.context import StepLayout
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.reduced.unknowns import Unknowns

FARTHEST = 3.0
"""Largest ratio of two times: from the last solution to the step's end, and between the two solutions."""

LARGEST_CHANGE = 0.5
"""Largest relative change of density and elastic variables by extrapolation; the bound keeps the variables in
the domain of the energy."""


class KeptState:
    """Coefficients of some unknowns of a state, by name; NumPy converts a kept state to an array of the whole
    state. The other unknowns are functions of the kept ones, and have the coefficients 0 in the array.
    """

    def __init__(self, layout: StepLayout, values: Mapping[str, np.ndarray]) -> None:
        """Copy the unknowns' coefficients."""
        self._layout, self._values = layout, {name: part.copy() for name, part in values.items()}

    @classmethod
    def of(cls, layout: StepLayout, state: np.ndarray, names: Iterable[str]) -> KeptState:
        """Keep the unknowns ``names`` of ``state``, an array of all unknowns."""
        return cls(layout, {name: state[layout.ranges[name]] for name in names})

    def __getitem__(self, name: str) -> np.ndarray:
        return self._values[name]

    def put(self, state: np.ndarray) -> None:
        """Set the kept unknowns of ``state``, an array of all unknowns."""
        for name, values in self._values.items():
            state[self._layout.ranges[name]] = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        whole = np.zeros(self._layout.space.ndof, dtype)
        self.put(whole)
        return whole


class Extrapolation:
    """Keeps the last two solutions, which a checkpoint stores, and extrapolates them.

    Only the unknowns on which the split solver iterates are kept.
    """

    def __init__(self, step: Step) -> None:
        self.step, self._ranks = step, Communicator.of(step.mesh)
        self._kept: list[tuple[float, KeptState]] = []
        """Times, s, and coefficients of the solutions; the coefficients are not written to."""
        self._names = Unknowns(step).names

    @property
    def is_empty(self) -> bool:
        """Whether no solution is known."""
        return not self._kept

    def keep(self, time: float) -> None:
        """Keep ``step.state`` as the solution at ``time``, s."""
        state = self.step.state.vec.FV().NumPy()
        self._kept = [*self._kept[-1:], (time, KeptState.of(self.step.layout, state, self._names))]

    def drop(self) -> None:
        """Forget the kept solutions, because the next state will not follow from them."""
        self._kept.clear()

    def guess(self, time: float) -> BaseVector | None:
        """The state extrapolated to ``time``, s, or None.

        None if ``time`` is too far from the last solution, if fewer than two solutions are kept, or if an
        evolving unknown other than v would change by more than ``LARGEST_CHANGE`` relative to its size.
        Unknowns that are not kept have their present values."""
        if len(self._kept) < 2:
            return None
        (earlier, before), (last, now) = self._kept
        # the stages of a tableau may go backward in time
        if last <= earlier or not 0 < (reach := (time - last) / (last - earlier)) <= FARTHEST:
            return None
        guess, ranges = self.step.state.vec.Copy(), self.step.layout.ranges
        values = guess.FV().NumPy()
        for name in self._names:
            change = reach * (now[name] - before[name])
            values[ranges[name]] = now[name] + change
            if name not in self.step.layout.evolving:
                continue
            size, change_of = (self._ranks.most(abs(u).max(initial=0.0)) for u in (now[name], change))
            if not change_of < LARGEST_CHANGE * size and name != "v":
                return None
        return guess

    def state_dict(self) -> tuple[dict[str, float], dict[str, Any]]:
        """Numbers and states that a checkpoint stores; the states are not copies."""
        kept = list(zip(("earlier", "last"), self._kept, strict=False))
        return {f"{name}_time": t for name, (t, _) in kept}, {name: u for name, (_, u) in kept}

    def load_state_dict(self, numbers: dict[str, float], states: dict[str, Any]) -> None:
        """Restore the data of ``state_dict``, or arrays of whole states."""
        self._kept = [
            (numbers[f"{which}_time"], KeptState.of(self.step.layout, np.asarray(states[which]), self._names))
            for which in ("earlier", "last")
            if which in states
        ]

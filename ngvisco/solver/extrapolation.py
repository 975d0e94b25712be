"""Extrapolation in time through the last two solutions: of start values, and of the velocity alone."""

from __future__ import annotations

import numpy as np
from ngsolve import BaseVector

from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator

FARTHEST = 3.0
"""Distance of the step's end from the last solution, in units of that between the two."""

LARGEST_CHANGE = 0.5
"""Of density and elastic variables, in units of their size: to stay in the energy's domain."""


class Extrapolation:
    """Keeps the last two solutions; part of what a restart has to know."""

    def __init__(self, step: Step) -> None:
        self.step, self._ranks = step, Communicator.of(step.mesh)
        self._times: list[float] = []
        self._states = [np.empty(len(step.state.vec)) for _ in range(2)]

    @property
    def is_empty(self) -> bool:
        """Whether no solution is known."""
        return not self._times

    def keep(self, time: float) -> None:
        """``step.state`` is the solution at ``time``, s."""
        if len(self._times) == 2:
            self._times.pop(0)
            self._states.reverse()
        self._states[len(self._times)][:] = self.step.state.vec.FV().NumPy()
        self._times.append(time)

    def drop(self) -> None:
        """Forget: the states at hand do not follow from each other."""
        self._times.clear()

    def _reach(self, time: float) -> float | None:
        """Distance of ``time`` from the last solution in units of the time between the two; None where it is
        too far, or nothing is known to extrapolate from."""
        if len(self._times) < 2:
            return None
        earlier, last = self._times
        if last <= earlier:  # stages of a tableau need not go forward in time
            return None
        reach = (time - last) / (last - earlier)
        return reach if 0 < reach <= FARTHEST else None

    def velocity(self, time: float) -> np.ndarray | None:
        """Coefficients of v extrapolated to ``time``, s; None if there is nothing to do so from."""
        reach, v = self._reach(time), self.step.layout.ranges["v"]
        if reach is None:
            return None
        earlier, last = (state[v] for state in self._states)
        return last + reach * (last - earlier)

    def guess(self, time: float) -> BaseVector | None:
        """The state extrapolated to ``time``, s; None if there is nothing to do so from, or it would change
        what evolves, but for v, by more than ``LARGEST_CHANGE`` of their size."""
        reach = self._reach(time)
        if reach is None:
            return None
        change = reach * (self._states[1] - self._states[0])
        for name in self.step.layout.evolving:
            if name == "v":
                continue
            where = self.step.layout.ranges[name]
            size, change_of = (
                self._ranks.most(abs(values[where]).max(initial=0.0)) for values in (self._states[1], change)
            )
            if not change_of < LARGEST_CHANGE * size:
                return None
        guess = self.step.state.vec.CreateVector()
        guess.FV().NumPy()[:] = self._states[1] + change
        return guess

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays for a restart."""
        kept = list(zip(("earlier", "last"), self._times, self._states, strict=False))
        return {f"{name}_time": t for name, t, _ in kept}, {name: state.copy() for name, _, state in kept}

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``state_dict`` gave."""
        self._times = []
        for i, name in enumerate(("earlier", "last")):
            if name in arrays:
                self._times.append(numbers[f"{name}_time"])
                self._states[i][:] = arrays[name]

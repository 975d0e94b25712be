"""Start values by extrapolation in time through the last two solutions."""

from __future__ import annotations

import numpy as np
from ngsolve import BaseVector

from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator


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

    def guess(self, time: float, farthest: float, largest_change: float) -> BaseVector | None:
        """The state extrapolated to ``time``, s; None if there is nothing to do so from.

        It is not farther from the last solution than ``farthest``, in units of the time between the two, and
        changes what evolves, but for the velocity, by less than ``largest_change``, in units of their size.
        """
        if len(self._times) < 2:
            return None
        earlier, last = self._times
        if last <= earlier:  # stages of a tableau need not go forward in time
            return None
        reach = (time - last) / (last - earlier)
        if not 0 < reach <= farthest:
            return None
        change = reach * (self._states[1] - self._states[0])
        for name in self.step.layout.evolving:
            if name == "v":
                continue
            where = self.step.layout.ranges[name]
            size, change_of = (
                self._ranks.most(abs(values[where]).max(initial=0.0)) for values in (self._states[1], change)
            )
            if not change_of < largest_change * size:
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

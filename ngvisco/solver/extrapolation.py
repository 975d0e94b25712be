"""Start values by extrapolation in time through the last two solutions."""

from __future__ import annotations

import numpy as np

from ngvisco.forms.system import Step

FARTHEST = 3.0
"""Distance of the extrapolated time from the last solution, in units of that between the last two."""


class Extrapolation:
    """Keeps the last two solutions; part of what a restart has to know."""

    def __init__(self, step: Step) -> None:
        self.step = step
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

    def start(self, time: float) -> bool:
        """Make ``step.state`` a value extrapolated to ``time``; False if there is nothing to do so from.

        Densities and elastic variables that would lose half of their size or more are not extrapolated: the
        start value is to stay in the energy's domain.
        """
        if len(self._times) < 2:
            return False
        (earlier, last), ranges = self._times, self.step.layout.ranges
        if last <= earlier:  # stages of a tableau need not go forward in time
            return False
        reach = (time - last) / (last - earlier)
        if not 0 < reach <= FARTHEST:
            return False
        change = reach * (self._states[1] - self._states[0])
        for name in ("rho", "z"):
            where = ranges[name]
            size = abs(self._states[1][where]).max(initial=0.0)
            if not abs(change[where]).max(initial=0.0) < 0.5 * size:
                return False
        self.step.state.vec.FV().NumPy()[:] = self._states[1] + change
        return True

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays for a restart."""
        kept = list(zip(("earlier", "last"), self._times, self._states, strict=False))
        return {f"{name}_time": t for name, t, _ in kept}, {name: state.copy() for name, _, state in kept}

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``memory`` gave."""
        self._times = []
        for i, name in enumerate(("earlier", "last")):
            if name in arrays:
                self._times.append(numbers[f"{name}_time"])
                self._states[i][:] = arrays[name]

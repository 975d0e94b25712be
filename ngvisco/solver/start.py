"""The start value of a step: the state extrapolated in time through the last two solutions."""

from __future__ import annotations

import numpy as np
from ngsolve import BaseVector

from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator

FARTHEST = 3.0
"""Largest time from the last solution to the step's end, relative to the time between the two solutions."""

LARGEST_CHANGE = 0.5
"""Largest relative change of density and elastic variables: it keeps them in the energy's domain."""


class Extrapolation:
    """Keeps the last two solutions, which a checkpoint stores, and extrapolates them."""

    def __init__(self, step: Step) -> None:
        self.step, self._ranks = step, Communicator.of(step.mesh)
        self._kept: list[tuple[float, np.ndarray]] = []
        """Times, s, and coefficients of the solutions; the arrays are not written to."""

    @property
    def is_empty(self) -> bool:
        """Whether no solution is known."""
        return not self._kept

    def keep(self, time: float) -> None:
        """Keep ``step.state`` as the solution at ``time``, s."""
        self._kept = [*self._kept[-1:], (time, self.step.state.vec.FV().NumPy().copy())]

    def drop(self) -> None:
        """Forget the kept solutions, as the next state will not follow from them."""
        self._kept.clear()

    def guess(self, time: float) -> BaseVector | None:
        """The state extrapolated to ``time``, s, or None.

        None if fewer than two solutions are kept, if ``time`` is too far from the last one, or if an evolving
        unknown other than v would change by more than ``LARGEST_CHANGE`` relative to its size."""
        if len(self._kept) < 2:
            return None
        (earlier, before), (last, now) = self._kept
        # stages of a tableau need not go forward in time
        if last <= earlier or not 0 < (reach := (time - last) / (last - earlier)) <= FARTHEST:
            return None
        change = reach * (now - before)
        for name in self.step.layout.evolving:
            where = self.step.layout.ranges[name]
            size, change_of = (self._ranks.most(abs(u[where]).max(initial=0.0)) for u in (now, change))
            if not change_of < LARGEST_CHANGE * size and name != "v":
                return None
        guess = self.step.state.vec.CreateVector()
        guess.FV().NumPy()[:] = now + change
        return guess

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays that a checkpoint stores; the arrays are not copies."""
        kept = list(zip(("earlier", "last"), self._kept, strict=False))
        return {f"{name}_time": t for name, (t, _) in kept}, {name: u for name, (_, u) in kept}

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Restore the data that ``state_dict`` gave."""
        names = [name for name in ("earlier", "last") if name in arrays]
        self._kept = [(numbers[f"{name}_time"], np.array(arrays[name])) for name in names]

"""Start values by extrapolation: 2 u_n - u_{n-1} where two steps of one length follow each other."""

from __future__ import annotations

import numpy as np

from ngvisco.forms.system import Step


class Extrapolation:
    """Keeps the state before the last step; part of what a restart has to know."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self.tau: float | None = None
        self._earlier = np.empty(len(step.state.vec))

    def keep(self, tau: float) -> None:
        """The step of length ``tau`` from ``step.state_old`` to ``step.state`` is done."""
        self.tau = tau
        self._earlier[:] = self.step.state_old.vec.FV().NumPy()

    def drop(self) -> None:
        """Forget: the states at hand do not follow from each other."""
        self.tau = None

    def start(self, tau: float) -> bool:
        """Extrapolate ``step.state``, which is still the old state; False if there is nothing to do so from.

        Densities and elastic variables that would lose half of their size or more are not extrapolated: the
        start value is to stay in the energy's domain.
        """
        if self.tau != tau:
            return False
        state, ranges = self.step.state.vec.FV().NumPy(), self.step.layout.ranges
        change = state - self._earlier
        for name in ("rho", "z"):
            where = ranges[name]
            if not abs(change[where]).max(initial=0.0) < 0.5 * abs(state[where]).max(initial=0.0):
                return False
        state += change
        return True

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays for a restart."""
        if self.tau is None:
            return {}, {}
        return {"extrapolated_tau": self.tau}, {"earlier": self._earlier.copy()}

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``memory`` gave."""
        self.tau = numbers.get("extrapolated_tau")
        if self.tau is not None:
            self._earlier[:] = arrays["earlier"]

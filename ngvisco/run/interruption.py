"""Stop of a run within a step: the run gives up the step between two iterations.

The run then ends with the state before that step, and its checkpoint holds the solver's data from before the
step: a run that goes on from there equals the uninterrupted one.
"""

from __future__ import annotations

from ngvisco.errors import StopRequested
from ngvisco.run.state import KeptPart, RunState


class Interruption:
    """Gives up a step of a simulation when a stop is requested, and lets it begin again."""

    def __init__(self, simulation: RunState) -> None:
        self._simulation, self._is_armed, self._has_stopped = simulation, False, False
        self._kept: dict[str, KeptPart] = {}
        simulation.solver.interrupted = lambda: self._is_armed and simulation.stop_requested

    def begin(self) -> None:
        """Keep the data from which a step begins; a request to stop that comes later gives this step up."""
        if self._has_stopped:
            self._simulation.solver.load_state_dict(*self._kept["solver"])
        self._has_stopped = False
        self._kept, self._is_armed = self.parts(), not self._simulation.stop_requested

    def parts(self) -> dict[str, KeptPart]:
        """Numbers and arrays that a restart from the present state needs, of the solver and of the stepper,
        by part."""
        if self._has_stopped:
            return self._kept
        simulation = self._simulation
        return {"solver": simulation.solver.state_dict(), "stepping": simulation.stepper.state_dict()}

    def ended(self, error: BaseException) -> BaseException | None:
        """The error that ends a run after ``error``: None if ``error`` is the requested stop."""
        if not isinstance(error, StopRequested):
            return error
        self._simulation.stepper.load_state_dict(self._simulation, *self._kept["stepping"])
        self._has_stopped = True
        return None

"""A run that is asked to stop within a step: the step is given up between two iterations.

The run then ends with the state before that step, and a checkpoint of it has what the solver knew when the
step began: a run that goes on from there is the uninterrupted one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from ngvisco.errors import StopRequested

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

Part: TypeAlias = tuple[dict[str, float], dict[str, np.ndarray]]


class Interruption:
    """The means of a simulation to give up a step, and to take it up again."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, self._is_armed, self._has_stopped = simulation, False, False
        self._kept: dict[str, Part] = {}
        simulation.solver.interrupted = lambda: self._is_armed and simulation.stop_requested

    def begin(self) -> None:
        """A step begins: keep what it depends on.  Only a request that comes later gives it up."""
        if self._has_stopped:
            self._simulation.solver.load_state_dict(*self._kept["solver"])
        self._has_stopped = False
        self._kept, self._is_armed = self.parts(), not self._simulation.stop_requested

    def parts(self) -> dict[str, Part]:
        """Numbers and arrays of solver and step lengths that a restart from here needs, by name."""
        if self._has_stopped:
            return self._kept
        simulation = self._simulation
        return {"solver": simulation.solver.state_dict(), "stepping": simulation.stepper.state_dict()}

    def ended(self, error: BaseException) -> BaseException | None:
        """The error that a run ends with for this error: None where the run was asked to stop."""
        if not isinstance(error, StopRequested):
            return error
        self._simulation.stepper.load_state_dict(self._simulation, *self._kept["stepping"])
        self._has_stopped = True
        return None

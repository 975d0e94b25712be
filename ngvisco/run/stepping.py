"""How the time loop chooses its steps: fixed, as in the paper, or adaptive.

Fixed.  A step that is not solved is taken in halves, quarters, eighths (``FixedStepper``).

Adaptive.  A step is rejected, and its length halved, when Newton fails, or when rho, J (or A) is not positive
at a sampling point.  With a tolerance, the estimated relative error e of each step
(``ngvisco.timestepping.error``) is held below it: a step above it is rejected and tried again with the length

    tau (0.9 tolerance/e)^(1/(p+1)),

p the scheme's order, and an accepted one is followed by the length of a PI controller (Gustafsson),

    tau (0.9 tolerance/e)^(0.7/(p+1)) (e_old/(0.9 tolerance))^(0.4/(p+1)),

within a factor of 2, and kept where that is within 10 %, since another length costs a new factorisation.
After a rejection no length grows at once.  Without a tolerance, or while there is no estimate (the first p
steps), the length is doubled after ``patience`` accepted steps.  The energy identity holds for any sequence
of lengths.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Protocol, runtime_checkable

import numpy as np

from ngvisco.errors import ParameterError, Quantity, StepError, require_ranges
from ngvisco.timestepping.error import ErrorEstimate
from ngvisco.timestepping.integrator import StepTaken

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation
    from ngvisco.solver.problem import Attempt

_ROUNDING = 1e-9

SAFETY = 0.9
"""Share of the tolerance that the controller aims at."""

INTEGRAL, PROPORTIONAL = 0.7, 0.4
"""Exponents of the PI controller, times the order of the local error."""

LARGEST_CHANGE, UNCHANGED = 2.0, 0.1
"""Factor by which a length changes at most, and the share of it below which it is kept."""

HALVINGS, MOST_HALVINGS = 3, 20
"""Of a step of fixed length that is not solved: by default, and at most."""


@dataclass(frozen=True, kw_only=True)
class AdaptiveSteps:
    """Adaptive step lengths between two bounds; the first step has the simulation's ``dt``.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    dt_min : float
        Shortest step; a shorter one ends the run, but for those that meet an output time.
    dt_max : float
        Longest step.
    tolerance : float, optional
        Of a step's relative error in velocity, density and elastic variables, as the scheme estimates it (the
        ledger's error_estimate); without it only unsolvable steps are shortened.
    patience : int
        Accepted steps in a row before the length is doubled, without a tolerance.
    """

    dt_min: Annotated[float, Quantity("s", "> 0", 1e-3)]
    dt_max: Annotated[float, Quantity("s", "> 0", 0.1)]
    tolerance: Annotated[float | None, Quantity("1", "> 0", 1e-3)] = None
    patience: Annotated[int, Quantity("1", ">= 1")] = 4

    def __post_init__(self) -> None:
        require_ranges(self)
        if self.dt_max < self.dt_min:
            raise ParameterError("AdaptiveSteps.dt_max", self.dt_max, f"at least dt_min = {self.dt_min:g}")


@dataclass(frozen=True)
class Rejection:
    """A step that was not accepted: from ``time`` over ``tau`` (s), and why.

    ``history`` is what was tried to solve it; empty where it was solved, but not exact enough.
    """

    time: float
    tau: float
    reason: str
    history: tuple[Attempt, ...] = ()


@dataclass(frozen=True)
class Accepted:
    """What the ledger records of an accepted step, besides the state; ``time`` is its end, s."""

    time: float
    taken: StepTaken
    rejections: int = 0
    error: float | None = None


@runtime_checkable
class RejectionObserver(Protocol):
    """An observer that wants to know of rejected steps too."""

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """After a step was rejected; the state is that before the step."""


class Stepper(ABC):
    """Chooses and takes steps for a simulation."""

    @abstractmethod
    def reached(self, simulation: Simulation, time: float) -> bool:
        """Whether the present state is that of ``time`` or later."""

    @abstractmethod
    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        """Take one step that does not pass ``stop``; raises StepError and leaves the old state."""

    @abstractmethod
    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays that a restart needs."""

    @abstractmethod
    def load_state_dict(
        self, simulation: Simulation, numbers: dict[str, float], arrays: dict[str, np.ndarray]
    ) -> None:
        """Take up what ``state_dict`` gave."""

    def check(self, name: str, time: float) -> None:
        """Raise ParameterError when ``time`` cannot be met exactly."""
        return

    def step_of(self, time: float, number: int) -> tuple[int, bool]:
        """Of the state at ``time`` (s), in row ``number`` of the ledger: the number of its step, and whether
        it is that step's end, not that of a part."""
        return number, True

    def begin(self, time: float, number: int) -> None:
        """Count steps from the state of step ``number`` at ``time``, as in a run with another dt."""
        return


def _estimate_for(simulation: Simulation) -> ErrorEstimate:
    order = simulation.scheme.order
    return ErrorEstimate(simulation.rothe_step, lambda: simulation.velocity_scale, order)


class FixedStepper(Stepper):
    """Steps of one length, taken in parts where the solver at hand does not solve them.

    A step that it does not solve is taken in halves, these in quarters, down to 2^-``halvings`` of it: each
    part is a step of the scheme with a row of the ledger of its own, and observers are told of the rejection.
    The step after begins with parts twice as long.
    """

    def __init__(self, dt: float, halvings: int = HALVINGS) -> None:
        self.dt, self.halvings = dt, halvings
        self.begin(0.0, 0)

    def begin(self, time: float, number: int) -> None:
        self._start, self._first, self._level = time, number, 0

    @property
    def _parts(self) -> int:
        """How many of the shortest parts a step has."""
        return 1 << self.halvings

    def _position(self, time: float) -> int:
        """The shortest parts from the start to ``time``."""
        return round((time - self._start) / self.dt * self._parts)

    def _time(self, position: int) -> float:
        # n dt, not a running sum: times are the same in a restarted run
        return self._start + position / self._parts * self.dt

    def check(self, name: str, time: float) -> None:
        covered = time - self._start
        number = round(covered / self.dt)
        if not math.isclose(number * self.dt, covered, rel_tol=1e-9, abs_tol=1e-12 * max(self.dt, time)):
            after = f" after t = {self._start:g} s" if self._start else ""
            raise ParameterError(name, time, f"a multiple of dt = {self.dt:g}{after}")

    def reached(self, simulation: Simulation, time: float) -> bool:
        return self._position(simulation.t) >= self._position(time)

    def step_of(self, time: float, number: int) -> tuple[int, bool]:
        position = self._position(time)
        if position < 0:  # of steps of another length
            return number, True
        whole, part = divmod(position, self._parts)
        return self._first + whole + (part > 0), part == 0

    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        t, position = simulation.t, self._position(simulation.t)
        whole, done = divmod(position, self._parts)
        level = self._level if done else max(0, self._level - 1)
        rejections = 0
        while True:
            size = self._parts >> level
            tau = self.dt * size / self._parts
            try:
                taken = simulation.integrator.advance(t, tau, self._first + whole)
                self._level = level
                return Accepted(self._time(position + size), taken, rejections)
            except StepError as failure:
                if level == self.halvings:
                    raise
                reason, history = str(failure.__cause__ or failure), failure.history
            level += 1
            reason += f"; taken in parts of {self.dt / (1 << level):.4g} s"
            rejections += 1
            simulation.notify_rejection(Rejection(t, tau, reason, history))

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        return {"start": self._start, "first": float(self._first), "level": float(self._level)}, {}

    def load_state_dict(
        self, simulation: Simulation, numbers: dict[str, float], arrays: dict[str, np.ndarray]
    ) -> None:
        t = simulation.t
        self.begin(numbers.get("start", t), int(numbers.get("first", simulation.number)))
        if "first" not in numbers or self._time(self._position(t)) != t:  # steps of other lengths led here
            self.begin(t, simulation.number)
        self._level = min(int(numbers.get("level", 0)), self.halvings)


def step_under_way(simulation: Simulation) -> int:
    """Number of the step that a run takes next, or is within."""
    return simulation.step_number + simulation.is_due(1)


class AdaptiveStepper(Stepper):
    """Steps of lengths that follow the error and what can be solved; see the module's docstring."""

    def __init__(self, dt: float, options: AdaptiveSteps) -> None:
        self.options = options
        self.dt, self.streak = dt, 0
        self._last_error: float | None = None
        self._estimate: ErrorEstimate | None = None

    def reached(self, simulation: Simulation, time: float) -> bool:
        return simulation.t >= time * (1 - 1e-14)

    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        rejections: list[Rejection] = []
        integrator, tolerance, t = simulation.integrator, self.options.tolerance, simulation.t
        scheme = integrator.scheme_of(simulation.number)
        estimate = self._estimate_of(simulation)
        while True:
            tau, new_time = self._length(t, stop)
            try:
                taken = integrator.advance(t, tau, simulation.number, meets=new_time == stop)
            except StepError as failure:
                # the cause, which does not say again which step it was
                reason = str(failure.__cause__ or failure)
                history, shorter = failure.history, tau / 2
            else:
                if new_time != stop:
                    new_time = t + taken.tau
                try:
                    error = None if estimate is None else estimate(new_time, scheme)
                except BaseException:  # an interrupt: never leave a step that is not accepted behind
                    integrator.undo()
                    raise
                if error is None or tolerance is None or error <= tolerance:
                    break
                reason, history = f"estimated error {error:.2e} is above {tolerance:.2e}", ()
                fraction = (SAFETY * tolerance / error) ** (1 / (scheme.order + 1))
                shorter = tau * max(1 / LARGEST_CHANGE, fraction)
                integrator.undo()
            rejections.append(Rejection(t, tau, reason, history))
            simulation.notify_rejection(rejections[-1])
            self.dt, self.streak = shorter, 0
            if self.dt < self.options.dt_min:
                raise StepError(self._give_up(rejections), history)
        if estimate is not None:
            estimate.keep(new_time)
        self._choose(tau, error, scheme.order, bool(rejections))
        return Accepted(new_time, taken, len(rejections), error)

    def _estimate_of(self, simulation: Simulation) -> ErrorEstimate | None:
        """The error estimate, which knows the present state; None without a tolerance."""
        if self.options.tolerance is None:
            return None
        if self._estimate is None:
            self._estimate = _estimate_for(simulation)
        if not self._estimate.is_current(simulation.t):
            self._estimate.restart(simulation.t)
        return self._estimate

    def _length(self, t: float, stop: float) -> tuple[float, float]:
        """Length and end of the next step: ``stop`` exactly, or half way where little is left."""
        left = stop - t
        if self.dt >= left * (1 - _ROUNDING):
            return left, stop
        tau = left / 2 if 2 * self.dt > left else self.dt
        return tau, t + tau

    def _choose(self, tau: float, error: float | None, order: int, was_rejected: bool) -> None:
        """The next step's length after an accepted one of length ``tau``."""
        tolerance, last = self.options.tolerance, self._last_error
        self._last_error = error
        self.streak += 1
        if tolerance is None or error is None:
            if self.streak >= self.options.patience:
                self.dt, self.streak = min(2 * self.dt, self.options.dt_max), 0
            return
        aim, floor = SAFETY * tolerance, 1e-3 * tolerance  # an error of zero says nothing of its order
        power = 1 / (order + 1)
        factor = (aim / max(error, floor)) ** (INTEGRAL * power)
        if last is not None:
            factor *= (max(last, floor) / aim) ** (PROPORTIONAL * power)
        factor = min(max(factor, 1 / LARGEST_CHANGE), 1.0 if was_rejected else LARGEST_CHANGE)
        if abs(factor - 1) > UNCHANGED and (factor < 1 or tau >= self.dt * (1 - _ROUNDING)):
            # a step that was shortened to meet a time does not say what the next one may be
            self.dt = min(max(factor * tau, self.options.dt_min), self.options.dt_max)

    def _give_up(self, rejections: list[Rejection]) -> str:
        tried = "; ".join(f"{r.tau:g} s: {r.reason}" for r in rejections)
        return (
            f"no step of at least dt_min = {self.options.dt_min:g} s from t = {rejections[0].time:g} s is "
            f"accepted; tried {tried}"
        )

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        numbers, arrays = ({}, {}) if self._estimate is None else self._estimate.state_dict()
        numbers |= {"dt": self.dt, "streak": float(self.streak)}
        if self._last_error is not None:
            numbers["last_error"] = self._last_error
        return numbers, arrays

    def load_state_dict(
        self, simulation: Simulation, numbers: dict[str, float], arrays: dict[str, np.ndarray]
    ) -> None:
        if "streak" not in numbers:  # the checkpoint is of a run with fixed steps
            return
        self.dt, self.streak = numbers["dt"], int(numbers["streak"])
        self._last_error = numbers.get("last_error")
        if arrays and self.options.tolerance is not None:
            self._estimate = _estimate_for(simulation)
            self._estimate.load_state_dict(numbers, arrays)

"""Time scheme and step lengths of a run: fixed lengths, as in the paper, or adaptive ones.

Fixed.  A step that is not solved is taken in halves, quarters, eighths (``FixedStepper``).

Adaptive.  A step is rejected and repeated with half of its length when Newton fails, or when rho, J (or A) is
not positive at a sampling point.  A step in which damage grows by more than its bound is repeated with a
shorter length (``ngvisco.run.adaptive``).  With a tolerance, a step whose estimated relative error e
(``ngvisco.timestepping.error``) is larger than the tolerance is rejected, and repeated with the length

    tau (0.9 tolerance/e)^(1/(p+1)),

p the scheme's order; after an accepted step a PI controller (Gustafsson) sets the length

    tau (0.9 tolerance/e)^(0.7/(p+1)) (e_old/(0.9 tolerance))^(0.4/(p+1)),

within a factor of 2.  The length is not changed by less than 10 %, since another length needs a new
factorisation.  The length does not grow directly after a rejection.  Without a tolerance, or in the first p
steps, the length doubles after ``patience`` accepted steps.  The energy identity holds for any lengths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol

import numpy as np

from ngvisco.errors import (
    ParameterError,
    Quantity,
    StepError,
    UnknownNameError,
    require_effect,
    require_fields,
    require_type,
)
from ngvisco.forms.system import Step
from ngvisco.physics.defects import DRIFT
from ngvisco.run.adaptive import AdaptiveSteps, GrowthControl
from ngvisco.solver.problem import Attempt
from ngvisco.solver.rothe import RotheSolver
from ngvisco.timestepping.error import ErrorEstimate, Scaled
from ngvisco.timestepping.integrator import Integrator, StepTaken
from ngvisco.timestepping.scheme import TimeScheme, midpoint, scheme_of

_ROUNDING, _NEAR = 1e-9, 1e-3
SAFETY = 0.9
"""Error that the controller aims at, relative to the tolerance."""
INTEGRAL, PROPORTIONAL = 0.7, 0.4
"""Exponents of the PI controller, times the order of the local error."""
LARGEST_CHANGE, UNCHANGED = 2.0, 0.1
"""Largest factor by which a length changes, and the relative change below which the length is kept."""
LEAST_CONSTANT = 1e-2
"""A scheme whose error constant times (p + 1)! is below this number gives no estimate of the local error."""
HALVINGS, MOST_HALVINGS = 3, 20
"""Default and largest number of halvings of a step of fixed length that is not solved."""


@dataclass(frozen=True, kw_only=True)
class TimeSteps:
    """Scheme and step lengths of a run: the keys of [time] in a case file, except ``until``.

    Raises ParameterError or UnknownNameError if a parameter is out of its range, or does not fit the scheme.

    Parameters
    ----------
    dt : float
        Length of a step; with [time.adaptive] the length of the first step.
    scheme : str or TimeScheme
        Time scheme: "backward-euler" (order 1, the paper's), "midpoint" (order 2, damps nothing), "sdirk2"
        (order 2, damps what the step does not resolve) or "theta".
    theta : float, optional
        Parameter of scheme = "theta": 1/2 is midpoint, 1 backward-euler.
    startup : int
        Number of first steps of the run by backward-euler, which damps rough data.
    relaxation : bool
        Whether each step ends where the scheme dissipates nothing; needs midpoint and [time.adaptive].
    limiter : bool
        Whether a limiter scales a cell towards its means after a step if rho, J, det F, ... are positive in
        the mean but not at each point. The ledger's column limiter has the energy that the limiter takes.
        With false a cell with a value that is not positive ends the run.
    drift : float
        Largest |det F/J - 1| of a cell's mean in an accepted step, if a tensor and a volume are carried
        separately.  A larger bound lets a run go on where a body is torn at a corner.
    halvings : int
        Number of times that an unsolved step of fixed length is halved, before solver.method = "auto" turns
        to the other solver; with 0 a step is not halved.  The run tries the first solver again after 16
        steps.
    velocity_scale : float, optional
        A typical velocity, from which a typical curvature of v follows.  Below this curvature, the penalty
        of the hyperviscosity is constant.  The estimate of errors adds this velocity to the size of v, and
        this velocity over the speed of waves to the size of strains.  The ledger adds the mass times this
        velocity to the momentum with which defects are compared.  The
        default is the velocity of flow, walls, free fall or elastic release, or a tenth of the speed of
        sound in a body at rest.
    adaptive : AdaptiveSteps, optional
        Bounds of step lengths that the run chooses; without this table all steps have one length.
    """

    dt: Annotated[float, Quantity("s", "> 0", 0.02)]
    scheme: Literal["backward-euler", "midpoint", "theta", "sdirk2"] | TimeScheme = "backward-euler"
    theta: Annotated[float | None, Quantity("1", "in [1/2, 1]", 0.6)] = None
    startup: Annotated[int, Quantity("1", ">= 0")] = 0
    relaxation: bool = False
    limiter: bool = True
    drift: Annotated[float, Quantity("1", "> 0")] = DRIFT
    halvings: Annotated[int, Quantity("1", f"from 0 to {MOST_HALVINGS}")] = HALVINGS
    velocity_scale: Annotated[float | None, Quantity("m/s", "> 0", 1.0)] = None
    adaptive: AdaptiveSteps | None = None

    def __post_init__(self) -> None:
        require_fields(self)
        if self.adaptive is not None:
            least, most = self.adaptive.dt_min, self.adaptive.dt_max
            if not least <= self.dt <= most:
                expected = f"a number from dt_min = {least:g} to dt_max = {most:g}"
                raise ParameterError("TimeSteps.dt", self.dt, expected)
            require_effect(self, False, "with adaptive steps, which are halved down to dt_min", "halvings")
        require_effect(self, self.made.A != ((1.0,),), "with backward Euler itself", "startup")
        scheme, tolerance = self.made, None if self.adaptive is None else self.adaptive.tolerance
        constant = abs(scheme.error_constant) * math.factorial(scheme.order + 1)
        if tolerance is not None and constant < LEAST_CONSTANT:
            expected = (
                f" with this scheme, since the error constant {scheme.error_constant:.1e} of this scheme is "
                f"too small for an estimate of the order {scheme.order}"
            )
            raise ParameterError("AdaptiveSteps.tolerance", tolerance, None, expected)
        if self.relaxation and (self.adaptive is None or scheme.A != midpoint().A):
            expected = ", or the scheme 'midpoint' with adaptive steps"
            raise ParameterError("TimeSteps.relaxation", self.relaxation, False, expected)

    def stepper(self) -> FixedStepper | AdaptiveStepper:
        """A new object that takes these steps."""
        if self.adaptive is None:
            return FixedStepper(float(self.dt), self.halvings)
        return AdaptiveStepper(float(self.dt), self.adaptive)

    @cached_property
    def made(self) -> TimeScheme:
        """The time scheme object."""
        try:
            return scheme_of(self.scheme, self.theta)
        except ParameterError as error:
            field = error.field if "." in error.field else f"TimeSteps.{error.field}"
            raise ParameterError(field, error.value, error.expected) from error


def time_steps(time: TimeSteps | None, keywords: Mapping[str, Any], further: Iterable[str]) -> TimeSteps:
    """The ``TimeSteps`` in the arguments of ``Simulation``: ``time``, or its parameters in ``keywords``.

    Raises ParameterError if both or neither are given; TypeError, with the nearest name among these
    parameters and the ``further`` arguments, for an unknown argument.
    """
    names = [field.name for field in fields(TimeSteps)]
    for name in (name for name in keywords if name not in names):
        raise TypeError(f"Simulation(): {UnknownNameError('keyword argument', name, [*names, *further])}")
    if time is None:
        return TimeSteps(**{"dt": None, **keywords})
    require_type("Simulation.time", time, TimeSteps)
    if keywords:
        expected = f", since parameters ({', '.join(keywords)}) are also given"
        raise ParameterError("Simulation.time", time, None, expected)
    return time


@dataclass(frozen=True)
class Rejection:
    """A rejected step: its start ``time`` and length ``tau``, s, and the reason.

    ``history`` holds the attempts to solve the step; it is empty for a step that was solved, but whose
    error or growth of damage is too large.
    """

    time: float
    tau: float
    reason: str
    history: tuple[Attempt, ...] = ()


@dataclass(frozen=True)
class Accepted:
    """Data of an accepted step for the ledger, beside the state; ``time`` is the step's end, s."""

    time: float
    taken: StepTaken
    rejections: int = 0
    error: float | None = None


class Stepped(Scaled, Protocol):
    """Attributes of a run that its stepper uses."""

    solver: RotheSolver
    integrator: Integrator

    @property
    def t(self) -> float: ...
    @property
    def number(self) -> int: ...


def _turn(solver: RotheSolver, turned: bool) -> str:
    """Let the other solver take a step that was not solved; return a sentence about the change.

    Raises StepError with the reason if the other solver may not be tried, or was tried (``turned``).
    """
    if turned:
        raise StepError(f"the {solver.turns.other} solver has not solved the step either")
    return solver.turn()


class FixedStepper:
    """Steps of one length; a step that is not solved is taken in parts.

    The parts are halves, then quarters, down to 2^-``halvings`` of the step.  Each part is a step of the
    scheme with its own row of the ledger, and observers are told of the rejection.  The next step begins with
    parts twice as long.
    """

    def __init__(self, dt: float, halvings: int = HALVINGS) -> None:
        # largest number of parts of a step
        self.dt, self.longest, self.halvings, self._parts = dt, dt, halvings, 1 << halvings
        self.begin(0.0, 0)

    def require(self, step: Step) -> None:
        return  # steps of one length need no estimate of their error

    def begin(self, time: float, number: int) -> None:
        """Count steps from the state ``number`` at ``time``, for instance after steps with another dt."""
        self._start, self._first, self._level = time, number, 0

    def _position(self, time: float) -> int:
        return round((time - self._start) / self.dt * self._parts)

    def _time(self, position: int) -> float:
        # n dt, not a running sum, so that a restarted run has the same times
        return self._start + position / self._parts * self.dt

    def met(self, time: float) -> float:
        """The end of a step, s, if one is within a thousandth of dt of ``time``; else ``time`` itself."""
        end = self._time(round((time - self._start) / self.dt) * self._parts)
        is_near = abs(end - time) <= _NEAR * self.dt and not math.isclose(end, time, rel_tol=_ROUNDING)
        return end if is_near else time

    def _meets(self, time: float) -> bool:
        """Whether a step ends at ``time``."""
        covered = time - self._start
        number = round(covered / self.dt)
        return math.isclose(number * self.dt, covered, rel_tol=1e-9, abs_tol=1e-12 * abs(time))

    @property
    def origin(self) -> float:
        """Origin of output times, s: 0 if whole steps lead back to 0, otherwise the first step's start."""
        return 0.0 if self._meets(0.0) else self._start

    def check(self, name: str, time: float) -> None:
        """Raise ParameterError when ``time`` cannot be met exactly."""
        if not self._meets(time):
            after = f" after t = {self._start:g} s" if self._start else ""
            raise ParameterError(name, time, f"a multiple of dt = {self.dt:g}{after}")

    def reached(self, run: Stepped, time: float) -> bool:
        """Whether the present state is the state at ``time`` or a later one."""
        return self._position(run.t) >= self._position(time)

    def step_of(self, time: float, number: int) -> tuple[int, bool]:
        """Number of the step to which the state at ``time`` (s) belongs, and whether this state ends the
        whole step or only a part of it.  ``number`` is the state's row in the ledger."""
        position = self._position(time)
        if position < 0:  # the time belongs to earlier steps, which had another length
            return number, True
        whole, part = divmod(position, self._parts)
        return self._first + whole + (part > 0), part == 0

    def advance(self, run: Stepped, stop: float, rejected: Callable[[Rejection], None]) -> Accepted:
        """Take one step that does not pass ``stop``, and call ``rejected`` with each rejection.

        A StepError leaves the old state."""
        t, position = run.t, self._position(run.t)
        whole, done = divmod(position, self._parts)
        level = first = self._level if done else max(0, self._level - 1)
        rejections, turned, attempts = 0, False, list[Attempt]()
        while True:
            size = self._parts >> level
            tau = self.dt * size / self._parts
            try:
                step = run.integrator.advance(t, tau, self._first + whole)
                self._level = level
                return Accepted(self._time(position + size), step, rejections)
            except StepError as failure:
                reason, history = str(failure.__cause__ or failure), failure.history
                attempts += history
                if level == self.halvings:
                    try:
                        reason += f"; {_turn(run.solver, turned)}"
                    except StepError as refused:
                        raise StepError(f"{failure}; {refused}", attempts) from failure.__cause__ or failure
                    level, turned = first, True
                else:
                    level += 1
                    reason += f"; the step is taken in parts of {self.dt / (1 << level):.4g} s"
            rejections += 1
            rejected(Rejection(t, tau, reason, history))

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays of the stepper that a restart needs."""
        return {"start": self._start, "first": self._first, "level": self._level, "dt": self.dt}, {}

    def load_state_dict(self, run: Stepped, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Load the numbers and arrays that ``state_dict`` gave."""
        t = run.t
        self.begin(numbers.get("start", t), int(numbers.get("first", run.number)))
        if numbers.get("dt", self.dt) != self.dt or self._time(self._position(t)) != t:  # other lengths
            self.begin(t, run.number)
        self._level = min(int(numbers.get("level", 0)), self.halvings)


class AdaptiveStepper:
    """Steps whose lengths follow from errors and failures, with the methods of ``FixedStepper``."""

    def __init__(self, dt: float, options: AdaptiveSteps) -> None:
        self.options = options
        self.dt, self.longest, self.streak, self.origin = dt, options.dt_max, 0, 0.0
        self._growth = GrowthControl(options.damage_growth, options.dt_min)
        self._last_error: float | None = None
        self._estimate: ErrorEstimate | None = None

    def require(self, step: Step) -> None:
        """Raise ParameterError if damage is to bound step lengths and the material does not break."""
        self._growth.require(step)

    def begin(self, time: float, number: int) -> None:
        return  # adaptive steps are counted by rows

    def met(self, time: float) -> float:
        return time

    def check(self, name: str, time: float) -> None:
        return  # adaptive steps meet any time

    def step_of(self, time: float, number: int) -> tuple[int, bool]:
        return number, True

    def reached(self, run: Stepped, time: float) -> bool:
        return run.t >= time * (1 - 1e-14)

    def advance(self, run: Stepped, stop: float, rejected: Callable[[Rejection], None]) -> Accepted:
        rejections: list[Rejection] = []
        first, turned = self.dt, False
        integrator, tolerance, t = run.integrator, self.options.tolerance, run.t
        scheme = integrator.scheme_of(run.number)
        estimate = self._estimate_of(run)
        if estimate is not None:
            estimate.begin(t)
        while True:
            tau, new_time = self._length(t, stop)
            try:
                step = integrator.advance(t, tau, run.number, meets=new_time == stop)
            except StepError as failure:
                reason = str(failure.__cause__ or failure)  # the message without the step
                history, shorter = failure.history, tau / 2
                if shorter < self.options.dt_min:
                    try:
                        reason += f"; {_turn(run.solver, turned)}"
                        shorter, turned = first, True
                    except StepError as refused:
                        reason += f"; {refused}"
            else:
                if new_time != stop:
                    new_time = t + step.tau
                try:
                    error = None if estimate is None else estimate(new_time, scheme)
                except BaseException:  # no state of an unaccepted step may stay, also after an interrupt
                    integrator.undo()
                    raise
                history, shorter = (), tau / LARGEST_CHANGE
                if error is not None and tolerance is not None and error > tolerance:
                    reason = f"the estimated error {error:.2e} is above the tolerance {tolerance:.2e}"
                    shorter = max(shorter, tau * (SAFETY * tolerance / error) ** (1 / (scheme.order + 1)))
                elif reason := self._growth.refused(tau, step.rates):
                    shorter = max(shorter, self._growth.allowed(tau, step.rates, SAFETY))
                else:
                    break
                integrator.undo()
            rejections.append(Rejection(t, tau, reason, history))
            rejected(rejections[-1])
            self.dt, self.streak = shorter, 0
            if self.dt < self.options.dt_min:
                tried = "The run tried " + "; ".join(f"{r.tau:g} s ({r.reason})" for r in rejections)
                shortest = f"dt_min = {self.options.dt_min:g} s from t = {t:g} s"
                attempts = [attempt for rejection in rejections for attempt in rejection.history]
                raise StepError(f"no step of at least {shortest} is accepted. {tried}", attempts)
        if estimate is not None:
            estimate.keep(new_time)
        self._choose(tau, error, scheme.order, bool(rejections))
        self.dt = min(self.dt, self._growth.allowed(tau, step.rates, SAFETY))
        return Accepted(new_time, step, len(rejections), error)

    def _estimate_of(self, run: Stepped) -> ErrorEstimate | None:
        if self._estimate is None and self.options.tolerance is not None:
            order, least = run.integrator.scheme.order, run.solver.options.tolerance / self.options.tolerance
            self._estimate = ErrorEstimate(run, least, order)
        return self._estimate

    def _length(self, t: float, stop: float) -> tuple[float, float]:
        """Length and end of the next step: at ``stop``, or half way to ``stop`` if two steps pass it."""
        left = stop - t
        if self.dt >= left * (1 - _ROUNDING):
            return left, stop
        tau = left / 2 if 2 * self.dt > left else self.dt
        return tau, t + tau

    def _choose(self, tau: float, error: float | None, order: int, was_rejected: bool) -> None:
        """Set the next step's length after an accepted step of length ``tau``."""
        tolerance, last = self.options.tolerance, self._last_error
        self._last_error = error
        self.streak += 1
        if tolerance is None or error is None:
            if self.streak >= self.options.patience:
                self.dt, self.streak = min(2 * self.dt, self.options.dt_max), 0
            return
        # the error has a lower bound, because an error of 0 gives no length of the next step
        aim, floor = SAFETY * tolerance, 1e-3 * tolerance
        power = 1 / (order + 1)
        factor = (aim / max(error, floor)) ** (INTEGRAL * power)
        if last is not None:
            factor *= (max(last, floor) / aim) ** (PROPORTIONAL * power)
        factor = min(max(factor, 1 / LARGEST_CHANGE), 1.0 if was_rejected else LARGEST_CHANGE)
        if abs(factor - 1) > UNCHANGED and (factor < 1 or tau >= self.dt * (1 - _ROUNDING)):
            # a step that was shortened to meet a time does not bound the next length
            self.dt = min(max(factor * tau, self.options.dt_min), self.options.dt_max)

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        numbers, arrays = ({}, {}) if self._estimate is None else self._estimate.state_dict()
        numbers |= {"dt": self.dt, "streak": float(self.streak)}
        if self._last_error is not None:
            numbers["last_error"] = self._last_error
        return numbers, arrays

    def load_state_dict(self, run: Stepped, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        if "streak" not in numbers:  # the checkpoint comes from a run with fixed steps
            return
        self.dt, self.streak = numbers["dt"], int(numbers["streak"])
        self._last_error = numbers.get("last_error")
        if arrays and (estimate := self._estimate_of(run)) is not None:
            estimate.load_state_dict(numbers, arrays)

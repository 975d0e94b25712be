"""How the time loop chooses its steps: fixed, as in the paper, or adaptive.

Adaptive.  A step is rejected, and its length halved, when Newton fails, when rho, J (or A) is not
positive at a sampling point, or when the estimated local error of the implicit Euler formula is above
the tolerance.  After ``patience`` accepted steps the length is doubled, if the estimate allows it.
The error is estimated from the linear extrapolation of the last two states, which costs nothing:
with u'' constant, u_n - u(t_n) = tau^2 u''/2 and u_extrapolated - u(t_n) = -tau (tau + tau_old) u''/2, so

    error = tau / (2 tau + tau_old) |u_n - u_extrapolated|.

Norm.  The largest of |e_v|/(|v| + v_s sqrt(volume)), |e_rho|/|rho| and |e_z|/(|z| + sqrt(volume)), with
L2 norms over the domain and v_s the run's velocity scale; so the tolerance is a relative one.
The first step of a run has no estimate.  The energy identity holds for any sequence of lengths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from ngsolve import CF, GridFunction

from ngvisco.errors import ParameterError, StepError, require_above, require_positive
from ngvisco.physics.tensors import square

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_ROUNDING = 1e-9
_GROWTH_MARGIN = 0.8
"""Share of the tolerance that a doubled step's estimate may be expected to take."""


@dataclass(frozen=True, kw_only=True)
class AdaptiveSteps:
    """Adaptive step lengths between two bounds; the first step has the simulation's ``dt``.

    Parameters
    ----------
    dt_min, dt_max : float
        Bounds of the length, s, 0 < dt_min <= dt_max.  A step may be shorter than ``dt_min`` to meet
        an output time.
    tolerance : float, optional
        Of the estimated error of one step, in the norm of the module's docstring; None (default) rejects
        only steps that cannot be solved.
    patience : int
        Accepted steps in a row before the length is doubled.
    """

    dt_min: float
    dt_max: float
    tolerance: float | None = None
    patience: int = 4

    def __post_init__(self) -> None:
        require_positive(self, dt_min=self.dt_min, dt_max=self.dt_max)
        if self.dt_max < self.dt_min:
            raise ParameterError("AdaptiveSteps.dt_max", self.dt_max, f"at least dt_min = {self.dt_min:g}")
        if self.tolerance is not None:
            require_positive(self, tolerance=self.tolerance)
        require_above(self, 0, patience=self.patience)


@dataclass(frozen=True)
class Rejection:
    """A step that was not accepted: from ``time`` over ``tau`` (s), and why."""

    time: float
    tau: float
    reason: str


@dataclass(frozen=True)
class Accepted:
    """What the ledger records of an accepted step, besides the state."""

    time: float
    tau: float
    iterations: int
    rejections: int


@runtime_checkable
class RejectionObserver(Protocol):
    """An observer that wants to know of rejected steps too."""

    def rejected(self, simulation: Simulation, rejection: Rejection) -> None:
        """After a step was rejected; the state is that before the step."""


class Stepper(Protocol):
    """Chooses and takes steps for a simulation."""

    def check(self, name: str, time: float) -> None:
        """Raise ParameterError when ``time`` cannot be met exactly."""

    def reached(self, simulation: Simulation, time: float) -> bool:
        """Whether the present state is that of ``time`` or later."""

    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        """Take one step that does not pass ``stop``; raises StepError and leaves the old state."""

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays that a restart needs."""

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``memory`` gave."""

    def begin(self, time: float, number: int) -> None:
        """Count steps from the state of step ``number`` at ``time``, as a run that goes on with another
        dt."""


def make_stepper(dt: float, adaptive: AdaptiveSteps | None) -> Stepper:
    """The stepper of a simulation with first (or only) length ``dt``."""
    if adaptive is None:
        return FixedStepper(dt)
    if not adaptive.dt_min <= dt <= adaptive.dt_max:
        expected = f"a number between dt_min = {adaptive.dt_min:g} and dt_max = {adaptive.dt_max:g}"
        raise ParameterError("Simulation.dt", dt, expected)
    return AdaptiveStepper(dt, adaptive)


class FixedStepper:
    """Steps of one length; a step that cannot be solved ends the run."""

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.begin(0.0, 0)

    def begin(self, time: float, number: int) -> None:
        self._start, self._first = time, number

    def check(self, name: str, time: float) -> None:
        covered = time - self._start
        number = round(covered / self.dt)
        if not math.isclose(number * self.dt, covered, rel_tol=1e-9, abs_tol=1e-12 * max(self.dt, time)):
            after = f" after t = {self._start:g} s" if self._start else ""
            raise ParameterError(name, time, f"a multiple of dt = {self.dt:g}{after}")

    def reached(self, simulation: Simulation, time: float) -> bool:
        return simulation.number - self._first >= round((time - self._start) / self.dt)

    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        history = simulation.solver.advance(simulation.t, self.dt)
        # (n + 1) dt, not a running sum: times are the same in a restarted run
        time = self._start + (simulation.number - self._first + 1) * self.dt
        return Accepted(time, self.dt, len(history), 0)

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        return {"start": self._start, "first": float(self._first)}, {}

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        if "first" in numbers:
            self.begin(numbers["start"], int(numbers["first"]))


class AdaptiveStepper:
    """Steps of halved and doubled lengths; see the module's docstring."""

    def __init__(self, dt: float, options: AdaptiveSteps) -> None:
        self.options = options
        self.dt, self.streak = dt, 0
        self._last_tau = 0.0
        self._last_increment: np.ndarray | None = None
        self._difference: GridFunction | None = None

    def begin(self, time: float, number: int) -> None:
        """Nothing: lengths do not depend on the number of a step."""

    def check(self, name: str, time: float) -> None:
        """Every time can be met."""

    def reached(self, simulation: Simulation, time: float) -> bool:
        return simulation.t >= time * (1 - 1e-14)

    def advance(self, simulation: Simulation, stop: float) -> Accepted:
        rejections: list[Rejection] = []
        solver, tolerance = simulation.solver, self.options.tolerance
        while True:
            t = simulation.t
            tau, new_time = self._length(t, stop)
            error = None
            try:
                history = solver.advance(t, tau, with_continuation=False)
            except StepError as failure:
                reason, iterations = str(failure), failure.history
            else:
                error = self._estimate(simulation, tau)
                if error is None or tolerance is None or error <= tolerance:
                    break
                reason, iterations = f"estimated error {error:.2e} is above {tolerance:.2e}", ()
                solver.undo(t)
            rejections.append(Rejection(t, tau, reason))
            simulation.notify_rejection(rejections[-1])
            self.dt, self.streak = tau / 2, 0
            if self.dt < self.options.dt_min:
                raise StepError(self._give_up(rejections), iterations)
        self._accept(simulation, tau, error)
        return Accepted(new_time, tau, len(history), len(rejections))

    def _length(self, t: float, stop: float) -> tuple[float, float]:
        """Length and end of the next step: ``stop`` exactly, or half way where little is left."""
        left = stop - t
        if self.dt >= left * (1 - _ROUNDING):
            return left, stop
        tau = left / 2 if 2 * self.dt > left else self.dt
        return tau, t + tau

    def _accept(self, simulation: Simulation, tau: float, error: float | None) -> None:
        now, old = simulation.rothe_step.state.vec, simulation.rothe_step.state_old.vec
        self._last_tau, self._last_increment = tau, now.FV().NumPy() - old.FV().NumPy()
        self.streak += 1
        tolerance = self.options.tolerance
        calm = tolerance is None or error is None or 4 * error <= _GROWTH_MARGIN * tolerance
        if self.streak >= self.options.patience and calm:
            self.dt, self.streak = min(2 * self.dt, self.options.dt_max), 0

    def _estimate(self, simulation: Simulation, tau: float) -> float | None:
        step = simulation.rothe_step
        if self._last_increment is None or self.options.tolerance is None:
            return None
        if self._difference is None:
            self._difference = GridFunction(step.layout.space)
        now, old = (part.vec.FV().NumPy() for part in (step.state, step.state_old))
        increment = now - old - tau / self._last_tau * self._last_increment
        self._difference.vec.FV().NumPy()[:] = tau / (2 * tau + self._last_tau) * increment
        e, u = step.layout.fields(self._difference.components), step.now
        squares = [square(e.v), e.rho * e.rho, square(e.z), square(u.v), u.rho * u.rho, square(u.z), CF(1.0)]
        norms = np.sqrt(np.asarray(step.quadrature.integrate_cells(CF(tuple(squares)))))
        root_volume = norms[6]
        scales = (norms[3] + simulation.velocity_scale * root_volume, norms[4], norms[5] + root_volume)
        return float(max(norms[i] / scales[i] for i in range(3)))

    def _give_up(self, rejections: list[Rejection]) -> str:
        tried = "; ".join(f"{r.tau:g} s: {r.reason}" for r in rejections)
        return (
            f"no step of at least dt_min = {self.options.dt_min:g} s from t = {rejections[0].time:g} s is "
            f"accepted; tried {tried}"
        )

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        numbers = {"dt": self.dt, "streak": float(self.streak), "last_tau": self._last_tau}
        arrays = {} if self._last_increment is None else {"last_increment": self._last_increment}
        return numbers, arrays

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        if "streak" not in numbers:  # the checkpoint is of a run with fixed steps
            return
        self.dt, self.streak = numbers["dt"], int(numbers["streak"])
        self._last_tau, self._last_increment = numbers["last_tau"], arrays.get("last_increment")

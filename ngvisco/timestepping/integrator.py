"""One step of a time scheme: its stages, each a Rothe step, and the state at the step's end.

Dissipation is evaluated at each stage's solution.  Therefore the ledger closes to rounding for every scheme;
``ngvisco.timestepping.scheme`` derives the energy identity.  If the end is not the last stage's solution, the
end combines the stages' momentum functionals and other evolving unknowns (rho, z, unknowns of further terms).
Then v follows from the momentum (``VelocityOfMomentum``); on moving walls v has the walls' velocity at the
end's time.  Unknowns without a time derivative (traces, multipliers, the creep rate field) keep their values
of the last stage.

Bounds.  If values at the end of a step are negative at a point but have positive means, these values are
limited (``ngvisco.forms.bounds``).  Stages are not limited; only their means have to be positive.  The
momentum density is limited as rho is, and v follows from both.  Let U be the last stage, u_1 the end before
limiting, and u the limited end:

    E(u) - E(u_1) = E'(U)[u - u_1] + B(u, U) - B(u_1, U).

If u_1 is U, ``limiter`` is the energy that limiting takes, E(U) - E(u).  An extrapolated end u_1 may have no
energy; then R has B(u, U) in place of B(u_1, U), and ``limiter`` is -E'(U)[u - u_1].

Moving walls.  In prescribed rows of v, m_1 = int rho_1 v_1 . w differs from the combination of the stages'
momenta.  The difference is an impulse of the wall, which works on the last stage's velocity; this work is
added to the wall's power.  Where a moving wall meets an oblique or curved wall, the rows also contain an
impulse of the multipliers.  This impulse does no work and is not counted in the wall's power.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ngvisco.errors import StepError
from ngvisco.forms.boundary.wall_projections import VelocityOfMomentum
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.context import time
from ngvisco.forms.distance import BregmanDistance
from ngvisco.forms.system import Evolved
from ngvisco.solver.problem import Attempt, Interval, iterations
from ngvisco.solver.rothe import RotheSolver
from ngvisco.timestepping.scheme import TimeScheme, backward_euler

_RELAXED, _RELAXATION_TOLERANCE = (1.5, 2.5), 1e-12
"""Range of the end omega of a relaxed midpoint step, in units of the Rothe step (2 is unrelaxed), and the
absolute tolerance on omega.  R then varies by this fraction of the distance B(u_0, U), which is of order
tau^2."""
_MEETINGS, _MEETING = 6, 1e-13
"""Largest number of Rothe steps for a relaxed step that ends at a given time, and the relative tolerance on
its length."""
_NOISE_MARGIN, _NOISE_DRAWS = 5.0, 8
"""Assumed ratio of the rounding of R to the root mean square distance between a state and copies of this
state with random rounding errors, and the number of copies.  A single distance may vanish by chance."""


class CarriedField(Protocol):
    """A passive field, or another object, that follows the stages of the scheme."""

    def begin(self) -> None:
        """Begin a step, or repeat it: forget the stages."""

    def stage(self, weights: np.ndarray, share: float) -> None:
        """Follow a stage, whose solution is the present state.

        ``weights`` are the weights of y_0, y_1, ... in the stage's start value; ``share`` is the stage's b_i,
        the weight of its measured values in the step's mean.
        """

    def end(self, weights: np.ndarray) -> None:
        """Accept the step; ``weights`` are the weights of y_0, y_1, ... in the step's end."""


@dataclass(frozen=True)
class StepTaken:
    """Exchange of energy and momentum in a step, and data about the step's solution.

    ``tau`` is the step's length, s; ``history`` lists the attempts; ``rates`` are dissipations and powers, W,
    weighted by the scheme; ``numerical`` has R and the limiter's energy by ledger columns, J; ``limited``
    counts the limited cells. ``impulse`` is the walls' impulse at the step's end divided by ``tau``, N, a
    number for each row of v, or None; ``unsolved`` counts the passive fields without a solution.
    """

    tau: float
    history: list[Attempt]
    rates: dict[str, float]
    numerical: dict[str, float]
    limited: int = 0
    impulse: np.ndarray | None = None
    unsolved: int = 0

    @property
    def iterations(self) -> int:
        """Number of iterations of all attempts."""
        return len(iterations(self.history))


LIMITER = "limiter"
"""Ledger column of the energy lost by limiting a step's end, J."""
LIMITER_WALLS = "limiter_walls"
"""Ledger column of the limiter's energy that passes through held or moving walls, which change the
momentum, J."""


class Integrator:
    """Takes steps of a scheme with a Rothe solver.

    ``meter`` returns dissipations and powers at the present state, W, by ledger columns; ``bounds`` limits
    ends of steps if its ``limits`` is true.  The first ``startup`` steps of the run use the backward Euler
    scheme, which damps rough initial data (Rannacher).  If ``relaxed`` is True, a midpoint step ends where
    the numerical remainder R is zero, to the rounding of the energies, so that its length differs from the
    requested one.
    """

    def __init__(
        self,
        rothe: RotheSolver,
        scheme: TimeScheme,
        meter: Callable[[], dict[str, float]],
        bounds: Bounds,
        *,
        carried: Sequence[CarriedField] = (),
        startup: int = 0,
        relaxed: bool = False,
    ) -> None:
        self.rothe, self.step, self.scheme, self.bounds = rothe, rothe.step, scheme, bounds
        self.meter, self.carried, self.startup, self.relaxed = meter, list(carried), startup, relaxed
        self.distance = BregmanDistance(self.step)
        self._before = rothe.start
        """The state before the step: ``rothe.start`` until the second stage, and then a copy."""
        self._t = 0.0
        self.tried = 0.0
        """Length of the last attempted step, s."""
        self.impulse: np.ndarray | None = None
        """Walls' impulse on the rows of v at the last step's end over its length, N, or None."""

    @cached_property
    def velocity(self) -> VelocityOfMomentum:
        step, rho = self.step, self.step.now.rho
        walls, rules = step.impenetrability, step.quadrature
        return VelocityOfMomentum(step.layout, step.state, rho, step.momentum_old, walls, rules)

    def scheme_of(self, number: int) -> TimeScheme:
        """Scheme of the step that follows step ``number``."""
        return backward_euler() if number < self.startup else self.scheme

    def advance(self, t: float, tau: float, number: int = 0, meets: bool = False) -> StepTaken:
        """Take the step that follows step ``number``, from ``t`` over ``tau``, s.

        A relaxed step ends at t + tau only if ``meets`` is True.

        Raises StepError if a stage is not solved or the end is not admissible; the state before the step is
        then restored.
        """
        self._before = self.rothe.start
        self._before.data = self.step.state.vec
        self._t, self.tried = t, tau
        history: list[Attempt] = []
        try:
            scheme = self.scheme_of(number)
            self.step.freeze()
            if self.relaxed and scheme is self.scheme:
                result = self._relaxed(scheme, t, tau, history, meets)
            else:
                result = self._taken(scheme, t, tau, history)
            if self.step.damage is not None:  # damage grows after the step, with z fixed
                rates, numerical = self.step.damage(result.tau)
                self._complete()
                result = replace(result, rates=result.rates | rates, numerical=result.numerical | numerical)
            for name, value in (result.rates | result.numerical).items():
                if not math.isfinite(value):
                    raise StepError(f"{name} of the step is {value}; take a smaller step or a finer mesh")
            return replace(result, unsolved=sum(getattr(field, "unsolved", 0) for field in self.carried))
        except BaseException as error:  # no half step may remain, also after an interrupt
            self.undo()
            if isinstance(error, StepError):
                message = f"step of length {tau:g} s from t = {t:g} s: {error}"
                if (nearest := self.bounds.nearest()) is not None:
                    message += f"; before the step {nearest}"
                raise StepError(message, [*history, *error.history]) from error
            raise

    def undo(self) -> None:
        """Restore the state before the last ``advance``."""
        self.rothe.return_to(self._before)
        self.step.state_old.vec.data = self._before
        self.step.start_from_old()
        time.Set(self._t)
        for field in self.carried:
            field.begin()

    def accept(self) -> None:
        """Accept the last step in the passive fields; it cannot be undone afterwards."""
        for field in self.carried:
            field.end(self._end)

    def _taken(self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt]) -> StepTaken:
        states, rates = self._stages(scheme, t, tau, history)
        numerical: dict[str, float] = {}
        for (i, k), weight in np.ndenumerate(scheme.distances):
            if weight != 0:
                _add(numerical, weight, self.distance(states[k], states[i + 1]))
        self._end = scheme.end
        if not scheme.ends_at_last_stage:
            end, limited, by_limiter = self._combined(scheme.end, states, t + tau, tau, rates)
            _add(numerical, -1.0, self.distance(end, states[-1]))
        elif self.bounds.limits and self.bounds.is_exceeded():
            of_last = np.eye(len(states))[-1]
            end, limited, by_limiter = self._combined(of_last, states, t + tau, tau, rates, is_stage=True)
            by_limiter[LIMITER] -= sum(self.distance(end, states[-1]).values())
        else:
            return StepTaken(tau, history, rates, numerical | {LIMITER: 0.0, LIMITER_WALLS: 0.0})
        self._complete()
        return StepTaken(tau, history, rates, numerical | by_limiter, limited, self.impulse)

    def _stages(
        self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt]
    ) -> tuple[list[Evolved], dict[str, float]]:
        """Solve the stages.  Return y_0 ... y_s and weighted rates; the state is the last stage's."""
        states = [self.step.evolved()]
        self.impulse = None
        rates: dict[str, float] = {}
        for field in self.carried:
            field.begin()
        begin = t
        for i in range(scheme.stages):
            length, end = scheme.A[i][i] * tau, t + scheme.c[i] * tau
            self.step.start_from(list(zip(scheme.starts[i], states, strict=False)))
            history += self.rothe.solve(Interval(length, begin, end, t, tau, scheme.tilts[i]))
            begin = end
            if i + 1 < scheme.stages and self._before is self.rothe.start:
                self._before = self.rothe.start.Copy()
            states.append(self.step.evolved())
            _add(rates, scheme.b[i], self.meter())
            for field in self.carried:
                field.stage(scheme.starts[i], scheme.b[i])
        return states, rates

    def _combined(
        self,
        weights: np.ndarray,
        states: Sequence[Evolved],
        t: float,
        tau: float,
        rates: dict[str, float],
        is_stage: bool = False,
    ) -> tuple[Evolved, int, dict[str, float]]:
        """Set the present state to the limited combination of states, at time ``t``.

        The power of the walls' impulse is added to the walls' power in ``rates``.  If ``is_stage`` is True,
        the combination is the last stage, and only the limiter changes it; walls keep their velocity in the
        step. Raises StepError if the state is not admissible.  Returns the state, the number of limited
        cells, and two energies, J: the one lost by limiting, -E'(U)[u - u_1], and minus the work of the
        impulse that limiting makes on walls' rows of v.
        """
        step, ranges = self.step, self.step.layout.ranges
        step.start_from(list(zip(weights, states, strict=True)))  # combines the momentum and the fields
        state, old = step.state.vec.FV().NumPy(), step.state_old.vec.FV().NumPy()
        for name in step.layout.evolving:
            state[ranges[name]] = old[ranges[name]]
        time.Set(t)
        if not is_stage:
            step.moving_walls.set_present_values()
        if (reason := self.bounds.defect(is_solved=False)) is not None:
            raise StepError(f"{reason} at the end of the step; take a smaller step or a finer mesh")
        before = np.zeros_like(self.velocity.v)
        if self.bounds.limits and self.bounds.is_exceeded() and not is_stage:
            before = self._impulse_before_limiting(before)
        limited, limiter_energy = self.bounds.limit(tau) if self.bounds.limits else 0, 0.0
        is_changed = limited > 0 or self.bounds.sharpening is not None
        if is_changed:
            moved = [name for name in step.layout.evolving if name != "v"]  # v follows from the momentum
            change = {name: state[ranges[name]] - old[ranges[name]] for name in moved}
            limiter_energy = -self.distance.slope(states[-1], change)
            limiter_energy += self._limiter_energy_of_momentum(states[-1])
        impulse = self.velocity(keeps_walls=is_stage)
        self.impulse = impulse / tau
        rows = before if is_changed else impulse
        v, moving = states[-1].values["v"], step.moving_walls.moving
        for name, work in self.velocity.works(rows, v, moving).items():
            rates[f"power_wall_{name}"] += work / tau
        works = self.velocity.works(impulse - rows, v, moving) if is_changed else {}
        return step.evolved(), limited, {LIMITER: limiter_energy, LIMITER_WALLS: 0.0 - sum(works.values())}

    def _limiter_energy_of_momentum(self, stage: Evolved) -> float:
        """Limit the momentum density.  Return -<change of m, V> with the velocity V of a stage, J."""
        before = self.velocity.functional()
        self.bounds.limit_momentum()
        return -self.rothe.exchange.communicator.dot(self.velocity.functional() - before, stage.values["v"])

    def _impulse_before_limiting(self, otherwise: np.ndarray) -> np.ndarray:
        """Impulse of the walls that follows from the density before limiting.

        The result is ``otherwise`` if no velocity follows from this density.  The method is called only at
        combined ends: an end that is a stage's solution satisfies the rows of v already.
        """
        kept = self.velocity.v.copy()
        try:
            return self.velocity()
        except StepError:  # a density that is negative at points may have no positive mass matrix
            return otherwise
        finally:
            self.velocity.v[:] = kept

    def _complete(self) -> None:
        """Update dependent unknowns at an end that is no stage's solution.

        Raises StepError if the end has no energy."""
        self.step.local_unknowns.update_without_means()
        if (reason := self.step.energy.failure or self.bounds.refusal()) is not None:
            raise StepError(f"at the end of the step {reason}")

    def _relaxed(
        self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt], meets: bool
    ) -> StepTaken:
        """A midpoint step that ends at u_0 + omega (U - u_0), with the omega near 2 for which R = 0."""
        length = scheme.A[0][0] * tau
        for _ in range(_MEETINGS):
            # loads are averaged over the unrelaxed step, which has the length of two Rothe steps
            states, rates = self._stages(scheme, t, length / scheme.A[0][0], history)
            share = tau / length if meets else None
            omega, numerical, rates, limited = self._relaxed_end(states, t, length, rates, share)
            if not meets or abs(omega * length - tau) <= _MEETING * tau:
                self._complete()
                self._end = np.array([1 - omega, omega])
                return StepTaken(omega * length, history, rates, numerical, limited, self.impulse)
            length = tau / omega
            self.rothe.return_to(self._before)
        raise StepError("no relaxed step ends at the given time; take a smaller step")

    def _relaxed_end(
        self, states: Sequence[Evolved], t: float, span: float, rates: dict[str, float], share: float | None
    ) -> tuple[float, dict[str, float], dict[str, float], int]:
        """Set the state u_0 + omega (U - u_0) with R = 0.  Return omega, R and the limiter's energies by
        columns, rates, and the number of limited cells.

        If the limiter takes energy, omega is ``share``, or 2 if ``share`` is None.  Otherwise omega is 2 if
        B(u_0, U) is at rounding, and ``share`` if R is at rounding for this omega.
        """
        from_start = self.distance(*states)
        distance, noise = sum(from_start.values()), self._noise(states[0])

        def end_at(omega: float) -> tuple[dict[str, float], dict[str, float], dict[str, float], int]:
            of_end, length, numerical = dict(rates), omega * span, dict(from_start)
            weights = np.array([1 - omega, omega])
            end, limited, by_limiter = self._combined(weights, states, t + length, length, of_end)
            _add(numerical, -1.0, self.distance(end, states[-1]))
            return numerical, by_limiter, of_end, limited

        omega = 2.0
        if self.bounds.limits:
            end_at(omega)
        if self.bounds.limits and self.bounds.takes_energy:
            # R jumps when the limiter begins to act in a cell, and the limiter dissipates anyway
            omega = 2.0 if share is None else share
        elif distance > noise:
            from scipy.optimize import brentq  # a tenth of the package's import time

            try:
                omega = brentq(
                    lambda o: sum(end_at(o)[0].values()) / distance, *_RELAXED, xtol=_RELAXATION_TOLERANCE
                )
            except ValueError as error:
                message = (
                    "numerical dissipation remains at every length of the relaxed step, for example because "
                    "a load or a wall's velocity has a kink; take smaller steps, or no relaxation"
                )
                raise StepError(message) from error
            if share is not None and abs(omega - share) <= noise / distance:
                omega = share
        numerical, by_limiter, of_end, limited = end_at(omega)
        return omega, numerical | by_limiter, of_end, limited

    def _noise(self, state: Evolved) -> float:
        """Rounding of a distance at ``state``, J, from distances to copies with rounding errors."""
        signs = np.random.default_rng(0)  # a fixed seed keeps runs reproducible

        def changed(values: np.ndarray) -> np.ndarray:
            return values * (1 + np.finfo(float).eps * signs.choice((-1.0, 1.0), len(values)))

        drawn = []
        for _ in range(_NOISE_DRAWS):
            noisy = replace(state, values={name: changed(values) for name, values in state.values.items()})
            drawn.append(sum(self.distance(noisy, state).values()))
        return _NOISE_MARGIN * float(np.sqrt(np.mean(np.square(drawn))))


def _add(total: dict[str, float], weight: float, values: dict[str, float]) -> None:
    for name, value in values.items():
        total[name] = total.get(name, 0.0) + weight * value

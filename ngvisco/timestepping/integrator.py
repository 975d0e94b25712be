"""One step of a time scheme: its stages, each a Rothe step, and the state at the step's end.

What a stage dissipates is metered at its solution, so that the ledger closes to rounding for every scheme;
see ``scheme`` for the identity.  Where the end is not the last stage's solution, the momentum functional and
the other unknowns that evolve (rho, z, those of further terms) are combined, v follows from the momentum
(``VelocityOfMomentum``) with moving walls at the end's time, and the unknowns without a time derivative
(traces, multipliers, the creep rate field) stay those of the last stage.

Bounds.  A step's end that is negative at a point while its means are not is limited
(``ngvisco.forms.bounds``).  Stages are left as they are solved: they only have to have positive means.
The momentum density is limited as rho is, and v follows from both.  With U the last stage, and u_1 the end
before it is limited to u,

    E(u) - E(u_1) = E'(U)[u - u_1] + B(u, U) - B(u_1, U),

and ``limiter`` is what this takes: E(U) - E(u) where u_1 is U.  At an extrapolated end, where u_1 may have
no energy, R has B(u, U) in place of B(u_1, U) and ``limiter`` is -E'(U)[u - u_1].

Moving walls.  In the rows of v that are prescribed, m_1 = int rho_1 v_1 . w is not the combination of the
stages' momenta: the difference is an impulse of the wall, which works on the last stage's velocity.  It is
added to the wall's power.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ngvisco.errors import StepError
from ngvisco.forms.bounds import Bounds
from ngvisco.forms.context import time
from ngvisco.forms.distance import BregmanDistance
from ngvisco.forms.projections import VelocityOfMomentum
from ngvisco.forms.system import Evolved
from ngvisco.solver.problem import Attempt, Interval, iterations
from ngvisco.solver.rothe import RotheSolver
from ngvisco.timestepping.scheme import TimeScheme, backward_euler

_RELAXED, _RELAXATION_TOLERANCE = (1.5, 2.5), 1e-12
"""Where the end of a relaxed midpoint step is looked for, in units of its Rothe step (2 is unrelaxed), and
how exactly: R changes by this share of the distance B(u_0, U) itself, which is of order tau^2."""
_MEETINGS, _MEETING = 6, 1e-13
"""Rothe steps tried until a relaxed step ends at a given time, and what of it may be missed."""
_NOISE_MARGIN, _NOISE_DRAWS = 5.0, 8
"""Rounding of R, in units of the distance of a state to itself with every number changed by rounding: the
root mean square of so many draws, since the sum of a single one may vanish by chance."""


class CarriedField(Protocol):
    """A field that is carried along by the same scheme, with the stages' velocities."""

    def begin(self) -> None:
        """A step begins, or begins anew: forget the stages."""

    def stage(self, weights: np.ndarray, share: float) -> None:
        """The present state is that of a stage, whose own old value has these weights of y_0, y_1, ...

        ``share`` is the stage's b_i: what is measured in it counts so much in the step's mean.
        """

    def end(self, weights: np.ndarray) -> None:
        """The step is accepted: its end has these weights."""


@dataclass(frozen=True)
class StepTaken:
    """The exchange of a step with its surroundings, besides the state that it left.

    ``tau`` is its length, s; ``history`` what was tried, from which start values; ``rates`` are dissipations
    and powers, W, weighted as the scheme does; ``numerical`` is R by ledger columns, J, and what the limiter
    took in ``limited`` cells.  ``impulse`` is what walls do to the rows of v at the step's end over its
    length, N, None without; ``unsolved`` fields were carried along without a solution.
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
        """Iterations of all attempts."""
        return len(iterations(self.history))


LIMITER = "limiter"
"""Ledger column of the energy that limiting a step's end takes, J."""
LIMITER_WALLS = "limiter_walls"
"""The part of the limiter's energy that goes through walls that are held or moved, where momentum is not
kept, J."""


class Integrator:
    """Takes steps of a scheme with a Rothe solver.

    ``meter`` gives dissipations and powers at the present state, W, by ledger columns; ``bounds`` limits the
    ends of steps where it ``limits``.  The first ``startup`` steps of the run are of the backward Euler
    scheme, which damps rough initial data (Rannacher).  Where ``relaxed``, the midpoint rule's end is where
    the numerical remainder R is zero, to the rounding of the energies; steps then have other lengths than
    asked for.
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
        self._before = self.step.state.vec.CreateVector()
        self._t = 0.0
        self.tried = 0.0
        """Length of the last step that was begun, s."""
        self.impulse: np.ndarray | None = None
        """Walls' impulse on the rows of v at the last step's end over its length, N; None without."""

    @cached_property
    def _velocity(self) -> VelocityOfMomentum:
        step, rho = self.step, self.step.now.rho
        walls, rules = step.impenetrability, step.quadrature
        return VelocityOfMomentum(step.layout, step.state, rho, step.momentum_old, walls, rules)

    def scheme_of(self, number: int) -> TimeScheme:
        """The scheme of the step after step ``number``."""
        return backward_euler() if number < self.startup else self.scheme

    def advance(self, t: float, tau: float, number: int = 0, meets: bool = False) -> StepTaken:
        """Take the step after step ``number`` from ``t`` over ``tau``, s.

        If it is relaxed, it ends at t + tau where it ``meets`` a time, and elsewhere otherwise.

        Raises StepError when a stage is not solved, or the end is not admissible; the state is then that
        before the step.
        """
        self._before.data = self.step.state.vec
        self._t, self.tried = t, tau
        history: list[Attempt] = []
        try:
            scheme = self.scheme_of(number)
            self.step.freeze()
            if self.relaxed and scheme is self.scheme:
                taken = self._relaxed(scheme, t, tau, history, meets)
            else:
                taken = self._taken(scheme, t, tau, history)
            if self.step.damage is not None:  # it grows after the step, over its whole length, z kept
                rates, numerical = self.step.damage(taken.tau)
                self._complete()
                taken = replace(taken, rates=taken.rates | rates, numerical=taken.numerical | numerical)
            for name, value in (taken.rates | taken.numerical).items():
                if not math.isfinite(value):
                    raise StepError(f"{name} of the step is {value}: take a smaller step or a finer mesh")
            return replace(taken, unsolved=sum(getattr(one, "unsolved", 0) for one in self.carried))
        except BaseException as error:  # also an interrupt: never leave half a step behind
            self.undo()
            if isinstance(error, StepError):
                message = f"step of length {tau:g} s from t = {t:g} s: {error}"
                raise StepError(message, [*history, *error.history]) from error
            raise

    def undo(self) -> None:
        """Put the state before the last ``advance`` back."""
        self.rothe.return_to(self._before)
        self.step.state_old.vec.data = self._before
        self.step.start_from_old()
        time.Set(self._t)
        for one in self.carried:
            one.begin()

    def accept(self) -> None:
        """Let what is carried along follow the last step, which is not taken back."""
        for one in self.carried:
            one.end(self._end)

    def _taken(self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt]) -> StepTaken:
        states, rates = self._stages(scheme, t, tau, history)
        numerical: dict[str, float] = {}
        for (i, k), weight in np.ndenumerate(scheme.distances):
            if weight != 0:
                _add(numerical, weight, self.distance(states[k], states[i + 1]))
        self._end = scheme.end
        if not scheme.ends_at_last_stage:
            end, limited, lost = self._combined(scheme.end, states, t + tau, tau, rates)
            _add(numerical, -1.0, self.distance(end, states[-1]))
        elif self.bounds.limits and self.bounds.is_exceeded():
            of_last = np.eye(len(states))[-1]
            end, limited, lost = self._combined(of_last, states, t + tau, tau, rates, is_stage=True)
            lost[LIMITER] -= sum(self.distance(end, states[-1]).values())
        else:
            return StepTaken(tau, history, rates, numerical | {LIMITER: 0.0, LIMITER_WALLS: 0.0})
        self._complete()
        return StepTaken(tau, history, rates, numerical | lost, limited, self.impulse)

    def _stages(
        self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt]
    ) -> tuple[list[Evolved], dict[str, float]]:
        """y_0 ... y_s and the weighted rates of the stages; the state is that of the last one."""
        states = [self.step.evolved()]
        self.impulse = None
        rates: dict[str, float] = {}
        for one in self.carried:
            one.begin()
        begin = t
        for i in range(scheme.stages):
            own, end = scheme.A[i][i] * tau, t + scheme.c[i] * tau
            self.step.start_from(list(zip(scheme.starts[i], states, strict=False)))
            history += self.rothe.solve(Interval(own, begin, end, t, tau, scheme.tilts[i]))
            begin = end
            states.append(self.step.evolved())
            _add(rates, scheme.b[i], self.meter())
            for one in self.carried:
                one.stage(scheme.starts[i], scheme.b[i])
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
        """Make the combination of states the present one, limited, at ``t``.

        Adds to the walls' power in ``rates``.  With ``is_stage`` it is the last stage, of which only the
        limiter makes another state: walls keep the velocity that they have in the step.  Raises StepError
        when it is not admissible.  Returns the state, how many cells were limited, and what that takes, J:
        -E'(U)[u - u_1], and the work of the impulse on walls' rows of v that limiting makes, negative.
        """
        step, ranges = self.step, self.step.layout.ranges
        parts = list(zip(weights, states, strict=True))
        step.start_from(parts)  # where the momentum and the fields are combined
        state, old = step.state.vec.FV().NumPy(), step.state_old.vec.FV().NumPy()
        for name in step.layout.evolving:
            state[ranges[name]] = old[ranges[name]]
        time.Set(t)
        if not is_stage:
            step.moving_walls.set_present_values()
        if (reason := self.bounds.defect(is_solved=False)) is not None:
            raise StepError(f"{reason} at the end of the step: take a smaller step or a finer mesh")
        before = np.zeros_like(self._velocity.v)
        if self.bounds.limits and self.bounds.is_exceeded() and not is_stage:
            before = self._impulse_before_limiting(before)
        limited, taken = self.bounds.limit(tau) if self.bounds.limits else 0, 0.0
        is_changed = limited > 0 or self.bounds.sharpening is not None
        if is_changed:
            moved = [name for name in step.layout.evolving if name != "v"]  # v follows from the momentum
            change = {name: state[ranges[name]] - old[ranges[name]] for name in moved}
            taken = -self.distance.slope(states[-1], change) + self._taken_of_momentum(states[-1])
        impulse = self._velocity(keeps_walls=is_stage)
        self.impulse = impulse / tau
        own, through_walls = before if is_changed else impulse, 0.0
        for name, (_, mask) in step.moving_walls.moving.items():
            v = states[-1].values["v"][mask]
            rates[f"power_wall_{name}"] += self.rothe.exchange.communicator.dot(own[mask], v) / tau
            if is_changed:
                through_walls -= self.rothe.exchange.communicator.dot((impulse - own)[mask], v)
        v = states[-1].values["v"]
        for name, work in self._velocity.works(own, v).items():
            rates[f"power_wall_{name}"] += work / tau
        if limited:
            through_walls -= sum(self._velocity.works(impulse - own, v).values())
        return step.evolved(), limited, {LIMITER: taken, LIMITER_WALLS: through_walls}

    def _taken_of_momentum(self, stage: Evolved) -> float:
        """Limit the momentum density; gives -<change of m, V> with the velocity V of a stage, J."""
        before = self._velocity.functional()
        self.bounds.limit_momentum()
        change = self._velocity.functional() - before
        return -self.rothe.exchange.communicator.dot(change, stage.values["v"])

    def _impulse_before_limiting(self, otherwise: np.ndarray) -> np.ndarray:
        """The walls' impulse by the density as it is; ``otherwise`` where that has no velocity.

        Of a stage there is none: its rows are the step's.
        """
        kept = self._velocity.v.copy()
        try:
            return self._velocity()
        except StepError:  # a density that is negative at points may have no positive mass matrix
            return otherwise
        finally:
            self._velocity.v[:] = kept

    def _complete(self) -> None:
        """Make what follows from an end that is no stage's solution; StepError where it has no energy."""
        self.step.eliminate.follow()
        if (reason := self.step.energy.failure or self.bounds.refusal()) is not None:
            raise StepError(f"at the end of the step {reason}")

    def _relaxed(
        self, scheme: TimeScheme, t: float, tau: float, history: list[Attempt], meets: bool
    ) -> StepTaken:
        """A midpoint step that ends at u_0 + omega (U - u_0), omega near 2, where R = 0."""
        own = scheme.A[0][0] * tau
        for _ in range(_MEETINGS):
            # of a step of two Rothe steps' length, over which loads are averaged
            states, rates = self._stages(scheme, t, own / scheme.A[0][0], history)
            wanted = tau / own if meets else None
            omega, numerical, rates, limited = self._relaxed_end(states, t, own, rates, wanted)
            if not meets or abs(omega * own - tau) <= _MEETING * tau:
                self._complete()
                self._end = np.array([1 - omega, omega])
                return StepTaken(omega * own, history, rates, numerical, limited, self.impulse)
            own = tau / omega
            self.rothe.return_to(self._before)
        raise StepError("the relaxed step does not meet its end: take a smaller step")

    def _relaxed_end(
        self, states: Sequence[Evolved], t: float, own: float, rates: dict[str, float], wanted: float | None
    ) -> tuple[float, dict[str, float], dict[str, float], int]:
        """omega with R = 0, R's parts and the limiter's, the rates and the number of limited cells there.

        The state is then u_0 + omega (U - u_0).
        It is ``wanted`` where that is as good, R being rounding at both, and 2 where all of R is rounding.
        """
        from_start = self.distance(*states)
        lost, noise = sum(from_start.values()), self._noise(states[0])

        def end_at(omega: float) -> tuple[dict[str, float], dict[str, float], dict[str, float], int]:
            of_end, length, numerical = dict(rates), omega * own, dict(from_start)
            weights = np.array([1 - omega, omega])
            end, limited, by_limiter = self._combined(weights, states, t + length, length, of_end)
            _add(numerical, -1.0, self.distance(end, states[-1]))
            return numerical, by_limiter, of_end, limited

        omega = 2.0
        if self.bounds.limits:
            end_at(omega)
        if self.bounds.limits and self.bounds.takes_energy:
            # R jumps where cells begin to be limited, and such a step is not without dissipation anyway
            omega = 2.0 if wanted is None else wanted
        elif lost > noise:
            from scipy.optimize import brentq  # a tenth of the package's time to be imported

            try:
                omega = brentq(
                    lambda o: sum(end_at(o)[0].values()) / lost, *_RELAXED, xtol=_RELAXATION_TOLERANCE
                )
            except ValueError as error:
                message = (
                    "no end of the relaxed step is without numerical dissipation, as where a wall's velocity "
                    "or a load has a kink: take smaller steps, or relaxation = False"
                )
                raise StepError(message) from error
            if wanted is not None and abs(omega - wanted) <= noise / lost:
                omega = wanted
        numerical, by_limiter, of_end, limited = end_at(omega)
        return omega, numerical | by_limiter, of_end, limited

    def _noise(self, state: Evolved) -> float:
        """Rounding of a distance at ``state``, J: that between states that differ by rounding."""
        signs = np.random.default_rng(0)  # a run does the same again

        def changed(values: np.ndarray) -> np.ndarray:
            return values * (1 + np.finfo(float).eps * signs.choice((-1.0, 1.0), len(values)))

        drawn = []
        for _ in range(_NOISE_DRAWS):
            other = replace(state, values={name: changed(values) for name, values in state.values.items()})
            drawn.append(sum(self.distance(other, state).values()))
        return _NOISE_MARGIN * float(np.sqrt(np.mean(np.square(drawn))))


def _add(total: dict[str, float], weight: float, values: dict[str, float]) -> None:
    for name, value in values.items():
        total[name] = total.get(name, 0.0) + weight * value

"""One Rothe step: from (rho, m, z)_old to the state that a step of length tau leads to, or an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import InputWarning, StepError, StopRequested
from ngvisco.forms.context import time
from ngvisco.forms.impulses import OnSides
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.solver.newton import Newton
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import Attempt, BlockNorm, Interval, Problem, Solution, Status
from ngvisco.solver.split.on_sides import dissipated_on_sides, rows_on_sides
from ngvisco.solver.split.solver import Split
from ngvisco.solver.start import Extrapolation, KeptState
from ngvisco.solver.turns import Turns
from ngvisco.threads import on_arrays

_PARAMETERS = ("tau", "end", "loads_from", "loads_over", "loads_tilt")

_FACTORISED_AT = "state", "state_old", "lagged"
"""Names of the states on which a factorisation depends; a checkpoint stores all of their unknowns."""

_BY_SPLIT = "factorised_by_split"
"""Name of a number in checkpoints. The number is 1 if the stored state of the last factorisation has only the
unknowns on which the split solver iterates."""

_TOO_FAST = 0.8
"""Largest Courant number of the split solver's start value; a faster velocity is scaled down to it. If tau
grad v is above one, the linearised rates of the variables lead away from the solution."""

_SHORTEST, _FACTOR, _LENGTHS = 0.25 / 8**3, 4.0, 20
"""Attempts with steps of growing length: first length as a fraction of the step, factor between two lengths,
and largest number of attempts."""

_TOO_FAR = 0.5
"""Largest change of the velocity by extrapolation, as a Courant number |dv| tau/h. Extrapolated values beyond
it are not tried, as after the first of several long steps."""

_DAMPED = "from the last state, damped"
"""Name of the last attempt, which is for flow rules. In a body that yields with little inertia, undamped
increments would alternate in sign, each as large as the velocity."""


class RotheSolver:
    """Solves a Step, the implicit Euler formula (paper: Euler-large-viscoelastodyn+disc).

    ``defect`` returns the defect of a solution in words (rho <= 0, J <= 0, not finite), or None.  The
    equations of a long step also have solutions of negative density, which are not accepted.
    """

    def __init__(
        self, step: Step, options: NewtonOptions, defect: Callable[[], str | None] = lambda: None
    ) -> None:
        self.step, self.options, self.defect = step, options, defect
        self.ranks = Communicator.of(step.mesh)
        self.exchange = Exchange.of(step.layout.space, self.ranks)
        self.h_min = self.ranks.least(step.context.h.vec.FV().NumPy())
        self.norm = _norm(step, self.exchange)
        self.turns = Turns(step, options, self.ranks)
        """Chooses the solver that takes the steps."""
        self._made: dict[str, Newton | Split] = {}
        self.interrupted: Callable[[], bool] = lambda: False
        """Whether to give up the step; called before each iteration."""
        self._last_tau: float | None = None
        self._factorised: dict[str, KeptState] = {}
        """States of the last factorisation; they are never changed."""
        self._factorised_at: Interval | None = None
        self._stresses: dict[str, np.ndarray] = {}
        """Linearisation stresses of flow rules at the last factorisation."""
        self.start = step.state.vec.CreateVector()
        """The state at which the last step was begun."""
        self._met: list[str] = []
        """Reasons, from all attempts at a step, why an iterate had no finite energy."""
        self.extrapolation = Extrapolation(step)

    @property
    def method(self) -> str:
        """The solver that takes the steps now, ``"coupled"`` or ``"split"``."""
        return self.turns.method

    def turn(self) -> str:
        """Let the other solver take the next steps; return a sentence about it for the user.

        Raises StepError with the reason if the other solver may not be tried.
        """
        if self.turns.obstacle is not None:
            raise StepError(
                f"the {self.turns.other} solver cannot take the step instead, since {self.turns.obstacle}"
            )
        words = self.turns.turn()
        self.newton.reset()
        return words

    def accept(self) -> None:
        """Accept the step that was solved last."""
        before = self.method
        self.turns.accept()
        if self.method != before:
            self.newton.reset()

    def workers(self) -> AbstractContextManager[None]:
        """A context that gives NGSolve's threads to the coupled solver, and takes them from the split solver.

        The split solver works on arrays, and its bits have to be the same in every run: sums that NGSolve's
        threads share differ in the last bits from run to run.
        """
        return nullcontext() if self.method == "coupled" else on_arrays()

    @property
    def newton(self) -> Newton | Split:
        """The present solver, created at the first access: a run that is only read needs no matrices."""
        if self.method not in self._made:
            self._made[self.method] = self._new()
        return self._made[self.method]

    def _new(self) -> Newton | Split:
        step, norm, options, local = self.step, self.norm, self.options, self.step.local_unknowns
        newton: Newton | Split
        if self.method == "split":
            newton = Split(step, norm, options, self.exchange)
            reason = newton.preconditioner.without_multigrid
        else:
            more = local.update_stored, self.exchange, step.stresses, self._has_energy, self._growths
            newton = Newton(step.residual, step.state.vec, norm, local.update, options, *more)
            reason = "the coupled solver, which takes the steps, factorises all unknowns"
        if options.coarse != "direct" and reason is not None:
            message = f"coarse = {options.coarse!r} of the solver has no effect, since {reason}"
            self.ranks.warn(message, InputWarning, stacklevel=5)
        return newton

    def _growths(self) -> int:
        return sum(self.ranks.gathered(self.step.local_unknowns.largest.growths))

    def _has_energy(self) -> bool:
        if not self.ranks.any(len(self.step.without_energy()) > 0):
            return True
        layout, state = self.step.layout, self.step.state.vec.FV().NumPy()
        if self.ranks.all(all(np.isfinite(state[layout.ranges[name]]).all() for name in layout.evolving)):
            self.step.energy.lacked(self.step.now)
        return False

    def on_sides(self, integrands: OnSides) -> dict[str, np.ndarray]:
        """Rows of v of the integrands on the cells' sides, computed by the split solver's arrays; empty with
        the coupled solver."""
        return rows_on_sides(self.newton.residual, integrands) if isinstance(self.newton, Split) else {}

    def dissipated_on_sides(self) -> dict[str, float]:
        """The terms' dissipation on the cells' sides, W, computed by the split solver's arrays; empty with
        the coupled solver."""
        return dissipated_on_sides(self.newton.residual) if isinstance(self.newton, Split) else {}

    def problem(self, interval: Interval) -> RotheProblem:
        """The problem of a step over the interval."""
        return RotheProblem(self, interval)

    def solve(self, interval: Interval) -> list[Attempt]:
        """Solve the step from ``step.old``; ``step.state``, the start value, becomes the solution.

        Returns the step's history, whose last entry is the solution.  Raises StepError, with the history, if
        no solution with positive rho and J is found; the state is then the start value again.
        """
        self.start.data = self.step.state.vec
        self.step.stresses.begin()
        if interval.tau != self._last_tau:
            self.newton.reset()
            self._last_tau = interval.tau
        if self.extrapolation.is_empty:
            self.extrapolation.keep(interval.begin)
        attempts: list[Attempt] = []
        self._met = []
        try:
            for name, guess in self._guesses(interval):
                attempts.append(Attempt(name, self._attempt(interval, guess, name == _DAMPED)))
                if attempts[-1].solution.converged:
                    break
                self.newton.reset()  # the factorisation belongs to iterates that have been given up
            else:
                if self.method == "split" or not self._grows(interval, attempts):
                    failed = [attempt.solution for attempt in attempts if not attempt.solution.converged]
                    reason = failed[-1].reason  # shorter steps may have been solved after the last failure
                    notes = dict.fromkeys(note for note in self._met if note not in reason)
                    raise StepError("; ".join([reason, *notes]), attempts)
        except BaseException:  # also after an interrupt, no iterate may remain
            self.return_to(self.start)
            raise
        self.extrapolation.keep(interval.end)
        return attempts

    def _guesses(self, interval: Interval) -> Iterator[tuple[str, BaseVector]]:
        """Yield the start values in the order of the attempts, with their names for the history."""
        if self.method == "split":
            guess = self.extrapolation.guess(interval.end)
            if guess is not None and self._courant(interval, (guess - self.start).Evaluate()) <= _TOO_FAR:
                yield "from extrapolated values", guess
        guess, courant = self.start.Copy(), self._courant(interval, self.start)
        if self.method == "split" and courant > _TOO_FAST:
            self._velocity(guess)[:] *= _TOO_FAST / courant
        yield "from the last state", guess
        if self.method == "split" and self.step.stresses:
            yield _DAMPED, guess

    def _grows(self, interval: Interval, attempts: list[Attempt]) -> bool:
        """Try steps of growing length, where each solution is the next start value; return whether the whole
        step is solved.

        Steep flow rules, and heat that leaves in long steps, need such start values.
        """
        guess, solved, factor = self.start.Copy(), 0.0, _FACTOR
        length = _SHORTEST
        for left in reversed(range(_LENGTHS)):
            solution = self._attempt(interval.shortened(length), guess)
            attempts.append(Attempt("by growing lengths", solution))
            if solution.converged and length == 1.0:
                return True
            if solution.converged:
                guess.data = self.step.state.vec
                solved, factor = length, min(_FACTOR, factor**1.5)
            elif not solved:
                return False
            else:
                self.newton.reset()
                factor **= 0.5
                if solved * factor**left < 1:  # the attempts that are left cannot reach the whole step
                    return False
            length = min(1.0, solved * factor)
        return False

    def _velocity(self, vector: BaseVector) -> np.ndarray:
        return vector.FV().NumPy()[self.step.layout.ranges["v"]]

    def _courant(self, interval: Interval, values: BaseVector) -> float:
        """The Courant number |v| tau/h from the largest coefficient of v and the smallest cell."""
        return self.ranks.most(abs(self._velocity(values)).max(initial=0.0)) * interval.tau / self.h_min

    def _attempt(self, interval: Interval, guess: BaseVector, damps: bool = False) -> Solution:
        if isinstance(self.newton, Split):
            self.newton.damps = damps
        self.step.energy.last_failure = None
        self.step.local_unknowns.largest.begin()
        self.ranks.forget_notes()
        return self._judged(self.newton.solve(self.problem(interval), guess))

    def return_to(self, values: BaseVector) -> None:
        """Make ``values`` the present state, and drop the solutions found since."""
        self.step.state.vec.data = values
        self.reset()

    def reset(self) -> None:
        """Drop the data of earlier steps. Call this method after anything but a step has set the state."""
        self.extrapolation.drop()
        self.newton.reset()

    def state_dict(self) -> tuple[dict[str, float], dict[str, Any]]:
        """Data of earlier steps on which the next step depends, among them the state of the last
        factorisation.

        A resumed run factorises at this state again, so that it continues bit for bit like the run that wrote
        the data.  The states are not copies; NumPy converts each state to an array of all unknowns.
        """
        numbers, states = self.extrapolation.state_dict()
        numbers |= self.turns.state_dict()
        if self._last_tau is None or not self.newton.is_factorised:
            return numbers, states
        numbers |= {name: getattr(self._factorised_at, name) for name in _PARAMETERS}
        numbers |= {"last_tau": self._last_tau, _BY_SPLIT: float(self.method == "split")}
        if isinstance(self.newton, Split):
            numbers |= self.newton.wear.state_dict()
        return numbers, states | self._factorised | self._stresses

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, Any]) -> None:
        """Restore the data that ``state_dict`` returned; state, old state and time do not change."""
        self.turns.load_state_dict(numbers)
        self.newton.reset()
        self.extrapolation.load_state_dict(numbers, arrays)
        is_split = float(self.method == "split")
        if "last_tau" not in numbers or numbers.get(_BY_SPLIT, is_split) != is_split:
            return
        now, kept = time.Get(), {name: vector.copy() for name, vector in self._vectors().items()}
        parts = {"lagged": self.step.layout.ranges["z"]}
        self._set({name: np.asarray(arrays[name])[parts.get(name, slice(None))] for name in kept})
        self.step.stresses.give(arrays)
        parameters = {name: numbers[name] for name in _PARAMETERS}
        self.newton.factorise(self.problem(Interval(begin=now, **parameters)))
        if isinstance(self.newton, Split):
            self.newton.wear.load_state_dict(numbers)
        self._last_tau = numbers["last_tau"]
        self._set(kept)
        time.Set(now)

    def _vectors(self) -> dict[str, np.ndarray]:
        """Vectors on which a factorisation depends, for reading and writing."""
        functions = {name: getattr(self.step, name) for name in _FACTORISED_AT}
        return {
            name: function.vec.FV().NumPy() for name, function in functions.items() if function is not None
        }

    def _set(self, values: dict[str, np.ndarray]) -> None:
        for name, vector in self._vectors().items():
            vector[:] = values[name]
        self.step.start_from_old()  # the derivative reads m_old, by the numerical heating of backward Euler

    def remember(self, interval: Interval) -> None:
        """Keep the present state, of a step over ``interval``, as the state of the last factorisation."""
        self._factorised_at, self._stresses = interval, self.step.stresses.frozen()
        layout, newton, vectors = self.step.layout, self.newton, self._vectors()
        names = newton.unknowns.names if isinstance(newton, Split) else layout.names
        old = KeptState.of(layout, vectors["state_old"], layout.evolving)
        self._factorised = {"state": KeptState.of(layout, vectors["state"], names), "state_old": old}
        if "lagged" in vectors:
            self._factorised["lagged"] = KeptState(layout, {"z": vectors["lagged"]})

    def _judged(self, solution: Solution) -> Solution:
        """The solution, turned into a failure if its energy is not finite, or rho or J is not positive."""
        energy = self.step.energy
        if not solution.converged:
            self._met += filter(None, [energy.last_failure])
            parts = solution.reason, energy.last_failure, *self.ranks.noted()
            return replace(solution, reason="; ".join(filter(None, parts)))
        reason = energy.failure  # Newton's method does not test the state after its last increment
        if reason is None and (defect := self.defect()) is not None:
            reason = defect
        return solution if reason is None else Solution(Status.INADMISSIBLE, solution.history, reason)


@dataclass(frozen=True)
class RotheProblem(Problem):
    """The equations R(u) = 0 of a solver's step over an interval."""

    solver: RotheSolver
    interval: Interval

    def pose(self) -> None:
        """Set the step's parameters, the time, the velocities of walls at the time, and the units of the
        norm."""
        solver, at = self.solver, self.interval
        solver.step.context.set_step(at.tau, at.end, at.loads_from, at.loads_over, at.loads_tilt)
        solver.step.moving_walls.set_values()
        solver.norm.units["v"] = solver.h_min / at.tau
        solver.norm.units |= dict.fromkeys(solver.norm.shared, 1 / at.tau)

    def poll(self) -> None:
        """Give up the step if the run was asked to stop."""
        if self.solver.ranks.any(self.solver.interrupted()):
            raise StopRequested("the run was asked to stop")

    def factorised(self) -> None:
        """Keep the data that a resumed run needs."""
        self.solver.remember(self.interval)


def _norm(step: Step, exchange: Exchange) -> BlockNorm:
    """The norm of the step's increments."""
    units = {name: step.layout.unknowns[name].scale for name in step.layout.evolving}
    if "rho_delta_hat" in step.layout.ranges:
        units["rho_delta_hat"] = 0.0  # at a uniform density all terms of this equation are cubic
    shared = {"Pi"} & set(step.layout.ranges)
    units |= dict.fromkeys(shared, 0.0)
    ranges, states = dict[str, slice | np.ndarray](step.layout.ranges), step.layout.states
    z = np.r_[step.layout.ranges["z"]].reshape(states.size, -1)
    apart = step.sizes_apart()
    ranges |= {name: z[states.slices[name]].ravel() for name in apart}
    ranges["z"] = np.delete(z, np.r_[0:0, *(states.slices[name] for name in apart)], axis=0).ravel()
    return BlockNorm(ranges, units | apart, exchange, shared)

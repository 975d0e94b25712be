"""One Rothe step: from (rho, m, z)_old to the state that a step of length tau leads to, or an error."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import InputWarning, ParameterError, StepError
from ngvisco.forms.context import time
from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.reduced.by_forms import source_obstacle
from ngvisco.reduced.claims import term_obstacle
from ngvisco.solver.extrapolation import Extrapolation
from ngvisco.solver.newton import Newton
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import Attempt, Interval, NonlinearSolver, RotheProblem, Solution, Status
from ngvisco.solver.sides import Sides
from ngvisco.solver.split.solver import Split
from ngvisco.threads import on_arrays

_PARAMETERS = ("tau", "end", "loads_from", "loads_over")

_FACTORISED_AT = {"state": None, "state_old": None, "wind": "v", "lagged": "z"}
"""What a factorisation depends on, and the unknown that it is of; a checkpoint numbers whole states."""

_TOO_FAST = 0.8
"""Courant number down to which the split solver slows a start value: where tau grad v is above one the
linearised rates of the variables lead away from the solution."""

_SHORTEST, _FACTOR, _LENGTHS = 0.25 / 8**3, 4.0, 20
"""The shortest part of a step that leads to it by growing lengths, the factor between two, and how many."""

_TOO_FAR = 0.5
"""Change of the velocity, |dv| tau/h, above which extrapolation leads it too far: after the first of some
long steps."""

_DAMPED = "from the last state, damped"
"""What is tried last where a flow rule creeps: of yield with little inertia increments are else as long as
the velocity, to and fro."""


class RotheSolver:
    """Solves a Step, the implicit Euler formula (paper: Euler-large-viscoelastodyn+disc).

    Parameters
    ----------
    step : Step
    options : NewtonOptions
    defect : callable, optional
        Says what is wrong with a solution (rho <= 0, J <= 0), or None if nothing is.  The equations of a long
        step have solutions of negative density too; they are not accepted.
    """

    def __init__(
        self,
        step: Step,
        options: NewtonOptions,
        defect: Callable[[], str | None] | None = None,
    ) -> None:
        self.step, self.options = step, options
        self.defect = defect or (lambda: None)
        self.exchange = Exchange.of(step.layout.space, Communicator.of(step.mesh))
        self.h_min = self.exchange.communicator.least(step.context.h.vec.FV().NumPy())
        units = {name: step.layout.unknowns[name].scale for name in step.layout.evolving}
        if "rho_delta_hat" in step.layout.ranges:
            units["rho_delta_hat"] = 0.0  # its equation is cubic where the density is flat
        shared = {"Pi"} & set(step.layout.ranges)
        units |= dict.fromkeys(shared, 0.0)
        ranges = dict(step.layout.ranges)
        for variable in step.model.material.variables:
            if variable.own_scale is not None:
                ranges[variable.name], units[variable.name] = _part(step, variable.name), variable.own_scale
        self.norm = BlockNorm(ranges, units, self.exchange, shared)
        self.method = chosen_method(step, options)
        """``"coupled"`` or ``"split"``."""
        self._last_tau: float | None = None
        self._factorised = {name: step.state.vec.CreateVector() for name in self._vectors()}
        self._factorised_at = dict.fromkeys(_PARAMETERS, 0.0)
        self._stresses: dict[str, np.ndarray] = {}
        """Those that flow rules are linearised at, at the last factorisation."""
        self._start = step.state.vec.CreateVector()
        self.extrapolation = Extrapolation(step)
        self.sides = Sides(step, self.h_min)

    def workers(self) -> AbstractContextManager[None]:
        """Within: NGSolve's for the coupled solver; none for the other.

        It works on arrays; sums that NGSolve shares among threads have other last bits in every run.
        """
        return nullcontext() if self.method == "coupled" else on_arrays()

    @cached_property
    def newton(self) -> NonlinearSolver:
        """Made with the first step: what looks at a run without going on with it needs no matrices."""
        step, norm, options, eliminate = self.step, self.norm, self.options, self.step.eliminate
        if self.method == "split":
            split = Split(step, norm, options, self.exchange)
            self._warn_without_multigrid(split.preconditioner.without_multigrid)
            return split
        self._warn_without_multigrid("the coupled solver, which takes the steps, factorises all unknowns")
        refresh = eliminate.refresh
        stresses = step.stresses
        return Newton(
            step.residual, step.state.vec, norm, eliminate, options, refresh, self.exchange, stresses
        )

    def _warn_without_multigrid(self, reason: str | None) -> None:
        """Say why the options' multigrid has no part in the steps, for which there may be a reason."""
        if self.options.coarse != "direct" and reason is not None:
            message = f"coarse = {self.options.coarse!r} of the solver has no effect: {reason}"
            self.exchange.communicator.warn(message, InputWarning, stacklevel=6)

    def problem(self, interval: Interval) -> RotheProblem:
        """The problem of a step over the interval."""
        return RotheProblem(self.step, self.norm, self.h_min, interval, self.sides, self._remember)

    def solve(self, interval: Interval) -> list[Attempt]:
        """Solve the step from ``step.old``; ``step.state``, the start value, becomes its solution.

        Parameters
        ----------
        interval : Interval

        Returns
        -------
        list of Attempt
            The step's history, the last entry being the solution.

        Raises
        ------
        StepError
            When it has no solution with positive rho and J, or none is found; the state is then the start
            value again, and the error has the history.
        """
        self._start.data = self.step.state.vec
        self.step.stresses.begin()
        if interval.tau != self._last_tau:
            self.newton.reset()
            self._last_tau = interval.tau
        if self.extrapolation.is_empty:
            self.extrapolation.keep(interval.begin)
        attempts: list[Attempt] = []
        try:
            for name, guess in self._guesses(interval):
                attempts.append(Attempt(name, self._attempt(interval, guess, name == _DAMPED)))
                if attempts[-1].solution.converged:
                    self.extrapolation.keep(interval.end)
                    return attempts
                self.newton.reset()  # what was factorised belongs to iterates that have been given up
            if self.method == "coupled" and self._grows(interval, attempts):
                self.extrapolation.keep(interval.end)
                return attempts
            failed = [attempt.solution for attempt in attempts if not attempt.solution.converged]
            raise StepError(failed[-1].reason, attempts)  # shorter steps may have been solved
        except BaseException:  # also an interrupt: never leave an iterate behind
            self.return_to(self._start)
            raise

    def _guesses(self, interval: Interval) -> Iterator[tuple[str, BaseVector]]:
        """Start values in the order in which they are tried, with what a history calls them."""
        if self.method == "split":
            guess = self.extrapolation.guess(interval.end)
            if guess is not None and self._courant(interval, (guess - self._start).Evaluate()) <= _TOO_FAR:
                yield "from extrapolated values", guess
        guess, courant = self._start.Copy(), self._courant(interval, self._start)
        if self.method == "split" and courant > _TOO_FAST:
            guess.FV().NumPy()[self.step.layout.ranges["v"]] *= _TOO_FAST / courant
        yield "from the last state", guess
        if self.method == "split" and self.step.stresses:
            yield _DAMPED, guess

    def _grows(self, interval: Interval, attempts: list[Attempt]) -> bool:
        """Whether steps of growing length, each the start value of the next, lead to the whole one.

        It is stiff creep that the coupled solver needs them for.
        """
        guess, solved, factor = self._start.Copy(), 0.0, _FACTOR
        length = _SHORTEST
        for _ in range(_LENGTHS):
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
            length = min(1.0, solved * factor)
        return False

    def _courant(self, interval: Interval, values: BaseVector) -> float:
        """|v| tau/h of the fastest coefficient and the smallest cell."""
        v = values.FV().NumPy()[self.step.layout.ranges["v"]]
        fastest = self.exchange.communicator.most(abs(v).max(initial=0.0))
        return fastest * interval.tau / self.h_min

    def _attempt(self, interval: Interval, guess: BaseVector, damps: bool = False) -> Solution:
        if isinstance(self.newton, Split):
            self.newton.damps = damps
        self.step.energy.last_failure = None
        self.exchange.communicator.forget_notes()
        velocity = self.extrapolation.velocity(interval.end)
        if velocity is None:
            velocity = self._start.FV().NumPy()[self.step.layout.ranges["v"]]
        self.sides.choose(velocity)
        return self._judged(self.newton.solve(self.problem(interval), guess))

    def return_to(self, values: BaseVector) -> None:
        """Make ``values`` the present state, which the solutions since then do not lead on from."""
        self.step.state.vec.data = values
        self.reset()

    def reset(self) -> None:
        """Drop what is kept of earlier steps, as where the state has been set by other means."""
        self.extrapolation.drop()
        self.newton.reset()

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """What makes the next step depend on earlier ones: where the Jacobian at hand was factorised.

        A restart factorises there again, so that it goes on bit for bit as the run that wrote it.
        """
        numbers, arrays = self.extrapolation.state_dict()
        if self._last_tau is None or not self.newton.is_factorised:
            return numbers, arrays
        numbers |= {**self._factorised_at, "last_tau": self._last_tau}
        arrays |= {name: vec.FV().NumPy().copy() for name, vec in self._factorised.items()}
        return numbers, arrays | self._stresses

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``state_dict`` gave; state, old state and time are left as they are."""
        self.newton.reset()
        self.extrapolation.load_state_dict(numbers, arrays)
        if "last_tau" not in numbers:
            return
        now, kept = time.Get(), {name: vector.copy() for name, vector in self._vectors().items()}
        for name, vector in self._vectors().items():
            vector[:] = arrays[name][self._part(name)]
        self.step.follow_wind()
        self.step.start_from_old()  # by numerical heating, of backward Euler, the derivative has m_old too
        parameters = {name: numbers[name] for name in _PARAMETERS}
        self.step.stresses.give(arrays)
        self.newton.factorise(self.problem(Interval(begin=now, **parameters)))
        self._last_tau = numbers["last_tau"]
        for name, vector in self._vectors().items():
            vector[:] = kept[name]
        self.step.follow_wind()
        self.step.start_from_old()
        time.Set(now)

    def _vectors(self) -> dict[str, np.ndarray]:
        """What a factorisation depends on, for reading and writing."""
        given = {name: getattr(self.step, name) for name in _FACTORISED_AT}
        return {name: each.vec.FV().NumPy() for name, each in given.items() if each is not None}

    def _part(self, name: str) -> slice:
        """Where such a vector's numbers stand in a state's."""
        unknown = _FACTORISED_AT[name]
        return slice(None) if unknown is None else self.step.layout.ranges[unknown]

    def _remember(self, problem: RotheProblem) -> None:
        self._factorised_at = {name: getattr(problem.interval, name) for name in _PARAMETERS}
        self._stresses = self.step.stresses.frozen()
        for name, values in self._vectors().items():
            self._factorised[name].FV().NumPy()[self._part(name)] = values

    def _judged(self, solution: Solution) -> Solution:
        """The solution, which has failed too where its energy is no number or rho or J is not positive."""
        energy = self.step.energy
        if not solution.converged:
            noted = self.exchange.communicator.noted()
            parts = solution.reason, energy.last_failure, *noted
            return replace(solution, reason="; ".join(filter(None, parts)))
        if energy.failure is not None:  # of the last increment, which is added without a test
            return Solution(Status.INADMISSIBLE, solution.history, energy.failure)
        defect = self.defect()
        if defect is None:
            return solution
        reason = f"{defect}: take a smaller step or a finer mesh"
        return Solution(Status.INADMISSIBLE, solution.history, reason)


def chosen_method(step: Step, options: NewtonOptions) -> str:
    """``"coupled"`` or ``"split"``.

    Raises
    ------
    ParameterError
        If ``options.method`` is ``"split"`` for a step that the split solver cannot take.
    """
    if options.method == "auto":
        large = Communicator.of(step.mesh).total(step.mesh.ne) >= options.split.chosen_from[step.mesh.dim - 2]
        return "split" if large and split_obstacle(step) is None else "coupled"
    if options.method == "split" and (obstacle := split_obstacle(step)) is not None:
        raise ParameterError("NewtonOptions.method", options.method, f"'coupled': {obstacle}")
    return options.method


def split_obstacle(step: Step) -> str | None:
    """Why the split solver cannot take this step, or None."""
    ranks = Communicator.of(step.mesh)
    if not ranks.all(is_simplicial(step.mesh)):
        return "the split solver needs a mesh of triangles or tetrahedra only"
    return source_obstacle(step) or term_obstacle(step)


def _part(step: Step, name: str) -> slice:
    """The coefficients of a scalar variable among all."""
    z, states = step.layout.ranges["z"], step.layout.states
    count = (z.stop - z.start) // states.size
    begin = z.start + states.slices[name].start * count
    return slice(begin, begin + count)

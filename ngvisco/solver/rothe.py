"""One Rothe step: from (rho, m, z)_old to the state that a step of length tau leads to, or an error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import InputWarning, ParameterError, StepError, require_type
from ngvisco.forms.context import time
from ngvisco.forms.system import Step
from ngvisco.forms.term_rows import TermRows
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.solver.choice import default_strategies, split_obstacle
from ngvisco.solver.cost import FEWEST, Allowance, CoupledCost
from ngvisco.solver.extrapolation import Extrapolation
from ngvisco.solver.newton import Newton
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.problem import Interval, RotheProblem
from ngvisco.solver.solution import Attempt, NonlinearSolver, Solution, Status
from ngvisco.solver.split.solver import Split
from ngvisco.solver.strategies import Effort, Strategy

_PARAMETERS = ("tau", "end", "loads_from", "loads_over")


class RotheSolver:
    """Solves a Step, the implicit Euler formula (paper: Euler-large-viscoelastodyn+disc).

    Parameters
    ----------
    step : Step
    options : NewtonOptions
    defect : callable, optional
        Says what is wrong with a solution (rho <= 0, J <= 0), or None if nothing is.  The equations of a long
        step have solutions of negative density too; they are not accepted.
    strategies : sequence of Strategy, optional
        How a step is tried to be solved, in this order, in place of those that belong to ``options.method``
        (``ngvisco.solver.choice.default_strategies``).
    announce : callable, optional
        Told in words what a retry costs, while it goes on.

    Raises
    ------
    ParameterError
        If a strategy's solver cannot take the step, or two strategies have one name.
    """

    def __init__(
        self,
        step: Step,
        options: NewtonOptions,
        defect: Callable[[], str | None] | None = None,
        strategies: Sequence[Strategy] | None = None,
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.step, self.options, self.announce = step, options, announce
        self.cost = CoupledCost(step)
        self.defect = defect or (lambda: None)
        self.strategies = tuple(default_strategies(step, options) if strategies is None else strategies)
        if strategies is not None:
            _check(self.strategies, step)
        self.exchange = Exchange.of(step.layout.space, Communicator.of(step.mesh))
        self.h_min = self.exchange.communicator.least(step.context.h.vec.FV().NumPy())
        units = {name: step.layout.unknowns[name].scale for name in step.layout.evolving}
        if "rho_delta_hat" in step.layout.ranges:
            units["rho_delta_hat"] = 0.0  # its equation is cubic where the density is flat
        shared = {"Pi"} & set(step.layout.ranges)
        units |= dict.fromkeys(shared, 0.0)
        self.norm = BlockNorm(step.layout.ranges, units, options.norm, self.exchange, shared)
        tried = [one for one in self.strategies if one.obstacle(step.mesh) is None]
        self.method = (tried or self.strategies)[0].solver
        """The first strategy's solver: it is kept, the other one made where it is needed."""
        self.newton = self.made(self.method)
        self._warn_without_multigrid()
        self.retried = 0
        """Steps that this solver gave up and the other one was asked for."""
        self._last_tau: float | None = None
        self._factorised = {name: step.state.vec.CreateVector() for name in ("state", "state_old")}
        self._factorised_at = dict.fromkeys(_PARAMETERS, 0.0)
        self._start = step.state.vec.CreateVector()
        self.extrapolation = Extrapolation(step)
        self._extrapolates = any(one.extrapolates for one in self.strategies)

    def _warn_without_multigrid(self) -> None:
        """Say why the options' multigrid has no part in the steps."""
        if self.options.coarse == "direct":
            return
        reason: str | None = "the coupled solver, which takes the steps, factorises all unknowns"
        if isinstance(self.newton, Split):
            reason = self.newton.preconditioner.without_multigrid
        if reason is not None:
            message = f"coarse = {self.options.coarse!r} of the solver has no effect: {reason}"
            self.exchange.communicator.warn(message, InputWarning, stacklevel=6)

    def made(self, solver: str, allowance: Allowance | None = None) -> NonlinearSolver:
        """A new solver of this step's equations, ``"coupled"``, which may have an allowance, or
        ``"split"``."""
        step, norm, options = self.step, self.norm, self.options
        if solver == "split":
            return Split(step, norm, options, self.exchange)
        eliminate = step.eliminate
        exchange, refresh = self.exchange, eliminate.refresh
        newton = Newton(step.residual, step.state.vec, norm, eliminate, options, refresh, allowance, exchange)
        newton.rows = lambda: TermRows(step)
        return newton

    def problem(self, interval: Interval) -> RotheProblem:
        """The problem of a step over the interval, with the scheme's upwinding."""
        eta = self.step.context.eta.Get()
        return RotheProblem(self.step, self.norm, self.h_min, interval, eta, self._remember)

    def solve(self, interval: Interval, efforts: Effort = Effort.ALL) -> list[Attempt]:
        """Solve the step from ``step.old``; ``step.state``, the start value, becomes its solution.

        Parameters
        ----------
        interval : Interval
        efforts : Effort
            Strategies of other efforts are left out, as is cheaper for a caller that may take a shorter step.

        Returns
        -------
        list of Attempt
            The step's history, the last entry being the solution.

        Raises
        ------
        StepError
            When no strategy leads to a solution with positive rho and J; the state is then the start value
            again, and the error has the history.
        """
        self._start.data = self.step.state.vec
        if interval.tau != self._last_tau:
            self.newton.reset()
            self._last_tau = interval.tau
        run = _Run(self, self.problem(interval), self._start)
        try:
            if self._extrapolates and self.extrapolation.is_empty:
                self.extrapolation.keep(interval.begin)
            for strategy in self.strategies:
                if strategy.effort in efforts and run.solves(strategy):
                    if self._extrapolates:
                        self.extrapolation.keep(interval.end)
                    return run.attempts
            if Effort.NAMES in efforts:
                run.name_terms()
            raise StepError(run.reason, run.attempts)
        except BaseException:  # also an interrupt: never leave an iterate behind
            self.step.context.eta.Set(run.problem.eta)
            self.return_to(self._start)
            raise

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
        if not self.newton.is_factorised or self._last_tau is None:
            return numbers, arrays
        numbers |= {**self._factorised_at, "last_tau": self._last_tau}
        return numbers, arrays | {name: vec.FV().NumPy().copy() for name, vec in self._factorised.items()}

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``state_dict`` gave; state, old state and time are left as they are."""
        self.newton.reset()
        self.extrapolation.load_state_dict(numbers, arrays)
        if "last_tau" not in numbers:
            return
        step, now = self.step, time.Get()
        kept = {name: getattr(step, name).vec.FV().NumPy().copy() for name in self._factorised}
        for name in self._factorised:
            getattr(step, name).vec.FV().NumPy()[:] = arrays[name]
        parameters = {name: numbers[name] for name in _PARAMETERS}
        self.newton.factorise(self.problem(Interval(begin=now, **parameters)))
        self._last_tau = numbers["last_tau"]
        for name, values in kept.items():
            getattr(step, name).vec.FV().NumPy()[:] = values
        time.Set(now)

    def _remember(self, problem: RotheProblem) -> None:
        self._factorised_at = {name: getattr(problem.interval, name) for name in _PARAMETERS}
        for name, vector in self._factorised.items():
            vector.data = getattr(self.step, name).vec


class _Run:
    """What one step's strategies have tried: the Task that they work on."""

    def __init__(self, rothe: RotheSolver, problem: RotheProblem, start: BaseVector) -> None:
        self.rothe, self.problem, self.start = rothe, problem, start
        self.attempts: list[Attempt] = []
        self._failed: dict[NonlinearSolver, tuple[int, RotheProblem]] = {}
        self._strategy = rothe.strategies[0]
        self._other: NonlinearSolver | None = None
        self._allowance: Allowance | None = None
        self._has_tried = False

    @property
    def state(self) -> BaseVector:
        return self.rothe.step.state.vec

    @property
    def reason(self) -> str:
        """Why the step has failed: the last failure, and what was not tried."""
        failed = [one for one in self.attempts if not one.solution.converged]
        left = [one for one in failed if one.solution.status is Status.NOT_TRIED]
        reasons = [one.solution.reason for one in failed if one not in left][-1:]
        reasons += [one.solution.against for one in failed if one.solution.against][-1:]
        reasons += [f"{one.strategy} was not tried: {one.solution.reason}" for one in left[:1]]
        return "; ".join(reasons) or "no strategy was asked for"

    def solves(self, strategy: Strategy) -> bool:
        """Whether the strategy solves the step."""
        self._strategy = strategy
        obstacle = strategy.obstacle(self.rothe.step.mesh) or self._refusal(strategy)
        if obstacle is not None:
            self.attempts.append(Attempt(strategy.name, Solution(Status.NOT_TRIED, (), obstacle)))
            return False
        solution = strategy.solve(self)
        if solution is None:
            return False
        # of the step itself, of no other width or length
        solved = solution.converged and self.attempts[-1] == Attempt(strategy.name, solution)
        if not solved:
            self.rothe.extrapolation.drop()
        return solved

    def _refusal(self, strategy: Strategy) -> str | None:
        """Why the coupled solver, as the other one, is not asked or asked no more: its time; or None."""
        rothe = self.rothe
        if strategy.solver == rothe.method or strategy.solver != "coupled":
            return None
        is_new = self._allowance is None
        if self._allowance is None:
            self._allowance = Allowance(rothe.cost, rothe.options.retry_seconds, rothe.announce)
        return self._allowance.refusal(FEWEST if is_new else 1)

    def extrapolated(self, farthest: float, largest_change: float) -> BaseVector | None:
        return self.rothe.extrapolation.guess(self.problem.interval.end, farthest, largest_change)

    def attempt(self, problem: RotheProblem, guess: BaseVector, full_steps: int | None = None) -> Solution:
        self.rothe.step.energy.last_failure = None
        self.rothe.exchange.communicator.forget_notes()
        newton = self._newton()
        if self._has_tried:  # what was factorised belongs to iterates that have been given up
            newton.reset()
        self._has_tried = True
        solution = self._judged(newton.solve(problem, guess, full_steps))
        if not solution.converged:
            self._failed.pop(newton, None)
            self._failed[newton] = len(self.attempts), problem
        self.attempts.append(Attempt(self._strategy.name, solution, problem.width, problem.length))
        return solution

    def name_terms(self) -> None:
        """Say of the last failure, of a solver that knows, which terms stood against it."""
        for newton, (number, problem) in reversed(self._failed.items()):
            against = newton.against(problem)
            if against:
                failed = self.attempts[number]
                self.attempts[number] = replace(failed, solution=replace(failed.solution, against=against))
                return

    def _newton(self) -> NonlinearSolver:
        """The solver of the present strategy."""
        rothe, name = self.rothe, self._strategy.solver
        if name == rothe.method:
            return rothe.newton
        rothe.newton.reset()  # it is not where the step will end
        if self._other is None:
            self._other = rothe.made(name, self._allowance)
            if self._allowance is not None:
                rothe.announce(f"the coupled solver is asked: {self._allowance}")
            rothe.retried += 1
        return self._other

    def _judged(self, solution: Solution) -> Solution:
        """The solution, which has failed too where its energy is no number or rho or J is not positive."""
        energy = self.rothe.step.energy
        if not solution.converged:
            parts = solution.reason, energy.last_failure, *self.rothe.exchange.communicator.noted()
            return replace(solution, reason="; ".join(filter(None, parts)))
        if energy.failure is not None:  # of the last increment, which is added without a test
            return Solution(Status.INADMISSIBLE, solution.history, energy.failure)
        defect = self.rothe.defect()
        if defect is None:
            return solution
        reason = f"{defect}: take a smaller step or a finer mesh"
        return Solution(Status.INADMISSIBLE, solution.history, reason)


def _check(strategies: Sequence[Strategy], step: Step) -> None:
    """Raise ParameterError for what are no strategies for this step."""
    for one in strategies:
        require_type("RotheSolver.strategies", one, Strategy)
    names = [one.name for one in strategies]
    if not names or len(set(names)) < len(names):
        raise ParameterError("RotheSolver.strategies", names, "strategies of different names")
    obstacle = split_obstacle(step) if any(one.solver == "split" for one in strategies) else None
    if obstacle is not None:
        raise ParameterError("RotheSolver.strategies", names, f"those of the coupled solver: {obstacle}")

"""Strategies by which a step is solved: each says from which values, by which solver, along which path.

They are tried in order until one converges.  What they need to know of the step is a ``Task``; what they
did is in the step's history, an ``Attempt`` for each nonlinear solve.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto
from typing import ClassVar, Protocol

from ngsolve import BaseVector, Mesh

from ngvisco.errors import ParameterError, require_choice, require_count, require_positive
from ngvisco.parallel.communicator import Communicator
from ngvisco.solver.problem import RotheProblem
from ngvisco.solver.solution import Solution, Status

SOLVERS = ("coupled", "split")


class Effort(Flag):
    """What a strategy costs, by which a caller chooses those that it wants: ``DIRECT | CONTINUATION``."""

    DIRECT = auto()
    """From start values at hand."""
    CONTINUATION = auto()
    """Along a continuation path, by the solver that was chosen."""
    OTHER_SOLVER = auto()
    NAMES = auto()
    """Of a failure: the terms that stand against convergence are named, as the last that is tried."""
    ALL = DIRECT | CONTINUATION | OTHER_SOLVER | NAMES


class Task(Protocol):
    """A step to be solved: the problem, its start value, and the means to try; values are in ``state``."""

    problem: RotheProblem
    start: BaseVector

    @property
    def state(self) -> BaseVector: ...

    def attempt(self, problem: RotheProblem, guess: BaseVector, full_steps: int | None = None) -> Solution:
        """Solve by the strategy's solver from ``guess``, and record it."""

    def extrapolated(self, farthest: float, largest_change: float) -> BaseVector | None:
        """Start values by ``Extrapolation.guess``; None where there are none."""


@dataclass(frozen=True, kw_only=True)
class Strategy(ABC):
    """One way to solve a step."""

    extrapolates: ClassVar[bool] = False
    """Whether it needs the solutions of earlier steps."""
    name: str
    """What the step's history calls it."""
    solver: str = "coupled"
    effort: Effort = Effort.DIRECT
    largest_mesh: tuple[int, int] | None = None
    """Cells, in 2D and in 3D, up to which it is tried."""

    def __post_init__(self) -> None:
        require_choice(self, SOLVERS, solver=self.solver)

    def obstacle(self, mesh: Mesh) -> str | None:
        """Why it is not tried on this mesh, or None."""
        largest = None if self.largest_mesh is None else self.largest_mesh[mesh.dim - 2]
        if largest is None or (cells := int(Communicator.of(mesh).total(mesh.ne))) <= largest:
            return None
        return f"the mesh has {cells} cells, more than {largest}"

    @abstractmethod
    def solve(self, task: Task) -> Solution | None:
        """Solve ``task.problem``, which the last attempt has to be of; None where there is nothing to try."""


@dataclass(frozen=True, kw_only=True)
class FromStartValue(Strategy):
    """Newton's method from the step's start value."""

    courant: float | None = None
    """Courant number v tau/h to which a faster start value is slowed down: where tau grad v is above one the
    linearised rates of the variables lead away from the solution."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.courant is not None:
            require_positive(self, courant=self.courant)

    def solve(self, task: Task) -> Solution:
        guess, number = task.start.Copy(), _courant(task.problem, task.start)
        if self.courant is not None and number > self.courant:
            guess.FV().NumPy()[task.problem.step.layout.ranges["v"]] *= self.courant / number
        return task.attempt(task.problem, guess)


def _courant(problem: RotheProblem, values: BaseVector) -> float:
    """|v| tau/h of the fastest coefficient and the smallest cell."""
    v = values.FV().NumPy()[problem.step.layout.ranges["v"]]
    fastest = Communicator.of(problem.step.mesh).most(abs(v).max(initial=0.0))
    return fastest * problem.interval.tau / problem.h_min


@dataclass(frozen=True, kw_only=True)
class FromExtrapolation(Strategy):
    """Newton's method from values extrapolated through the last two solutions (``Extrapolation.guess``)."""

    extrapolates: ClassVar[bool] = True
    farthest: float = 3.0
    """Distance of the step's end from the last solution, in units of that between the two."""
    largest_change: float = 0.5
    """Of density and elastic variables, in units of their size: to stay in the energy's domain."""
    courant: float = 0.5
    """Largest change of the velocity, |dv| tau/h: after the first of some long steps it leads too far."""

    def __post_init__(self) -> None:
        super().__post_init__()
        numbers = {name: getattr(self, name) for name in ("farthest", "largest_change", "courant")}
        require_positive(self, **numbers)

    def solve(self, task: Task) -> Solution | None:
        guess = task.extrapolated(self.farthest, self.largest_change)
        if guess is None or _courant(task.problem, (guess - task.start).Evaluate()) > self.courant:
            return None
        return task.attempt(task.problem, guess)


@dataclass(frozen=True, kw_only=True)
class ContinuationPath:
    """Values of a parameter that lead to 1, where it is the problem itself."""

    starts: tuple[float, ...]
    """First values, tried in order until one is solved."""
    ratio: float
    """The next value over the last one; nearer to 1 after a failure."""
    tries: int = 20
    """Values tried in all."""

    def __post_init__(self) -> None:
        require_positive(self, ratio=self.ratio)
        require_count(self, tries=self.tries)
        leads = [start > 0 and (start - 1) * (self.ratio - 1) < 0 for start in self.starts]
        if not leads or not all(leads):
            expected = f"values > 0 from which the ratio {self.ratio:g} leads to 1"
            raise ParameterError("ContinuationPath.starts", self.starts, expected)

    def follow(
        self,
        solve: Callable[[float, BaseVector], Solution],
        start: BaseVector,
        state: BaseVector,
        at_once: Callable[[BaseVector], Solution] | None = None,
    ) -> Solution:
        """Solve for values that go to 1, each time from the solution before.

        Parameters
        ----------
        solve : callable
            Solves for a value from a guess; the solution is then in ``state``.
        start : BaseVector
            The first guess.
        at_once : callable, optional
            Solves for 1 from a guess; tried from each solution that the path does not lead on from.
        """
        guess = start.CreateVector()
        guess.data = start
        starts = iter(self.starts)
        value, solved, power = next(starts), None, 1.0
        failure = Solution(Status.TOO_MANY_ITERATIONS, (), "the continuation path does not lead to its end")
        for _ in range(self.tries):
            solution = solve(value, guess)
            if solution.converged:
                if value == 1.0:
                    return solution
                guess.data = state
                solved, power = value, min(1.0, 1.5 * power)
            else:
                failure = solution
                if solved is None:
                    value = next(starts, 0.0)
                    if not value:
                        break
                    continue
                power /= 2
                if at_once is not None:
                    failure = at_once(guess)
                    if failure.converged:
                        return failure
            value = solved * self.ratio**power
            if (value < 1.0) == (self.ratio < 1.0):  # at or beyond the end of the path
                value = 1.0
        return failure


LENGTHS = ContinuationPath(starts=tuple(0.25 / 8**i for i in range(6)), ratio=4.0)
"""Shares of a step's length."""

WIDTHS = ContinuationPath(starts=(1e2, 1e4), ratio=0.1)
"""Widths of the smoothed upwinding: where v.n changes sign on a facet within the step, the elastic force
jumps by [z]:[zeta] across that width.  The sharp problem can have a fold between the old state and the
solution, the soft one has none.  The widest is about the run's velocity: upwinding is then nearly central.
"""


@dataclass(frozen=True, kw_only=True)
class LengthContinuation(Strategy):
    """Steps of growing length, each the start value of the next, up to the whole one."""

    path: ContinuationPath = LENGTHS
    effort: Effort = Effort.CONTINUATION

    def solve(self, task: Task) -> Solution:
        return _lengthened(task, task.problem, self.path)


@dataclass(frozen=True, kw_only=True)
class UpwindingContinuation(Strategy):
    """The step with wide upwinding, which is narrowed to the scheme's."""

    path: ContinuationPath = WIDTHS
    """Widths in units of the scheme's."""
    lengths: ContinuationPath | None = LENGTHS
    """By steps of growing length the widest problem is solved where nothing else leads to it: where creep is
    stiff and z jumps from cell to cell."""
    full_steps: int | None = None
    """Undamped Newton steps tried from a soft solution to the sharp one, where the path between them folds,
    by the coupled solver.  Across a fold the sign of v.n changes on a facet: the sharp equation is nearly
    piecewise smooth, and full steps change such signs as damped ones cannot."""
    effort: Effort = Effort.CONTINUATION

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.full_steps is not None:
            require_count(self, full_steps=self.full_steps)
            if self.solver != "coupled":
                expected = "None: only the coupled solver takes undamped steps"
                raise ParameterError("UpwindingContinuation.full_steps", self.full_steps, expected)

    def solve(self, task: Task) -> Solution:
        problem, steps = task.problem, self.full_steps

        def solve(width: float, guess: BaseVector) -> Solution:
            wide = problem.widened(width)
            solution = task.attempt(wide, guess)
            if solution.converged or self.lengths is None or width < max(self.path.starts):
                return solution
            return _lengthened(task, wide, self.lengths)

        at_once = None if steps is None else lambda guess: task.attempt(problem, guess, steps)
        return self.path.follow(solve, task.start, task.state, at_once)


def _lengthened(task: Task, problem: RotheProblem, path: ContinuationPath) -> Solution:
    return path.follow(
        lambda length, guess: task.attempt(problem.shortened(length), guess), task.start, task.state
    )

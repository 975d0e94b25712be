"""What a nonlinear solver is asked, and what it answers: the problem of a Rothe step, and its solution.

A solver is made for equations R(u) = 0 whose parameters a ``Problem`` sets.  It answers with a ``Solution``,
also where it finds none: it raises for a fault of the program only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from ngsolve import BaseVector

from ngvisco.forms.system import Step
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.sides import Sides


class Status(Enum):
    """How an attempt ended; the value says it in words."""

    CONVERGED = "converged"
    TOO_MANY_ITERATIONS = "too many iterations"
    STALLED = "no step length reduces the increment"
    NOT_FINITE = "the residual is not finite"
    SINGULAR = "a linear system has no factorisation"
    INADMISSIBLE = "the solution of the equations is not admissible"


@dataclass(frozen=True)
class NewtonIteration:
    """One line of a solver's history: increment and contraction in the norm of ``ngvisco.solver.norm``."""

    increment: float
    contraction: float
    damping: float
    fresh_jacobian: bool


@dataclass(frozen=True)
class Solution:
    """The end of an attempt; its values are in the state that the solver was made for.

    Attributes
    ----------
    status : Status
    history : tuple of NewtonIteration
    reason : str
        Why it failed, with figures and what may help; empty where it converged.
    """

    status: Status
    history: tuple[NewtonIteration, ...] = ()
    reason: str = ""

    @property
    def converged(self) -> bool:
        return self.status is Status.CONVERGED


@dataclass(frozen=True)
class Attempt:
    """One entry of a step's history: from which start values a solution was sought, and what came of it."""

    start: str
    solution: Solution


def iterations(attempts: Iterable[Attempt]) -> list[NewtonIteration]:
    """All iterations of some attempts, in their order."""
    return [line for attempt in attempts for line in attempt.solution.history]


class Problem(Protocol):
    """A choice of the parameters of the equations that a solver was made for."""

    def pose(self) -> None:
        """Give the equations these parameters, and the state the values that they prescribe."""

    def changes(self, increment: float) -> bool:
        """Whether the equations change with the iterate, which is in the state and was reached by an
        increment of this size; they do no more where the increments are small.  By default never."""
        return False

    def factorised(self) -> None:
        """Called when the derivative has been factorised at the present state; nothing by default."""
        return


class NonlinearSolver(Protocol):
    """Solves problems of one set of equations; keeps a factorised derivative between them."""

    @property
    def is_factorised(self) -> bool:
        """Whether the next solve begins with a factorisation at hand."""

    def solve(self, problem: Problem, guess: BaseVector) -> Solution:
        """Iterate from ``guess``; the state is then the solution, or some iterate where there is none."""

    def factorise(self, problem: Problem) -> None:
        """Factorise the derivative at the present state; raises StepError if it is singular."""

    def reset(self) -> None:
        """Drop the factorisation."""


@dataclass(frozen=True)
class Interval:
    """A Rothe step in time, s: its length, where it begins and ends, and over what its loads are averaged.

    For the paper's scheme ``tau`` = end - begin, and loads are averaged over the same.  A stage of another
    scheme may start from a combination of states, which belongs to no time: ``begin`` is then that of the
    state which is its start value.
    """

    tau: float
    begin: float
    end: float
    loads_from: float
    loads_over: float

    def shortened(self, fraction: float) -> Interval:
        """The step with a part of the length, as a start value of the whole one."""
        end = self.end if fraction == 1.0 else self.begin + fraction * (self.end - self.begin)
        loads_from = self.loads_from if self.loads_over > 0 else end
        return Interval(fraction * self.tau, self.begin, end, loads_from, fraction * self.loads_over)


@dataclass(frozen=True)
class RotheProblem:
    """R(u) = 0 of a step over an interval from the old state that ``step`` holds."""

    step: Step
    norm: BlockNorm
    """Its unit of velocity becomes ``h_min``/tau."""
    h_min: float
    """Smallest cell size, m."""
    interval: Interval
    sides: Sides
    on_factorise: Callable[[RotheProblem], None]
    """Called when the problem's derivative has been factorised at the present state."""

    def pose(self) -> None:
        """Set the step's parameters, the time and the velocities of walls, also those of v*."""
        interval = self.interval
        self.step.context.set_step(interval.tau, interval.end, interval.loads_from, interval.loads_over)
        self.step.moving_walls.set_values()
        self.sides.take_walls()
        self.norm.units["v"] = self.h_min / interval.tau
        self.norm.units |= dict.fromkeys(self.norm.shared, 1 / interval.tau)

    def changes(self, increment: float) -> bool:
        return self.sides.change(increment)

    def factorised(self) -> None:
        self.on_factorise(self)

"""The problem of one Rothe step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ngvisco.forms.system import Step
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.sides import Sides


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

"""A ledger that does not close: said at once, and once more at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ngvisco.errors import NgviscoWarning

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

CLOSED = 1e-8
"""|closure_relative| up to which a ledger counts as closed, whatever the solver's tolerance."""
_PER_TOLERANCE = 100.0


def closure_limit(tolerance: float) -> float:
    """Largest |closure_relative| of a ledger that closes, for a solver's tolerance."""
    return max(CLOSED, _PER_TOLERANCE * tolerance)


class ClosureWarning(NgviscoWarning):
    """The energy ledger of a step does not close: the state does not solve the step's equations."""


class ClosureCheck:
    """Compares every row's ``closure_relative`` with a limit.

    The limit is 1e-8, or 100 times the solver's tolerance where that is more.  The first row above it is a
    ClosureWarning.

    Attributes
    ----------
    failures : int
        Rows above the limit so far.
    worst : float
        Largest |closure_relative| among them (NaN counts as infinite).
    worst_step, worst_time : int, float
        Its step, and that one's end, s.
    """

    def __init__(self, tolerance: float) -> None:
        self.limit = closure_limit(tolerance)
        self.failures, self.worst, self.worst_step, self.worst_time = 0, 0.0, 0, 0.0

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        closure = abs(row["closure_relative"])
        if closure <= self.limit or simulation.rothe_step.sources is not None:
            return  # the power of a manufactured solution's sources has no entry
        self.failures += 1
        if not closure <= self.worst:
            self.worst = closure if closure == closure else float("inf")
            self.worst_step, self.worst_time = int(row["step"]), row["time"]
        if self.failures == 1:
            simulation.ranks.warn(self.message, ClosureWarning, stacklevel=2)

    @property
    def message(self) -> str:
        """What is wrong, in words; of a run without failures nothing."""
        if not self.failures:
            return ""
        plural = "s" if self.failures > 1 else ""
        return (
            f"THE LEDGER DOES NOT CLOSE in {self.failures} step{plural}: |closure_relative| is "
            f"{self.worst:.1e} in step {self.worst_step}, t = {self.worst_time:.4g} s, the limit "
            f"{self.limit:.0e}; energy is gained or lost that no term accounts for, and the results "
            "are not to be trusted"
        )

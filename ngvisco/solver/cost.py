"""What the coupled solver costs: estimated from the mesh before it is asked, measured once it is, and
bounded."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from functools import cached_property
from itertools import islice

from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator

_ASSEMBLY = (1.0e-7, 2.3e-7)
"""Seconds in 2D and 3D over the square of a cell's unknowns: measured on 24 to 654 triangles and 28 to 250
tetrahedra, by F and J and by E, one thread; they agree to a tenth."""

_FACTORISATION = ((7_488, 0.10, 1.3), (25_630, 1.6, 2.0))
"""Condensed unknowns, seconds for these, and the power of others: UMFPACK, the same meshes."""

FEWEST = 5
"""Iterations with a Jacobian of their own that a retry takes at least: Newton from values that another
solver has given up, and a continuation."""


class CoupledCost:
    """Seconds of an iteration of the coupled solver with a Jacobian of its own; over ranks of the slowest."""

    def __init__(self, step: Step) -> None:
        self.step, self.ranks = step, Communicator.of(step.mesh)
        self.measured: float | None = None
        """That of the last one in this run, s; None before."""

    @cached_property
    def unknowns(self) -> int:
        """Of the condensed system; what ranks share counts on each."""
        return int(self.ranks.total(sum(self.step.layout.space.FreeDofs(True))))

    @cached_property
    def estimate(self) -> float:
        """From the numbers of cells and unknowns, s."""
        space, mesh = self.step.layout.space, self.step.mesh
        of_cell = max((len(cell.dofs) for cell in islice(space.Elements(), 1)), default=0)
        size, seconds, power = _FACTORISATION[mesh.dim - 2]
        assembly = _ASSEMBLY[mesh.dim - 2] * self.ranks.most(mesh.ne * of_cell**2)
        return assembly + seconds * (self.unknowns / size) ** power

    @property
    def seconds(self) -> float:
        """As measured in this run, else as estimated, s."""
        return self.estimate if self.measured is None else self.measured

    def __str__(self) -> str:
        how = "estimated" if self.measured is None else "measured"
        return f"{self.seconds:.2g} s for an iteration, {how}, with {self.unknowns} unknowns"


class Allowance:
    """The seconds that the coupled solver may take for one step.

    Nothing interrupts a factorisation: it is not begun where it would not end in time.
    """

    def __init__(self, cost: CoupledCost, bound: float, announce: Callable[[str], None]) -> None:
        self.cost, self.bound, self._announce = cost, bound, announce
        self._began = clock.perf_counter()

    def __str__(self) -> str:
        return f"{self.cost}; a step takes 10 to 100; {self.bound:g} s at most (NewtonOptions.retry_seconds)"

    @property
    def spent(self) -> float:
        return clock.perf_counter() - self._began

    def refusal(self, iterations: int = 1) -> str | None:
        """Why no more iterations are begun, or None; of all ranks together."""
        if not self.cost.ranks.any(self.spent + iterations * self.cost.seconds > self.bound):
            return None
        spent = f"{self.spent:.2g} s are spent, " if self.spent > 0.01 * self.bound else ""
        return (
            f"the coupled solver may take {self.bound:g} s for a step (NewtonOptions.retry_seconds); {spent}"
            f"{self.cost}, {iterations} more at least"
        )

    def measured(self, seconds: float) -> None:
        """Note what an iteration took; the first one is told of."""
        seconds = self.cost.ranks.most(seconds)
        if self.cost.measured is None:
            estimate = self.cost.estimate
            self._announce(
                f"the coupled solver takes {seconds:.2g} s for an iteration, estimated {estimate:.2g} s"
            )
        self.cost.measured = seconds

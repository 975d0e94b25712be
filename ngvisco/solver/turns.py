"""Chooses the solver that takes the steps: one at the start, and with "auto" the other one after a failure.

If the present solver does not solve a step of any length, the other one takes the next ``WAIT`` steps. The
number of these steps doubles after each return to the first solver.
"""

from __future__ import annotations

from functools import cached_property

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.reduced.declared import term_obstacle
from ngvisco.reduced.source import source_obstacle
from ngvisco.solver.options import NewtonOptions

WAIT = 16
"""Number of steps that the other solver takes before the first one is tried again."""

AT_MOST = (300_000, 60_000)
"""Largest number of unknowns after condensation, in 2D and in 3D, with which the coupled solver takes over
from the split one; a factorisation of this size takes some seconds and a few GB."""


class Turns:
    """Holds the present solver, and the number of steps until the first solver is tried again.

    Raises ParameterError if the options name a solver that cannot take the step.
    """

    def __init__(self, step: Step, options: NewtonOptions, ranks: Communicator) -> None:
        self.step, self.options, self.ranks = step, options, ranks
        self.first = chosen_method(step, options)
        self.method = self.first
        """The present solver, ``"coupled"`` or ``"split"``."""
        self._left, self._wait = 0, WAIT

    @property
    def other(self) -> str:
        """The solver that does not take the steps at present."""
        return "coupled" if self.method == "split" else "split"

    @cached_property
    def obstacle(self) -> str | None:
        """The reason why only the first solver is tried; None if both solvers may be tried."""
        if self.options.method != "auto":
            return f"solver.method is {self.options.method!r}"
        if self.first == "coupled":
            return split_obstacle(self.step, self.ranks)
        free = int(self.ranks.total(sum(self.step.layout.space.FreeDofs(True))))
        most = AT_MOST[self.step.mesh.dim - 2]
        if free > most:
            return f"the coupled solver would have {free} unknowns to factorise, more than {most}"
        return None

    def turn(self) -> str:
        """Take the other solver; return a sentence about it for the user."""
        self.method = self.other
        self._left = self._wait
        return f"the {self.method} solver tries this step and, on success, takes the next {self._left} steps"

    def accept(self) -> None:
        """Count an accepted step; return to the first solver when the other one has taken its number of
        steps."""
        if self.method == self.first:
            return
        self._left -= 1
        if self._left <= 0:
            self.method, self._wait = self.first, 2 * self._wait

    def state_dict(self) -> dict[str, float]:
        """Numbers that a checkpoint stores; none if the first solver has never failed."""
        if self.method == self.first and self._wait == WAIT:
            return {}
        is_other = float(self.method != self.first)
        return {"turned": is_other, "turn_left": float(self._left), "turn_wait": float(self._wait)}

    def load_state_dict(self, numbers: dict[str, float]) -> None:
        """Restore the data that ``state_dict`` returned."""
        self.method = self.first
        if numbers.get("turned") and self.obstacle is None:
            self.method = self.other
        self._left, self._wait = int(numbers.get("turn_left", 0)), int(numbers.get("turn_wait", WAIT))


def split_obstacle(step: Step, ranks: Communicator) -> str | None:
    """The reason why the split solver cannot take a step; None if it can."""
    if not ranks.all(is_simplicial(step.mesh)):
        return "the split solver needs a mesh of triangles or tetrahedra only"
    return source_obstacle(step) or term_obstacle(step)


def chosen_method(step: Step, options: NewtonOptions) -> str:
    """The solver with which a run begins, ``"coupled"`` or ``"split"``.

    Raises ParameterError if ``options.method`` is ``"split"`` for a step that the split solver cannot take.
    """
    ranks = Communicator.of(step.mesh)
    if options.method == "coupled":
        return "coupled"
    is_chosen = options.method == "split"
    if not is_chosen and ranks.total(step.mesh.ne) < options.split.chosen_from[step.mesh.dim - 2]:
        return "coupled"
    obstacle = split_obstacle(step, ranks)
    if is_chosen and obstacle is not None:
        raise ParameterError("NewtonOptions.method", options.method, f"'coupled', since {obstacle}")
    return "split" if obstacle is None else "coupled"

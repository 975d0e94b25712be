"""Which of the two solvers solves a step, and what is tried where it fails."""

from __future__ import annotations

from dataclasses import replace

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.reduced.claims import term_obstacle
from ngvisco.reduced.right_hand_side import source_obstacle
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.strategies import (
    WIDTHS,
    Effort,
    FromExtrapolation,
    FromStartValue,
    LengthContinuation,
    Strategy,
    UpwindingContinuation,
)


def default_strategies(step: Step, options: NewtonOptions) -> tuple[Strategy, ...]:
    """What is tried for this step, in order.

    Raises
    ------
    ParameterError
        If ``options.method`` is ``"split"`` for a step that the split solver cannot take.
    """
    coupled: tuple[Strategy, ...] = (
        FromStartValue(name="coupled"),
        UpwindingContinuation(name="coupled, wide upwinding", full_steps=12),
        LengthContinuation(name="coupled, growing step"),
    )
    if chosen_method(step, options) == "coupled":
        return coupled
    largest = options.split.coupled_up_to
    return (
        FromExtrapolation(name="split, extrapolated start", solver="split"),
        FromStartValue(name="split", solver="split", courant=0.8),
        # fewer widths than the coupled solver's, which comes after it
        UpwindingContinuation(
            name="split, wide upwinding", solver="split", path=replace(WIDTHS, tries=6), lengths=None
        ),
        *(replace(one, effort=Effort.OTHER_SOLVER, largest_mesh=largest) for one in coupled),
    )


def chosen_method(step: Step, options: NewtonOptions) -> str:
    """``"coupled"`` or ``"split"``."""
    obstacle = split_obstacle(step)
    if options.method == "split" and obstacle is not None:
        raise ParameterError("NewtonOptions.method", options.method, f"'coupled': {obstacle}")
    if options.method == "auto":
        large = Communicator.of(step.mesh).total(step.mesh.ne) >= options.split.chosen_from[step.mesh.dim - 2]
        return "split" if large and obstacle is None else "coupled"
    return options.method


def split_obstacle(step: Step) -> str | None:
    """Why the split solver cannot take this step, or None."""
    ranks = Communicator.of(step.mesh)
    if not ranks.all(is_simplicial(step.mesh)):
        return "the split solver needs a mesh of triangles or tetrahedra only"
    return source_obstacle(step) or term_obstacle(step)

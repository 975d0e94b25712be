"""Which of the two solvers solves the steps."""

from __future__ import annotations

from ngvisco.errors import ParameterError
from ngvisco.forms.mesh.mesh_arrays import is_simplicial
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.reduced.claims import term_obstacle
from ngvisco.reduced.right_hand_side import source_obstacle
from ngvisco.solver.options import NewtonOptions


def chosen_method(step: Step, options: NewtonOptions) -> str:
    """``"coupled"`` or ``"split"``.

    Raises
    ------
    ParameterError
        If ``options.method`` is ``"split"`` for a step that the split solver cannot take.
    """
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

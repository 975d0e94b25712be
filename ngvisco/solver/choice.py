"""Which of the two solvers solves a step."""

from __future__ import annotations

from ngsolve import ET, VOL, Mesh

from ngvisco.errors import ParameterError
from ngvisco.forms.system import Step

SPLIT_FROM = {2: 400, 3: 60}
"""Cells, by dimension, from which the split solver is the faster one (tests/benchmarks)."""

COUPLED_UP_TO = {2: 20_000, 3: 1_000}
"""Cells up to which the coupled solver's factorisation fits a workstation."""


def chosen_method(step: Step, method: str) -> str:
    """``"coupled"`` or ``"split"``.

    Raises
    ------
    ParameterError
        If ``method`` is ``"split"`` for a step that the split solver cannot take.
    """
    obstacle = split_obstacle(step)
    if method == "split" and obstacle is not None:
        raise ParameterError("NewtonOptions.method", method, f"'coupled': {obstacle}")
    if method == "auto":
        large = step.mesh.ne >= SPLIT_FROM[step.mesh.dim]
        return "split" if large and obstacle is None else "coupled"
    return method


def split_obstacle(step: Step) -> str | None:
    """Why the split solver cannot take this step, or None."""
    if any(element.type not in (ET.TRIG, ET.TET) for element in step.mesh.Elements(VOL)):
        return "the split solver needs a mesh of triangles or tetrahedra only"
    if step.has_sources:
        return "further terms (sources) are for the coupled solver"
    return None


def is_affordable(mesh: Mesh) -> bool:
    """Whether the coupled solver can be asked where the split one fails."""
    return mesh.ne <= COUPLED_UP_TO[mesh.dim]

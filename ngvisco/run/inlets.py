"""Warning about given inflow values whose stress differs from the body's stress at the inlet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.boundary.wall_terms import Carried

if TYPE_CHECKING:
    from ngvisco.forms.system import Step

_MATTERS = 0.01
"""Share of all powers that matter may lose where it flows in; a run warns of a larger one."""


class InflowWarning(NgviscoWarning):
    """Given inflow values have another stress than the body inside: a jump stays at the inlet."""


def inflow_message(step: Step, row: Mapping[str, float]) -> str:
    """Warning about walls in a ledger's row whose given strains lose much energy; empty for little.

    Bodies and temperatures mix by their nature: their values bring no warning.
    """
    if step.model.bodies:
        return ""
    strains = {v.name for v in step.model.material.variables if v.is_strain}
    worked = sum(
        abs(value)
        for name, value in row.items()
        if name.startswith(("power_", "dissipation_")) and not name.startswith("power_stored_")
    )
    for wall in (term for term in step.terms if isinstance(term, Carried)):
        named: Any = step.walls.conditions[wall.name]
        given = sorted(strains & named.values.keys())
        lost = row[f"dissipation_inflow_{wall.name}"]
        if given and lost > _MATTERS * worked:
            names = ", ".join(given)
            return (
                f"at t = {row['time']:.4g} s what flows in through {wall.name!r} by the values of {names} "
                "that are given has another stress than the body inside: where both meet "
                f"{lost:.3g} W are lost, {lost / worked:.0%} of all powers, and a jump stays there; give "
                "values (and a density) that belong to the stress at the wall, or none: then matter comes "
                "in as it is inside"
            )
    return ""

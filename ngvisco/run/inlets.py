"""Warnings about inflows whose values do not belong to the stress at the wall."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.given_values import is_let_in_by_pressure

if TYPE_CHECKING:
    from ngvisco.forms.system import Step

_MATTERS = 0.01
"""Share of all powers that matter may lose where it flows in, and of the mass that may come in with a density
that nothing determines; a run warns of a larger one."""


class InflowWarning(NgviscoWarning):
    """An inflow has another stress than the body inside, or a density that nothing determines."""


def inflow_message(step: Step, row: Mapping[str, float]) -> str:
    """Warning about walls in a ledger's row whose given strains lose much energy, or whose pressure lets in a
    fluid of unknown density; empty for little.

    Bodies and temperatures mix by their nature: their values bring no warning.
    """
    if step.model.bodies:
        return ""
    law = step.model.material
    strains = {v.name for v in law.variables if v.is_strain}
    worked = sum(
        abs(value)
        for name, value in row.items()
        if name.startswith(("power_", "dissipation_")) and not name.startswith("power_stored_")
    )
    for wall in step.passages:
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
        entered = row[f"inflow_{wall.name}"] * row["time"]
        is_open = law.referential_density is None and is_let_in_by_pressure(named, law)
        if is_open and entered > _MATTERS * row["mass"]:
            return (
                f"at t = {row['time']:.4g} s a fluid comes in through {wall.name!r} at a pressure, and with "
                "the density of the cell inside, since the material has no rho_R that belongs to the "
                "pressure; give rho_R, or the wall's density and values"
            )
    return ""

"""Warnings about inflows whose values do not belong to the stress at the wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


class Inlets:
    """Warns of inflows through a run's walls; it sums the mass that came in through each of them.

    Temperatures mix by their nature: they bring no warning.  Bodies whose amounts are given come in
    unstrained.
    """

    def __init__(self, step: Step) -> None:
        law = step.model.material
        self._strains = {v.name for v in law.variables if v.is_strain}
        self._walls: dict[str, Any] = {wall.name: step.walls.conditions[wall.name] for wall in step.passages}
        """The walls that matter crosses, by name."""
        is_known = law.referential_density is not None
        let_in = (name for name, wall in self._walls.items() if is_let_in_by_pressure(wall, law))
        self._entered = dict.fromkeys(() if is_known else let_in, 0.0)
        """Mass, kg, that came in with a density that nothing determines, by the wall's name."""

    def resume(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Go on after the ledger's ``rows``."""
        self._entered = dict.fromkeys(self._entered, 0.0)
        for row in rows:
            self._add(row)

    def _add(self, row: Mapping[str, float]) -> None:
        for name in self._entered:
            self._entered[name] += max(row[f"inflow_{name}"], 0.0) * row["dt"]

    def message(self, row: Mapping[str, float]) -> str:
        """A warning about the step of a ledger's row, each step's row once; empty for little."""
        self._add(row)
        worked = sum(
            abs(value)
            for name, value in row.items()
            if name.startswith(("power_", "dissipation_")) and not name.startswith("power_stored_")
        )
        for name, wall in self._walls.items():
            named = sorted(self._strains & wall.values.keys())
            given = f"values of {', '.join(named)}" if named else "amounts" if wall.amounts else ""
            lost = row[f"dissipation_inflow_{name}"]
            if given and lost > _MATTERS * worked:
                return (
                    f"at t = {row['time']:.4g} s what flows in through {name!r} by the {given} that are "
                    "given has another stress than the body inside: where both "
                    f"meet {lost:.3g} W are lost, {lost / worked:.0%} of all powers, and a jump stays there; "
                    "give values (and a density) that belong to the stress at the wall, or none: then matter "
                    "comes in as it is inside"
                )
        for name, entered in self._entered.items():
            if entered > _MATTERS * row["mass"]:
                return (
                    f"at t = {row['time']:.4g} s a fluid comes in through {name!r} at a pressure, and with "
                    "the density of the cell inside, since the material has no rho_R that belongs to the "
                    "pressure; give rho_R, or the wall's density and values"
                )
        return ""

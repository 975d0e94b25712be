"""What a run says of itself once, at its end: that its time scheme dissipated more than its model."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ngvisco.forms.distance import NUMERICAL

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

NEGLIGIBLE = 1e-3
"""Share of the energy that was there to be moved, below which the scheme's dissipation is no matter."""


def dissipation_advice(simulation: Simulation) -> str | None:
    """A sentence where the scheme's own dissipation exceeds the model's, or None.

    The energy there was to be moved is the largest kinetic energy, or change of the stored one, plus the work
    done by loads and walls.
    """
    ledger = simulation.ledger
    if len(ledger.rows) < 2:
        return None
    dt = ledger.column("dt")

    def total(kind: str) -> float:
        return float(sum(dt @ ledger.column(entry.name) for entry in ledger.entries if entry.kind == kind))

    numerical = float(sum(ledger.column(name).sum() for name in NUMERICAL))  # not what a transfer took
    physical = total("dissipation")
    stored = ledger.column("stored")
    moved = max(ledger.column("kinetic").max(), abs(stored - stored[0]).max()) + abs(total("power"))
    if numerical <= max(physical, NEGLIGIBLE * moved):
        return None
    scheme = simulation.scheme
    said = f"the time scheme {scheme.name} dissipated {numerical:.3g} J, the model {physical:.3g} J: "
    if scheme.order > 1:
        return said + "take a smaller dt"
    return said + (
        "take scheme = 'midpoint' (second order, one solve a step), 'sdirk2' where stiff parts are to be "
        "damped, or a much smaller dt"
    )

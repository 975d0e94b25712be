"""Parameters of adaptive step lengths, and the bound on the growth of damage in a step.

The damage grows after a step by the strains at the step's end (``ngvisco.forms.damage``): a crack grows as
far as these strains let it, and the matter around the crack is unloaded only in the next step.  The load at
which a body breaks has an error in proportion to the growth in a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from ngvisco.errors import NgviscoWarning, ParameterError, Quantity, require_fields
from ngvisco.forms.damage import CRACKED, GROWTH
from ngvisco.forms.system import Step
from ngvisco.words import Words, call

MUCH = 0.1
"""Growth of the damage at a point in a step, above which a run warns."""


class DamageWarning(NgviscoWarning):
    """Damage grew by much in one step: the load at which a body breaks depends on the step's length."""


def growth_message(step: Step, row: Mapping[str, float]) -> str:
    """Warning about the damage's growth in the step of a ledger's row; empty for little growth."""
    if step.damage is None or row[GROWTH] <= MUCH:
        return ""
    length = step.damage.length
    unit, symbol, size = (
        ("m", "Damaged.length", length) if step.mesh.dim == 2 else ("m^2", "Damaged.length^2", length**2)
    )
    return Words(
        f"in the step of {row['dt']:.3g} s to t = {row['time']:.4g} s the damage grew by {row[GROWTH]:.2g} "
        f"at a point, and new cracks have {row[CRACKED]:.3g} {unit}, {row[CRACKED] / size:.2g} times "
        f"{symbol}. The load at which the body breaks then depends on the step's length. Take shorter steps "
        "while damage grows, as with ",
        call("AdaptiveSteps", damage_growth=0.05),
    )


@dataclass(frozen=True, kw_only=True)
class AdaptiveSteps:
    """Adaptive step lengths between two bounds; the first step has the simulation's ``dt``.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    dt_min : float
        Shortest step, except for steps that end at an output time; a run that needs a shorter step ends.
    dt_max : float
        Longest step.
    tolerance : float, optional
        Bound on the relative error of a step in velocity, density and elastic strain, which the scheme
        estimates (the ledger's error_estimate).  Errors of a temperature count relative to the absolute
        temperature.  The first step, and in a scheme of order 2 the second step, has no estimate, so that dt
        has to be short.  Without a tolerance only steps that are not solved are shortened.
    patience : int
        Number of accepted steps in a row after which the length is doubled.  With a tolerance, this holds
        only for steps without an estimate of the error.
    damage_growth : float, optional
        Largest growth of the damage at a point in a step, for a material that breaks. A step with more
        growth is repeated with a shorter length, down to dt_min, where any growth is accepted. The load at
        which a body breaks has a relative error of about damage_growth.
    """

    dt_min: Annotated[float, Quantity("s", "> 0", 1e-3)]
    dt_max: Annotated[float, Quantity("s", "> 0", 0.1)]
    tolerance: Annotated[float | None, Quantity("1", "> 0", 1e-3)] = None
    patience: Annotated[int, Quantity("1", ">= 1")] = 4
    damage_growth: Annotated[float | None, Quantity("1", "in (0, 1]", 0.05)] = None

    def __post_init__(self) -> None:
        require_fields(self)
        if self.dt_max < self.dt_min:
            raise ParameterError("AdaptiveSteps.dt_max", self.dt_max, f"at least dt_min = {self.dt_min:g}")


class GrowthControl:
    """Bounds the growth of the damage at a point in a step by ``most``; with None growth has no bound."""

    def __init__(self, most: float | None, dt_min: float) -> None:
        self.most, self.dt_min = most, dt_min

    def require(self, step: Step) -> None:
        """Raise ParameterError if growth is bounded and the material does not break."""
        if self.most is not None and step.damage is None:
            damaged = call("Damaged", material=...)
            expected = (None, " for a material without damage; ", damaged, " has damage")
            raise ParameterError("AdaptiveSteps.damage_growth", self.most, *expected)

    def allowed(self, tau: float, rates: Mapping[str, float], safety: float) -> float:
        """The step length, s, in which the damage would have grown by ``safety`` times the largest growth.

        ``rates`` holds the growth in a step of the length ``tau``.
        """
        if self.most is None or not rates[GROWTH] > 0:
            return float("inf")
        return max(self.dt_min, tau * safety * self.most / rates[GROWTH])

    def refused(self, tau: float, rates: Mapping[str, float]) -> str:
        """Reason why a step is refused; empty for an accepted step.  The shortest step is always accepted."""
        if self.most is None or rates[GROWTH] <= self.most or tau <= self.dt_min:
            return ""
        return f"the damage grows by {rates[GROWTH]:.2g} at a point, more than {self.most:.2g}"

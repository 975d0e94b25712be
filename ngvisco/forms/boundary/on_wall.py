"""The common base of terms by which one wall acts on the body: the wall's place and the impulse's name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ngsolve import CoefficientFunction

from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Coupling, PointTerm

if TYPE_CHECKING:
    from ngvisco.forms.boundary.walls import Walls


class OnWall(PointTerm):
    """A term by which one wall acts on the body, in addition to its constraints."""

    couples: Coupling = "flow"
    acts_by: str = "stress"
    """Kind of the term's impulse, the first part of the impulse's name."""

    @property
    def impulse(self) -> str:
        """Name of the impulse, from the kind of action and the wall."""
        return f"{self.acts_by}_{self.name}"

    def __init__(self, walls: Walls, name: str) -> None:
        self.name = self.wall = name
        self.region = walls.region([name])
        self.indicator = facet_indicator(walls.mesh, [name])

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [] if self.acts_by == "nothing" else self.facets(u, w)


def along_and_across(
    factors: tuple[float, float], a: CoefficientFunction, n: CoefficientFunction
) -> CoefficientFunction:
    """The vector p (a . n) n + s a_t for the factors (p, s)."""
    p, s = factors
    return s * a + ((p - s) * (a * n)) * n

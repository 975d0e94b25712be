"""Two increments in a row: whether they lead through a jump of the elastic force, or to and fro across it.

Where v . n changes its sign on a facet the elastic force jumps across the width eta of the smoothed sign, and
no derivative on one side of the jump knows the force on the other.  Two increments of the same direction lead
through the jump: the second one may be many times as long, and be as good as any other, as it is the first of
the other side.  Two of opposite directions, the second one hardly shorter, have the solution between their
iterates: there the secant leads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


@dataclass(frozen=True)
class Successive:
    """The increment f at x, and ``before``, the one at x + ``before``, of which x has come."""

    x: np.ndarray
    f: np.ndarray
    before: np.ndarray
    squares: tuple[float, float]
    """Of the lengths of both, each block of unknowns in its own unit."""
    product: float

    @classmethod
    def of(cls, split: Split, x: np.ndarray, f: np.ndarray, before: np.ndarray) -> Successive:
        """Packed unknowns; collective over ranks."""
        exchange = split.residual.exchange
        scale = split.unknowns.scales(x, exchange)
        both = np.array([f, before]) / scale
        (of_f, product), (_, of_before) = (exchange.products(both, one) for one in both)
        return cls(x, f, before, (float(of_f), float(of_before)), float(product))

    @property
    def lead_on(self) -> bool:
        """Whether both have the same direction."""
        return self.product > 0

    @property
    def are_opposed(self) -> bool:
        """Whether the second one leads back."""
        return self.product < 0

    def secant(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the points between both iterates that where the increment, were it linear, is shortest; and it.

        Of opposed increments: beside the iterates' own there is a shorter one.
        """
        of_f, of_before = (square - self.product for square in self.squares)
        share = of_f / (of_f + of_before)  # of the iterate before, within (0, 1)
        return self.x + share * self.before, (1 - share) * self.f + share * self.before

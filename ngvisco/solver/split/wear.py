"""Counts the cost of an old tangent in directions of GMRES, and decides when a new tangent saves time.

An increment with an old tangent takes more directions than the first increment did. The tangent is renewed
when the sum of the further directions exceeds the cost of a renewal, so that a run spends at most twice the
least possible cost.  A limit for the directions of one increment would renew in vain if a new tangent needs
as many directions.

An old tangent also contracts less than a new one, so that the iteration takes more increments.  The number of
further increments can be estimated in advance: the tangent is renewed as soon as the further increments until
the end cost more than a renewal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

_FIRST, _BEYOND, _NEW = "directions_first", "directions_beyond", "contraction_new"
_RESIDUAL = 6
"""Cost of a residual in directions."""


class Wear:
    """Counts the directions of increments with one tangent; ``cost`` is the cost of a renewal in
    directions."""

    def __init__(self, cost: int) -> None:
        self.cost, self._first, self._beyond = cost, 0, 0
        self._new, self._present = 0.0, 0.0
        """Contractions by the last new tangent, right after it was formed, and by the present tangent; 0 if
        unknown."""

    def renew(self) -> None:
        """Begin to count for a new tangent."""
        self._first = self._beyond = 0
        self._present = 0.0

    def count(self, directions: int) -> None:
        """Count the directions of one increment."""
        self._first = self._first or directions
        self._beyond += max(directions - self._first, 0)

    def rate(self, contraction: float, is_new: bool) -> None:
        """Note the contraction by the tangent, 0 for a step's first increment. ``is_new`` tells whether the
        tangent was new when the preceding increment was made."""
        if is_new and contraction > 0:
            self._new = contraction
        self._present = contraction

    def is_dear(self, reduction: float) -> bool:
        """Whether a renewal saves more than its cost, in earlier increments or in later ones. The iteration
        ends when the increments are shorter than the present one by the factor ``reduction``."""
        return self._beyond + self._further(reduction) * (_RESIDUAL + self._first) > self.cost

    def _further(self, reduction: float) -> float:
        """Number of increments that the present tangent takes beyond those of a new one."""
        if not 0 < self._new < self._present < 1 < reduction:
            return 0.0
        by_new, by_present = (math.log(reduction) / -math.log(c) for c in (self._new, self._present))
        return by_present - by_new

    def state_dict(self) -> dict[str, float]:
        """The counts and the contraction by a new tangent, which a checkpoint stores."""
        return {_FIRST: float(self._first), _BEYOND: float(self._beyond), _NEW: self._new}

    def load_state_dict(self, numbers: Mapping[str, float]) -> None:
        """Restore the counts and the contraction; they are 0 if the checkpoint does not contain them."""
        self._first, self._beyond = (int(numbers.get(name, 0.0)) for name in (_FIRST, _BEYOND))
        self._new, self._present = float(numbers.get(_NEW, 0.0)), 0.0

"""Counts the directions of GMRES that an old tangent costs, and says when a new tangent saves time.

An increment with an old tangent takes more directions than the first increment did. The tangent is renewed
when the sum of the further directions exceeds the cost of a renewal, so that a run spends at most twice the
least possible cost.  A limit for the directions of one increment would renew in vain if a new tangent needs
as many directions.
"""

from __future__ import annotations

from collections.abc import Mapping

_FIRST, _BEYOND = "directions_first", "directions_beyond"


class Wear:
    """Counts the directions of increments with one tangent; ``cost`` is the cost of a renewal in
    directions."""

    def __init__(self, cost: int) -> None:
        self.cost, self._first, self._beyond = cost, 0, 0

    def renew(self) -> None:
        """Begin with a new tangent."""
        self._first = self._beyond = 0

    def count(self, directions: int) -> None:
        """Count the directions of one increment."""
        self._first = self._first or directions
        self._beyond += max(directions - self._first, 0)

    @property
    def is_dear(self) -> bool:
        """Whether an earlier renewal would have saved more than its cost."""
        return self._beyond > self.cost

    def state_dict(self) -> dict[str, float]:
        """The counts, which a checkpoint stores."""
        return {_FIRST: float(self._first), _BEYOND: float(self._beyond)}

    def load_state_dict(self, numbers: Mapping[str, float]) -> None:
        """Restore the counts; they begin anew if the checkpoint has none."""
        self._first, self._beyond = (int(numbers.get(name, 0.0)) for name in (_FIRST, _BEYOND))

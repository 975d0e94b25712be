"""Parameter studies: one case with some of its keys varied, each combination a run directory of its own."""

from ngvisco.sweep.study import Outcome, Study
from ngvisco.sweep.variations import SweepError, Variation

__all__ = ["Outcome", "Study", "SweepError", "Variation"]

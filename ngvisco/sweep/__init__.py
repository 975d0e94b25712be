"""Parameter studies: keys of one case are varied, and each combination has its own run directory."""

from ngvisco.sweep.study import Outcome, Study
from ngvisco.sweep.variations import SweepError, Variation

__all__ = ["Outcome", "Study", "SweepError", "Variation"]

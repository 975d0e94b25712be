"""Single precision of the flow's linear systems.

Single precision halves the memory traffic, and one instruction works on twice as many numbers.

Increments are computed to 3 per cent; the next residual contains the rest.  Residuals, like equations and
ledger, are in double precision.  Only operators on increments are in single precision.  Small differences of
the state, such as jumps, are evaluated in double precision and then rounded.
"""

import numpy as np

SINGLE = np.float32


def single(array: np.ndarray) -> np.ndarray:
    """A contiguous copy of an array in single precision."""
    return np.ascontiguousarray(array, dtype=SINGLE)

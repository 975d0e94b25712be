"""In what the flow's linear systems are kept: half the memory to go through, twice the numbers an operation.

An increment is solved for to 3 per cent, and what it leaves the next residual shows, which is in double
precision as all that the equations and the ledger are made of.  Only what acts on increments is single;
what is known of the state - jumps, which are small differences - is evaluated in double and rounded then.
"""

import numpy as np

SINGLE = np.float32


def single(array: np.ndarray) -> np.ndarray:
    """A contiguous copy of an array in single precision."""
    return np.ascontiguousarray(array, dtype=SINGLE)

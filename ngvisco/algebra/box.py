"""Minimisation of a convex quadratic function in a box by projected Newton steps."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ngvisco.errors import StepError

_MOST, _HALVINGS = 200, 40
_DECREASE = 1e-4
"""Least decrease of the function in a step, as a fraction of the decrease that the slope predicts
(Armijo)."""
_CONVERGED = 1e-13
"""Size of a Newton step, relative to the solution, below which the iteration ends."""


@dataclass(frozen=True)
class Minimum:
    """A minimum ``x`` and the function's slope at x, which is zero to rounding except where a bound is
    active."""

    x: np.ndarray
    slope: np.ndarray


def minimise_in_box(
    H: sp.csr_matrix, f: np.ndarray, drag: tuple[np.ndarray, np.ndarray], low: np.ndarray, high: np.ndarray
) -> Minimum:
    """Minimise x.Hx/2 + f.x + sum_i drag_i x_i^2/2 for low <= x <= high, where low <= 0 <= high.

    ``drag`` has two arrays, for x_i > 0 and for x_i < 0.  Each step is a Newton step in the unknowns without
    an active bound, clipped to the box and halved until the function decreases (Bertsekas, SIAM J. Control
    Optim. 20, 1982).  Raises StepError if the iteration fails, for instance because the function is not
    convex.  The iteration may also end at a saddle point.
    """
    rising, falling = drag
    x = np.zeros(len(f))

    def at(x: np.ndarray) -> tuple[float, np.ndarray]:
        weight = np.where(x < 0, falling, rising)
        of_H = H @ x
        return float(x @ (0.5 * of_H + f + 0.5 * weight * x)), of_H + f + weight * x

    value, slope = at(x)
    for _ in range(_MOST):
        free = np.flatnonzero(~((x <= low) & (slope >= 0)) & ~((x >= high) & (slope <= 0)))
        if not len(free):
            return Minimum(x, slope)
        falls = np.where(x == 0, slope > 0, x < 0)
        matrix = H[free][:, free] + sp.diags(np.where(falls, falling, rising)[free])
        step = np.zeros(len(x))
        try:
            step[free] = splu(matrix.tocsc()).solve(-slope[free])
        except RuntimeError as error:
            raise StepError(f"no minimum was found: {error}") from error
        length = 1.0
        for _ in range(_HALVINGS):
            trial = np.clip(x + length * step, low, high)
            next_value, next_slope = at(trial)
            promised = float(slope @ (trial - x))
            is_last = abs(trial - x).max() <= _CONVERGED * max(1.0, abs(x).max())
            if is_last or (promised <= 0 and next_value <= value + _DECREASE * promised):
                break
            length /= 2
        else:
            raise StepError("no minimum was found: the function is not convex")
        x, value, slope = trial, next_value, next_slope
        if is_last:
            return Minimum(x, slope)
    raise StepError(f"no minimum was found after {_MOST} steps")

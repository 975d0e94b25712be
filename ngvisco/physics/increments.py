"""Derivatives of analytic functions of arrays by complex increments."""

from collections.abc import Callable

import numpy as np

TINY = 1e-30
"""Length of a complex increment, relative to the direction."""


def slope_along(
    function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, direction: np.ndarray
) -> np.ndarray:
    """The derivative of an analytic function of arrays in a direction.

    It is the imaginary part of a tiny complex increment: no difference is taken, so that nothing cancels.
    """
    return np.ascontiguousarray(function(at + (TINY * 1j) * direction).imag) / TINY

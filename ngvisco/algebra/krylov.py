"""GMRES where one application of an approximate inverse is not enough."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

Map = Callable[[np.ndarray], np.ndarray]


def improved(
    apply: Map, approximate: Map, rows: np.ndarray, tolerance: float, most: int, enough: float = 0.0
) -> tuple[np.ndarray, int]:
    """x with apply(x) = rows up to ``tolerance``, from what an approximate inverse gives, and its iterations.

    Residuals are measured by what the approximate inverse makes of them, every column of the values, which
    may have other units, relative to the first one's.  Where that first one is good enough, there is no
    iteration.

    Parameters
    ----------
    apply, approximate : callable
        The matrix and an approximation of its inverse, linear maps of arrays (values, columns).
    rows : (values, columns) array
    tolerance : float
    most : int
        Iterations at most.
    enough : float
        What one application may leave without any.
    """
    start = approximate(rows).astype(float)  # squares of single precision's numbers may leave it
    scale = np.linalg.norm(start, axis=0)
    scale[scale == 0] = 1.0
    rest = approximate(rows - apply(start)).astype(float) / scale
    size = float(np.linalg.norm(rest))
    if not max(tolerance, enough) < size < np.inf:  # good enough, or nothing that is a number
        return start, 0
    shape, taken = start.shape, list[float]()

    def mapped(x: np.ndarray) -> np.ndarray:
        return (approximate(apply(scale * x.reshape(shape))) / scale).ravel()

    operator = LinearOperator((start.size, start.size), mapped, dtype=float)
    x, _ = gmres(
        operator,
        rest.ravel(),
        rtol=tolerance / size,
        restart=most,
        maxiter=1,
        callback=taken.append,
        callback_type="pr_norm",
    )
    return start + scale * x.reshape(shape), len(taken)

"""Preconditioned conjugate gradients with an inner product of the caller's, as one over ranks."""

from collections.abc import Callable

import numpy as np

Product = Callable[[np.ndarray, np.ndarray], float]


def conjugate_gradients(
    operator: Callable[[np.ndarray], np.ndarray],
    right: np.ndarray,
    inverse: Callable[[np.ndarray], np.ndarray],
    product: Product,
    reduction: float,
    iterations: int,
) -> np.ndarray:
    """x with |right - operator x| <= ``reduction`` |right|, or what ``iterations`` lead to.

    Parameters
    ----------
    operator, inverse : callable
        Symmetric and positive semidefinite for ``product``, the preconditioner near the operator's inverse.
    right : array, (n,)
        In the operator's range.
    product : callable
        The inner product of two vectors; SciPy's solvers have that of one process only.
    """
    x, r = np.zeros_like(right), right.copy()
    wanted = reduction**2 * product(right, right)
    z = inverse(r)
    p, rz = z.copy(), product(r, z)
    for _ in range(iterations):
        if product(r, r) <= wanted or rz == 0:
            break
        q = operator(p)
        length = rz / product(p, q)
        x += length * p
        r -= length * q
        z = inverse(r)
        last, rz = rz, product(r, z)
        p *= rz / last
        p += z
    return x

"""GMRES and preconditioned conjugate gradients with given inner products, for instance over ranks."""

import math
from collections.abc import Callable

import numpy as np

Operator = Callable[[np.ndarray], np.ndarray]
Products = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Inner products of n vectors, (n, unknowns), with one vector, as an array (n,)."""

_BREAKDOWN = 1e-14
"""A new direction is rounding if its orthogonal component, relative to its length, is not above this
bound."""

_ORTHOGONAL = 0.5
"""Gram-Schmidt is not repeated if a direction's orthogonal component, relative to its length, is above this
bound."""


def gmres(
    operator: Operator, right: np.ndarray, *, rtol: float, directions: int, products: Products = np.matmul
) -> tuple[np.ndarray, int]:
    """Solve |right - operator(x)| <= ``rtol`` |right| by GMRES.  Return x and the number of directions.

    At most ``directions`` directions are made, and x has the least residual in their span.  The classical
    Gram-Schmidt method makes each direction orthogonal to the earlier ones.  This step is repeated if the
    orthogonal component is small, so that a direction takes one or two reductions over ranks.  SciPy's GMRES
    cannot add up products over ranks.  The values of x are NaN if the right-hand side or a product is not
    finite.
    """
    size = float(np.sqrt(products(right[None], right)[0]))
    if size == 0:
        return np.zeros_like(right), 0
    if not np.isfinite(size):
        return np.full_like(right, np.nan), 0
    basis = np.empty((directions + 1, len(right)), right.dtype)
    basis[0] = right / size
    hessenberg, start = np.zeros((directions + 1, directions)), np.zeros(directions + 1)
    start[0] = size
    rotations, left = list[tuple[float, float]](), size
    for k in range(directions):
        new = basis[k + 1]
        new[:] = operator(basis[k])
        column, length = np.zeros(k + 1), 0.0
        for _ in range(2):
            *shares, square = products(basis[: k + 2], new)
            if not np.isfinite(square):
                return np.full_like(right, np.nan), k + 1
            length = length or float(np.sqrt(square))
            new -= np.asarray(shares, right.dtype) @ basis[: k + 1]
            column += shares
            orthogonal = float(np.sqrt(max(square - np.dot(shares, shares), 0.0)))
            if orthogonal > _ORTHOGONAL * np.sqrt(square):
                break
        hessenberg[: k + 1, k] = column
        hessenberg[k + 1, k] = orthogonal
        last = float(column[0])  # rotations of earlier columns act on the new column
        for (cosine, sine), value in zip(rotations, column[1:].tolist(), strict=True):
            last = cosine * value - sine * last
        turned = math.hypot(last, orthogonal)
        rotations.append((last / turned, orthogonal / turned) if turned else (0.0, 1.0))
        left *= rotations[-1][1]
        if left <= rtol * size or orthogonal <= _BREAKDOWN * length:
            break
        new /= orthogonal
    y = np.linalg.lstsq(hessenberg[: k + 2, : k + 1], start[: k + 2], rcond=None)[0]
    return y.astype(right.dtype) @ basis[: k + 1], k + 1


def conjugate_gradients(
    operator: Operator,
    right: np.ndarray,
    inverse: Operator,
    product: Callable[[np.ndarray, np.ndarray], float],
    reduction: float,
    iterations: int,
) -> np.ndarray:
    """Solve |right - operator x| <= ``reduction`` |right| with at most ``iterations`` iterations.

    ``operator`` and its approximate ``inverse`` are symmetric and positive semidefinite in the inner product
    ``product`` of two vectors; ``right``, (n,), is in the operator's range.
    """
    x, r = np.zeros_like(right), right.copy()
    target = reduction**2 * product(right, right)
    z = inverse(r)
    p, rz = z.copy(), product(r, z)
    for _ in range(iterations):
        if product(r, r) <= target or rz == 0:
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

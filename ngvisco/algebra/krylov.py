"""GMRES and preconditioned conjugate gradients with inner products of the caller's, as those over ranks."""

import math
from collections.abc import Callable

import numpy as np

Map = Callable[[np.ndarray], np.ndarray]
Products = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Inner products of vectors (n, unknowns) with one, (n,)."""

_BREAKDOWN = 1e-14
"""A new direction's share outside of the old ones, relative to its length, that is rounding."""

_ORTHOGONAL = 0.5
"""Such a share above which it is orthogonal enough."""


def gmres(
    operator: Map, right: np.ndarray, *, rtol: float, directions: int, products: Products = np.matmul
) -> tuple[np.ndarray, int]:
    """x with |right - operator(x)| <= ``rtol`` |right|, or the least in ``directions``, and how many it took.

    Directions are made orthogonal by the classical Gram-Schmidt method, again where that takes most of one:
    one or two reductions over ranks, however many there are (SciPy's has one process's products only).

    Parameters
    ----------
    operator : callable
        Linear, of vectors (unknowns,).
    right : array, (unknowns,)
        Where it or a product is not finite, x is NaN.
    products : callable
        Inner products, see ``Products``; collective over ranks.
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
            rest = float(np.sqrt(max(square - np.dot(shares, shares), 0.0)))
            if rest > _ORTHOGONAL * np.sqrt(square):
                break
        hessenberg[: k + 1, k] = column
        hessenberg[k + 1, k] = rest
        last = float(column[0])  # turned by the rotations that made the columns before triangular
        for (cosine, sine), value in zip(rotations, column[1:].tolist(), strict=True):
            last = cosine * value - sine * last
        turned = math.hypot(last, rest)
        rotations.append((last / turned, rest / turned) if turned else (0.0, 1.0))
        left *= rotations[-1][1]
        if left <= rtol * size or rest <= _BREAKDOWN * length:
            break
        new /= rest
    y = np.linalg.lstsq(hessenberg[: k + 2, : k + 1], start[: k + 2], rcond=None)[0]
    return y.astype(right.dtype) @ basis[: k + 1], k + 1


def conjugate_gradients(
    operator: Map,
    right: np.ndarray,
    inverse: Map,
    product: Callable[[np.ndarray, np.ndarray], float],
    reduction: float,
    iterations: int,
) -> np.ndarray:
    """x with |right - operator x| <= ``reduction`` |right|, or what ``iterations`` lead to.

    ``operator`` and ``inverse``, an approximation of its inverse, are symmetric and positive semidefinite for
    ``product``, the inner product of two vectors; ``right``, (n,), is in the operator's range.
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

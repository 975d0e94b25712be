"""Products, contractions and linear maps of tensors at many points, as plain arrays with the points last."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ngvisco.physics.recording import called

_PRODUCTS = {
    (0, 0): ("", "", ""),
    (0, 1): ("", "i", "i"),
    (0, 2): ("", "ij", "ij"),
    (1, 0): ("i", "", "i"),
    (2, 0): ("ij", "", "ij"),
    (1, 1): ("k", "k", ""),
    (2, 1): ("ik", "k", "i"),
    (2, 2): ("ik", "kj", "ij"),
}
"""Subscripts of the two factors and of their product, by the factors' ranks."""


def subscripts(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[str, str, str]:
    """The subscripts of two factors of the shapes ``a`` and ``b`` and of their product."""
    if (len(a), len(b)) not in _PRODUCTS or (a and b and a[-1] != b[0]):
        raise TypeError(f"shapes {a} and {b} have no product")
    return _PRODUCTS[len(a), len(b)]


def product(left: str, right: str, out: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The sum of a * b over the indices that ``out`` lacks, at every point."""
    if out in (left, right) and ("" in (left, right) or left == right):
        return a * b
    return np.einsum(f"{left}p,{right}p->{out}p", a, b)


def applied(matrix: np.ndarray, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The constant ``matrix`` times the vector of the entries of ``value`` (row by row), as a tensor of
    ``shape``."""
    return called(_applied, matrix, value, shape)


def _applied(matrix: np.ndarray, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    # matrices that embed or select have few nonzero entries; they are real even if values are complex
    entries = value.reshape(matrix.shape[1], -1)
    result = np.zeros((matrix.shape[0], entries.shape[1]), value.dtype)
    for i, j, factor in _entries(np.asarray(matrix, dtype=float).tobytes(), matrix.shape[1]):
        result[i] += entries[j] if factor == 1.0 else factor * entries[j]
    return result.reshape(*shape, -1)


@lru_cache(maxsize=256)
def _entries(numbers: bytes, width: int) -> list[tuple[int, int, float]]:
    """Row, column and value of each entry that is not zero in a matrix of ``width`` columns."""
    matrix = np.frombuffer(numbers).reshape(-1, width)
    return [(int(i), int(j), float(matrix[i, j])) for i, j in np.argwhere(matrix)]


def cross(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The symmetric bilinear map with cross(A, A) = 2 Cof A; cross(A, B) : C is symmetric in A, B, C."""
    return _minors(A, B) + _minors(B, A)


def _minors(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The tensor with the entries A_jJ B_kK - A_jK B_kJ at (i, I), for (i, j, k) and (I, J, K) cyclic."""
    first, second = (np.roll(np.arange(3), -1), np.roll(np.arange(3), -2))
    return A[first][:, first] * B[second][:, second] - A[first][:, second] * B[second][:, first]


def contracted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The sum of a * b over all axes but the last one."""
    axes = "ij"[: a.ndim - 1]
    return product(axes, axes, "", a, b)

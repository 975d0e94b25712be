"""The stress of a flow rule by what it and its rate make together: M with M + c rate(M) = Y, at many points.

It is unique for a monotone rate and c > 0, and no steeper in Y than one, whatever the rule (Yosida).
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ngvisco.physics.arrays import TINY

PointRate: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Components of Pi, (points, p), of those of M; analytic."""

_ITERATIONS, _HALVINGS = 50, 20
_LAST, _NEAR, _TURNED = 1e-8, 1e-12, 1e-10
"""Increment of |M| that is the last one, that of all components at which it is found, and what of Y may be
off the direction of a rule that is no multiple of M."""


def slope_of(rate: PointRate, M: np.ndarray) -> np.ndarray:
    """The rate's derivative by M, (points, p, p)."""
    units = 1j * TINY * np.eye(M.shape[1])
    return np.stack([rate(M + unit).imag for unit in units], axis=2) / TINY


def resolved(
    rate: PointRate, Y: np.ndarray, c: float, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """M with M + c rate(M) = Y, Pa, and rate(M), 1/s, (points, p), for c in Pa s.

    By Newton's method within a bracket along Y, from |M| = ``start``, (points,), or |Y|.  Where the
    rate is no multiple of its stress, Newton's method for all components goes on from there.
    """
    with np.errstate(all="ignore"):  # a rate that overflows is bisected
        return _resolved(rate, Y, c, start)


def _resolved(
    rate: PointRate, Y: np.ndarray, c: float, start: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    size = np.linalg.norm(Y, axis=1)
    along = Y / np.where(size > 0, size, 1.0)[:, None]
    low, high, s = np.zeros_like(size), np.full_like(size, np.inf), size if start is None else start
    moved, found = np.full_like(size, np.inf), np.zeros(len(size), dtype=bool)
    for _ in range(_ITERATIONS):
        value = (rate((s + 1j * TINY)[:, None] * along) * along).sum(axis=1)
        defect = s + c * value.real - size
        low, high = np.where(defect < 0, s, low), np.where(defect < 0, high, s)
        newton = s - defect / (1 + c * value.imag / TINY)
        length = abs(newton - s)
        # down an exponential Newton's method goes in steps of one length
        taken = (newton >= low) & (newton <= high) & (length <= 0.5 * moved)
        middle = np.where(high < np.inf, 0.5 * (low + high), 2 * s)  # above Y: a rate that gives energy
        s, moved = np.where(found, s, np.where(taken, newton, middle)), np.where(taken, length, np.inf)
        found |= taken & (length <= _LAST * size)
        if found.all():
            break
    M = s[:, None] * along
    Pi = rate(M)
    turned = Pi - (Pi * along).sum(axis=1)[:, None] * along
    if (c * np.linalg.norm(turned, axis=1) <= _TURNED * size).all():
        return M, Pi

    def defect_of(M: np.ndarray) -> np.ndarray:
        return M + c * rate(M) - Y

    def slope(M: np.ndarray) -> np.ndarray:
        return np.eye(M.shape[1]) + c * slope_of(rate, M)

    M = _newton(defect_of, slope, M)
    return M, rate(M)


def _newton(
    defect: Callable[[np.ndarray], np.ndarray], slope: Callable[[np.ndarray], np.ndarray], x: np.ndarray
) -> np.ndarray:
    """A zero of the defect from x, all points at once, each with a length of its own."""
    wrong = defect(x)
    for _ in range(_ITERATIONS):
        d = np.linalg.solve(slope(x), wrong[..., None])[..., 0]
        length = np.ones(len(x))
        for _ in range(_HALVINGS):
            new = x - length[:, None] * d
            left = defect(new)
            far = np.linalg.norm(left, axis=1) > (1 - 0.25 * length) * np.linalg.norm(wrong, axis=1)
            small = np.linalg.norm(d, axis=1) <= _NEAR * np.linalg.norm(x, axis=1)
            if not (far & ~small).any():
                break
            length = np.where(far & ~small, 0.5 * length, length)
        x, wrong = new, left
        if small.all():
            break
    return x

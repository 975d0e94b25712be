"""The resolvent of a flow rule: the stress M with M + c rate(M) = Y, at many points.

If the rate is monotone and c > 0, M is unique, and |dM| <= |dY| (Yosida).
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ngvisco.physics.arrays import TINY

PointRate: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Analytic function from components of M to components of Pi, both (points, p)."""

_ITERATIONS, _HALVINGS = 50, 20
_LAST, _NEAR, _TURNED = 1e-8, 1e-12, 1e-10
"""Three relative numbers: the increments of |M| and of all components below which Newton's method ends; and
the largest part of c rate(M) normal to Y, as a share of |Y|, with which a rate counts as a multiple of M."""


def slope_of(rate: PointRate, M: np.ndarray) -> np.ndarray:
    """The rate's derivative by M, (points, p, p)."""
    return np.stack([rate(M + unit).imag for unit in 1j * TINY * np.eye(M.shape[1])], axis=2) / TINY


@np.errstate(all="ignore")  # the bracket is halved where the rate overflows
def resolved(
    rate: PointRate, Y: np.ndarray, c: float, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """M with M + c rate(M) = Y, Pa, and rate(M), 1/s, (points, p), for c in Pa s.

    Newton's method within a bracket along Y starts from |M| = ``start``, (points,), or |Y|.  If the rate is
    not a multiple of its stress, the result is the start value of Newton's method for all components.
    """
    size = np.linalg.norm(Y, axis=1)
    along = Y / np.where(size > 0, size, 1.0)[:, None]
    low, high, s = np.zeros_like(size), np.full_like(size, np.inf), size if start is None else start
    moved, done = np.full_like(size, np.inf), np.zeros(len(size), dtype=bool)
    for _ in range(_ITERATIONS):
        value = (rate((s + 1j * TINY)[:, None] * along) * along).sum(axis=1)
        defect = s + c * value.real - size
        low, high = np.where(defect < 0, s, low), np.where(defect < 0, high, s)
        newton = s - defect / (1 + c * value.imag / TINY)
        length = abs(newton - s)
        # if all Newton steps have equal lengths, as for an exponential rate, the bracket is halved instead
        accepted = (newton >= low) & (newton <= high) & (length <= 0.5 * moved)
        # the bracket has no upper end if M : rate(M) is negative
        middle = np.where(high < np.inf, 0.5 * (low + high), 2 * s)
        s, moved = np.where(done, s, np.where(accepted, newton, middle)), np.where(accepted, length, np.inf)
        done |= accepted & (length <= _LAST * size)
        if done.all():
            break
    M = s[:, None] * along
    Pi = rate(M)
    turned = Pi - (Pi * along).sum(axis=1)[:, None] * along
    if (c * np.linalg.norm(turned, axis=1) <= _TURNED * size).all():
        return M, Pi
    M = _by_components(rate, Y, c, M)
    return M, rate(M)


def _by_components(rate: PointRate, Y: np.ndarray, c: float, M: np.ndarray) -> np.ndarray:
    """M by Newton's method for all components, at all points at once; each point has its own step length."""
    wrong = M + c * rate(M) - Y
    for _ in range(_ITERATIONS):
        slope = np.eye(M.shape[1]) + c * slope_of(rate, M)
        d = np.linalg.solve(slope, wrong[..., None])[..., 0]
        length = np.ones(len(M))
        for _ in range(_HALVINGS):
            new = M - length[:, None] * d
            left = new + c * rate(new) - Y
            far = np.linalg.norm(left, axis=1) > (1 - 0.25 * length) * np.linalg.norm(wrong, axis=1)
            small = np.linalg.norm(d, axis=1) <= _NEAR * np.linalg.norm(M, axis=1)
            if not (far & ~small).any():
                break
            length = np.where(far & ~small, 0.5 * length, length)
        M, wrong = new, left
        if small.all():
            break
    return M

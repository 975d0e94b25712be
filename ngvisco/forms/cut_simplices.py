"""Half-spaces that cut simplices: shares of volume, places of planes, values of functions at the places that
matter had before a step.

Let a linear function have the values v_i at the vertices of a simplex of dimension d. The function is > 0 in
the share s of the simplex:

    s = sum over the v_i > 0 of v_i^d / prod_{j != i} (v_i - v_j)

If a vertex is given twice, s is the share of the volume with the weight (d + 1) lambda of this vertex.  With
a linear weight w, such as r about an axis, the share of the volume is therefore sum_c w_c s_c / sum_c w_c;
here s_c is s with vertex c given twice.
"""

from __future__ import annotations

import numpy as np

from ngvisco.physics.bodies import NO_INTERFACE

_STEPS = 20
"""Number of steps of the regula falsi (Illinois) that determine the place of a plane to rounding."""
_APART = 1e-6
"""Spacing by which equal values at the vertices of a simplex are made different, relative to the range of the
values."""


def share_above(values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Share of simplices in which linear functions with ``values`` at the vertices, (..., vertices), are > 0.

    ``values`` have no unit.  ``weights`` are the vertex values of a linear weight of volumes; None stands for
    the weight 1.
    """
    if weights is not None:
        doubled = [
            share_above(np.concatenate([values, v], axis=-1)) for v in np.split(values, values.shape[-1], -1)
        ]
        return np.asarray((np.stack(doubled, axis=-1) * weights).sum(axis=-1) / weights.sum(axis=-1))
    count = values.shape[-1]
    values = np.sort(values, axis=-1)
    spread = _APART * np.maximum(np.ptp(values, axis=-1, keepdims=True), NO_INTERFACE)
    values = values + spread * np.arange(count)
    most = (values > 0).sum(axis=-1, keepdims=True) > count / 2
    values = np.where(most, -values, values)  # so that few summands are large, and they do not cancel
    differences = values[..., :, None] - values[..., None, :] + np.eye(count)
    part = (np.maximum(values, 0.0) ** (count - 1) / differences.prod(axis=-1)).sum(axis=-1)
    return np.where(most[..., 0], 1 - part, part)


def level(heights: np.ndarray, theta: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Levels that linear functions exceed in the share ``theta``, (cells,), of their cells.

    ``heights``, (cells, corners), are the functions' values; ``weights`` are those of ``share_above``.
    ``heights`` may also be (cells, pieces, corners) for functions that are linear in equal pieces of a cell.
    """
    if heights.ndim == 2:
        heights, weights = heights[:, None], None if weights is None else weights[:, None]
    low, high = heights.min(axis=(1, 2)), heights.max(axis=(1, 2))
    result = np.where(theta < 0.5, high, low)
    cut = np.minimum(theta, 1 - theta) > NO_INTERFACE
    heights, theta, low, high = heights[cut], theta[cut], low[cut], high[cut]
    weights = None if weights is None else weights[cut]
    sizes = np.ones(heights.shape[:2]) if weights is None else weights.mean(axis=2)
    sizes = sizes / sizes.sum(axis=1, keepdims=True)
    above, below, is_more = 1 - theta, -theta, theta > 1
    for _ in range(_STEPS):
        middle = low + above / (above - below) * (high - low)
        excess = (share_above(heights - middle[:, None, None], weights) * sizes).sum(axis=1) - theta
        was_more, is_more = is_more, excess > 0
        low, high = np.where(is_more, middle, low), np.where(is_more, high, middle)
        kept = np.where(is_more == was_more, 0.5, 1.0)  # else one end would stay where the share is curved
        above, below = np.where(is_more, excess, kept * above), np.where(is_more, kept * below, excess)
    result[cut] = middle
    return result


def before(values: np.ndarray, path: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Values of linear functions, (cells, corners), at the places from which the step has moved the matter to
    the corners.

    ``values`` are the values at corners, ``path`` is the velocity at corners times the step, (cells, corners,
    dim), and ``slopes`` are the slopes of the barycentric coordinates.  The error for a rigid rotation by the
    angle phi is of order phi^3.
    """
    turning = np.einsum("kcd,kce->kde", path, slopes)
    back = path - 0.5 * np.einsum("kde,kce->kcd", turning, path)  # the path is an arc
    return np.asarray(values - np.einsum("kcd,ked,ke->kc", back, slopes, values))

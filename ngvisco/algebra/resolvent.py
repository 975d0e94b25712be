"""Inverses (1 - N)^{-1} of cells' matrices N, by groups of components that act on each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ngvisco.algebra import precision

_NEGLECTED = 1e-4
"""Remainder at which the series of the resolvents is truncated."""


class Resolvent:
    """(1 - N)^{-1} for the coefficients of some cells, inverted by groups of components.

    A group has components of its own, and components that all groups share.  The shared components do not
    depend on any other components.  A group does not depend on another group's own components.
    """

    def __init__(self, groups: Sequence[np.ndarray], blocks: Sequence[np.ndarray]) -> None:
        """Each of ``groups`` has the indices of n components; each of ``blocks`` is (1 - N)^{-1}
        for one group, (cells, q n, q n)."""
        self.groups, self.blocks, self.cells = groups, blocks, len(blocks[0])

    def astype(self, kind: type | np.dtype) -> Resolvent:
        """The resolvent in another precision."""
        return Resolvent(self.groups, [block.astype(kind, copy=False) for block in self.blocks])

    def __call__(self, dz: np.ndarray) -> np.ndarray:
        """The resolvent times coefficients dz, both (cells, q, n)."""
        result = np.empty(dz.shape, np.result_type(dz, *self.blocks))
        for some, block in zip(self.groups, self.blocks, strict=True):
            of_group = np.empty((*dz.shape[:2], len(some)), result.dtype)
            for here, there in (runs := _runs(some)):
                of_group[..., there] = dz[..., here]
            of_group = np.matmul(block, of_group.reshape(*block.shape[:2], 1)).reshape(of_group.shape)
            for here, there in runs:
                result[..., here] = of_group[..., there]
        return result

    def after(self, rows: np.ndarray, out: np.ndarray) -> None:
        """Put rows (cells, q, rows, n) times the resolvent into ``out``, (cells, rows, q n)."""
        cells, q, count, n = rows.shape
        if len(self.blocks) == 1:
            np.matmul(rows.swapaxes(1, 2).reshape(out.shape), self.blocks[0], out=out)
            return
        result, taken = out.reshape(cells, count, q, n), np.zeros(n, dtype=bool)
        for some, block in zip(self.groups, self.blocks, strict=True):
            of_group = np.empty((cells, count, q, len(some)), rows.dtype)
            for here, there in (runs := _runs(some, taken)):
                # shared components belong to every group, and only the first group has their rows
                of_group[..., there] = 0.0 if taken[here.start] else rows[..., here].swapaxes(1, 2)
            product = np.matmul(of_group.reshape(cells, count, q * len(some)), block)
            product = product.reshape(of_group.shape)
            for here, there in runs:
                if taken[here.start]:
                    result[..., here] += product[..., there]
                else:
                    result[..., here] = product[..., there]
            taken[some] = True


def _runs(numbers: np.ndarray, taken: np.ndarray | None = None) -> list[tuple[slice, slice]]:
    """Divide ``numbers`` into runs of consecutive numbers; return each run's range of numbers and range of
    places.

    With the mask ``taken`` either all numbers of a run are taken, or none is.
    """
    breaks = np.diff(numbers) != 1
    if taken is not None:
        breaks |= np.diff(taken[numbers])
    ends = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(numbers)]
    return [(slice(int(numbers[i]), int(numbers[j - 1]) + 1), slice(i, j)) for i, j in pairwise(ends)]


def resolvents(matrices: np.ndarray) -> tuple[np.ndarray, int]:
    """(1 - N)^{-1} of stacked matrices N, and a number of terms, which is 0 for large N.

    For small N the series 1 + N + N^2 ... with this number of terms has a relative error below 1e-4.  The
    inverse is then computed as the product (1 + N)(1 + N^2)(1 + N^4) ..., which has the same bound of the
    error and takes a fifth of the time of factorisations.
    """

    def size(matrices: np.ndarray) -> float:
        return float(abs(matrices).sum(axis=2).max(initial=0.0))

    identity = np.eye(matrices.shape[1])
    if not (largest := size(matrices)) < 0.5:
        return np.linalg.inv(identity - matrices), 0
    power, exponent = precision.single(matrices), 1
    result = power + identity.astype(precision.SINGLE)
    while (largest := size(power)) ** 2 > _NEGLECTED:
        power, exponent = np.matmul(power, power), 2 * exponent
        result += np.matmul(result, power)
    return result, 1 + math.ceil(exponent * math.log(_NEGLECTED) / math.log(largest)) if largest > 0 else 1

"""phi'(z) of a material at many points as arrays, where its energy can be written with them.

NGSolve's symbolic derivative of an energy takes 3 microseconds a point (neo-Hookean, 3D), because it is a
tree of small tensor operations for each point.  Here every operation of ``Material.energy`` acts on all
points at once (``ngvisco.physics.arrays``).  An energy can be written with coefficient functions' operations
that have no counterpart there; it is then left to NGSolve.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.material import Material

CHUNK = 2048
"""Points at a time, so that what is made on the way stays in the processor's cache."""

Slope: TypeAlias = Callable[[np.ndarray], np.ndarray]


def array_slope(material: Material, dim: int) -> Slope | None:
    """phi'(z) for components z (n, points), by arrays; None where the energy does not allow for them."""
    states = material.states(dim)
    slices, spaces = states.slices, states.spaces

    def slope(z: np.ndarray) -> np.ndarray:
        result = np.empty_like(z)
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN outside the energy's domain
            for start in range(0, z.shape[1], CHUNK):
                _slope(z[:, start : start + CHUNK], result[:, start : start + CHUNK])
        return result

    def _slope(z: np.ndarray, result: np.ndarray) -> None:
        values = {}
        for name, where in slices.items():
            space = spaces[name]
            part = z[where.start] if space.is_scalar else (space.columns @ z[where]).reshape(3, 3, -1)
            values[name] = Array(part)
        energy = material.energy(values)
        for (name, where), g in zip(slices.items(), derivatives(energy, list(values.values())), strict=True):
            result[where] = g if spaces[name].is_scalar else spaces[name].columns.T @ g.reshape(9, -1)

    try:
        with np.errstate(all="ignore"):  # the point need not be in the energy's domain
            slope(np.ones((states.size, 1)))
    except Exception:  # whatever an energy raises at values that it does not know
        return None
    return slope

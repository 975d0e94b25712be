"""phi'(z) of a material at many points as arrays, where its energy can be written with them.

NGSolve's symbolic derivative of an energy takes 3 microseconds a point (neo-Hookean, 3D), because it is a
tree of small tensor operations for each point.  Here every operation of ``Material.energy`` acts on all
points at once (``ngvisco.physics.arrays``).  An energy can be written with coefficient functions' operations
that have no counterpart there; it is then left to NGSolve.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.increments import TINY
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import Respond, Response, respond

CHUNK = 2048
"""Points at a time, so that what is made on the way stays in the processor's cache."""

Slope: TypeAlias = Callable[[np.ndarray], np.ndarray]


def array_slope(material: Material, dim: int) -> Slope | None:
    """phi'(z) for components z (n, points), by arrays; None where the energy does not allow for them."""
    both = energy_and_slope(material, dim)
    return None if both is None else lambda z: both(z)[1]


def energy_and_slope(
    material: Material, dim: int
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]] | None:
    """phi(z), (points,), and phi'(z), both by arrays; None where the energy does not allow for them."""
    states = material.states(dim)
    slices, spaces = states.slices, states.spaces

    def both(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        energy, slope = np.empty(z.shape[1], z.dtype), np.empty_like(z)
        with np.errstate(all="ignore"):  # NaN outside the energy's domain
            for start in range(0, z.shape[1], CHUNK):
                some = slice(start, start + CHUNK)
                energy[some] = put(z[:, some], slope[:, some])
        return energy, slope

    def put(z: np.ndarray, result: np.ndarray) -> np.ndarray:
        values = {}
        for name, where in slices.items():
            space = spaces[name]
            part = z[where.start] if space.is_scalar else (space.columns @ z[where]).reshape(3, 3, -1)
            values[name] = Array(part)
        energy = material.energy(values)
        for (name, where), g in zip(slices.items(), derivatives(energy, list(values.values())), strict=True):
            result[where] = g if spaces[name].is_scalar else spaces[name].columns.T @ g.reshape(9, -1)
        return energy.value

    try:
        both(np.ones((states.size, 1)))  # which need not be in the energy's domain
    except Exception:  # whatever an energy raises at values that it does not know
        return None
    return both


def array_response(material: Material, dim: int) -> Respond:
    """The response by arrays, its Hessian by complex increments; by expressions where these do not agree."""
    own = material.response(dim)
    both = None if own is not None else energy_and_slope(material, dim)
    if both is None:
        return respond(material, dim)

    def response(states: np.ndarray) -> Response:
        energy, slope = both(np.ascontiguousarray(states.T))
        hessian = np.empty((len(states), states.shape[1], states.shape[1]))
        for m in range(states.shape[1]):
            along = states.T.astype(complex)
            along[m] += 1j * TINY
            hessian[:, :, m] = both(along)[1].imag.T / TINY
        return Response(energy, np.ascontiguousarray(slope.T), hessian)

    by_expression = respond(material, dim)
    states = 1.0 + 0.1 * np.random.default_rng(0).standard_normal((20, material.states(dim).size))
    one, other = response(states), by_expression(states)
    for name in ("energy", "slope", "hessian"):
        a, b = getattr(one, name), getattr(other, name)
        known = np.isfinite(b)
        if not np.allclose(a[known], b[known], rtol=1e-9, atol=1e-12 * abs(b[known]).max(initial=0.0)):
            return by_expression  # an energy that means something else with arrays
    return response

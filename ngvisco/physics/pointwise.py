"""Energies and their first two derivatives for many states at once, as arrays.

A state is the vector of all components of a material's variables (``StateSpace``).  A material
whose energy has no expression, such as a Yosida approximation, supplies a ``Respond`` in its place.

NGSolve's symbolic derivative of an energy takes 3 microseconds a point (neo-Hookean, 3D), because it is a
tree of small tensor operations for each point.  Where an energy can be written with arrays
(``ngvisco.physics.arrays``), every operation acts on all points at once.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from ngsolve import CF, ET, L2, VOL, GridFunction, IntegrationRule, VectorValued
from ngsolve.meshes import MakeStructured2DMesh

from ngvisco.physics.arrays import TINY, Array, Map, derivatives
from ngvisco.physics.material import Material
from ngvisco.physics.tensors import Tensor


@dataclass(frozen=True)
class Response:
    """An energy, (n,), Pa, at n states of N components, its slope, (n, N), and Hessian, (n, N, N)."""

    energy: np.ndarray
    slope: np.ndarray
    hessian: np.ndarray
    failure: str | None = None
    """Why some entries are NaN; None where all is well."""

    @property
    def finite(self) -> np.ndarray:
        """Where energy and derivatives are numbers, (n,) of bool."""
        matrices = np.isfinite(self.hessian).all(axis=(1, 2))
        return np.isfinite(self.energy) & np.isfinite(self.slope).all(axis=1) & matrices


Respond: TypeAlias = Callable[[np.ndarray], Response]
"""The response at states of shape (n, N)."""


def sampled_energies(material: Material, dim: int) -> str:
    """Energies at fixed states, Pa, as a text: the same for the same energy, with other libraries too."""
    rng = np.random.default_rng(2024)
    F = np.eye(3) + 0.25 * rng.uniform(-1, 1, (8, 3, 3))
    if dim == 2:
        F[:, 2, :2] = F[:, :2, 2] = 0.0
    return " ".join(f"{value:.8e}" for value in energies_at(material, states_of(material, F, dim), dim))


def energies_at(material: Material, states: np.ndarray, dim: int) -> np.ndarray:
    """Energies, Pa, at states, (n, N); NaN where there is none."""
    response, space = material.response(dim), material.states(dim)
    if response is not None:
        return response(states).energy
    return evaluated(lambda c: material.energy(space.tensors(lambda: c)), states)[:, 0]


def states_of(material: Material, F: np.ndarray, dim: int) -> np.ndarray:
    """Components of the states that belong to distortions F, (n, 3, 3): (n, N)."""

    def components(entries: Tensor) -> Tensor:
        tensor = entries.Reshape((3, 3))
        values = {v.name: v.from_distortion(tensor) for v in material.variables}
        return material.states(dim).components(values)

    return evaluated(components, F.reshape(-1, 9))


def rest_state(material: Material, dim: int) -> np.ndarray:
    """The state of F = I, (N,)."""
    return states_of(material, np.eye(3)[None], dim)[0]


def evaluated(function: Callable[[Tensor], Tensor], vectors: np.ndarray) -> np.ndarray:
    """Values of a function of vectors, (n, values), at n of them; NaN and inf where it has none."""
    count, size = vectors.shape
    mesh, points = squares(math.isqrt(max(count, 1) - 1) + 1)
    field = GridFunction(VectorValued(L2(mesh, order=0), size))
    field.vec.FV().NumPy().reshape(size, -1)[:, :count] = vectors.T
    with np.errstate(all="ignore"):
        return np.asarray(function(field)(points[:count])).reshape(count, -1)


def respond(material: Material, dim: int) -> Respond:
    """The material's own pointwise response, or that of its expression."""
    return material.response(dim) or ExpressionResponse(material, dim)


class ExpressionResponse:
    """The response of a material that has an expression, by NGSolve's symbolic derivatives."""

    def __init__(self, material: Material, dim: int) -> None:
        states = material.states(dim)
        self.size = states.size
        self.mesh, self.points = squares(64)
        self.state = GridFunction(VectorValued(L2(self.mesh, order=0), self.size))
        z = {name: value.MakeVariable() for name, value in states.tensors(lambda: self.state).items()}
        phi = material.energy(z)
        slopes = [phi.Diff(value) for value in z.values()]
        # of a tensor and a scalar the tensor's first: NGSolve 6.2.2608 gives d/dB of d/da tr(a B) wrongly
        hessians = [
            slope.Diff(value) if slope.dim > 1 or value.dim == 1 else other.Diff(scalar)
            for slope, scalar in zip(slopes, z.values(), strict=True)
            for other, value in zip(slopes, z.values(), strict=True)
        ]
        self.outputs = CF((phi, *slopes, *hessians)).Compile()
        self.blocks = [(states.spaces[name].columns, where) for name, where in states.slices.items()]
        """For every variable its basis, (entries, components), and where its components stand."""

    def __call__(self, states: np.ndarray) -> Response:
        n, size = len(states), self.size
        result = Response(np.empty(n), np.empty((n, size)), np.empty((n, size, size)))
        for start in range(0, n, len(self.points)):
            self._put(result, states, slice(start, min(start + len(self.points), n)))
        return result

    def _put(self, result: Response, states: np.ndarray, some: slice) -> None:
        count = some.stop - some.start
        self.state.vec.FV().NumPy().reshape(self.size, -1)[:, :count] = states[some].T
        values = np.asarray(self.outputs(self.points[:count])).reshape(count, -1)
        result.energy[some] = values[:, 0]
        start = 1
        with np.errstate(all="ignore"):  # outside the energy's domain there are NaN and inf
            for B, where in self.blocks:
                result.slope[some, where] = values[:, start : start + len(B)] @ B
                start += len(B)
            for B, where in self.blocks:
                for C, other in self.blocks:
                    stop = start + len(B) * len(C)
                    block = values[:, start:stop].reshape(count, len(B), len(C))
                    result.hessian[some, where, other] = B.T @ block @ C
                    start = stop


@cache
def squares(cells: int) -> tuple[Any, Any]:
    """A mesh of ``cells`` x ``cells`` squares, to hold states as cellwise constants, and its midpoints."""
    mesh = MakeStructured2DMesh(quads=True, nx=cells, ny=cells)
    return mesh, mesh.MapToAllElements({ET.QUAD: IntegrationRule([(0.5, 0.5)], [1.0])}, VOL)


CHUNK = 2048
"""Points at a time, so that what is made on the way stays in the processor's cache."""

Both: TypeAlias = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def array_slope(material: Material, dim: int) -> Callable[[np.ndarray], np.ndarray] | None:
    """phi'(z) for components z (n, points), by arrays; None where the energy does not allow for them."""
    both = energy_and_slope(material, dim)
    return None if both is None else lambda z: where_energy_is(*both(z))


def where_energy_is(energy: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The slope, (n, points), changed to NaN where the energy, (points,), is no number.

    A logarithm's derivative goes on beyond its pole: an iterate that has passed one is told by this.
    """
    slope[:, ~np.isfinite(energy)] = np.nan
    return slope


def energy_and_slope(material: Material, dim: int) -> Both | None:
    """phi(z), (points,), and phi'(z), both by arrays; None where the energy does not allow for them."""
    states = material.states(dim)
    parts = [(name, where, states.spaces[name]) for name, where in states.slices.items()]

    def both(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        energy, slope = np.empty(z.shape[1], z.dtype), np.empty_like(z)
        with np.errstate(all="ignore"):  # NaN outside the energy's domain
            for start in range(0, z.shape[1], CHUNK):
                some = slice(start, start + CHUNK)
                energy[some] = put(z[:, some], slope[:, some])
        return energy, slope

    def put(z: np.ndarray, result: np.ndarray) -> np.ndarray:
        values = {}
        for name, where, space in parts:
            part = z[where.start] if space.is_scalar else (space.columns @ z[where]).reshape(3, 3, -1)
            values[name] = Array(part)
        energy = material.energy(values)
        slopes = derivatives(energy, list(values.values()))
        for (_, where, space), g in zip(parts, slopes, strict=True):
            result[where] = g if space.is_scalar else space.columns.T @ g.reshape(9, -1)
        return energy.value

    try:
        both(np.ones((states.size, 1)))  # which need not be in the energy's domain
    except Exception:  # whatever an energy raises at values that it does not know
        return None
    return both


def is_affine(slope: Map, rest: np.ndarray) -> bool:
    """Whether phi'(z), by arrays, is affine in z, by its values at some states about ``rest``, (N,)."""
    rng = np.random.default_rng(0)
    base, step = (0.1 * rng.uniform(-1, 1, (len(rest), 8)) for _ in range(2))
    base += rest[:, None]
    with np.errstate(all="ignore"):  # states outside of the energy's domain
        middle, ends = slope(base), slope(base + step) + slope(base - step)
        return bool(abs(ends - 2 * middle).max() <= 1e-12 * abs(ends).max())


def array_response(material: Material, dim: int, linear: Iterable[str] = ()) -> Respond:
    """The response by arrays, its Hessian by complex increments; by expressions where these do not agree.

    Of variables that the energy is ``linear`` in together, at fixed others, no increments are needed.
    """
    own = material.response(dim)
    both = None if own is not None else energy_and_slope(material, dim)
    if both is None:
        return respond(material, dim)
    curved = np.ones(material.states(dim).size, dtype=bool)
    for name in linear:
        curved[material.states(dim).slices[name]] = False

    def response(states: np.ndarray) -> Response:
        energy, slope = both(np.ascontiguousarray(states.T))
        hessian = np.zeros((len(states), states.shape[1], states.shape[1]))
        for m in np.flatnonzero(curved):
            along = states.T.astype(complex)
            along[m] += 1j * TINY
            hessian[:, m] = hessian[:, :, m] = both(along)[1].imag.T / TINY
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

"""Energies and their first two derivatives for many states at once, as arrays.

A state is the vector of all components of a material's variables (``StateSpace``).  A material whose energy
has no expression, such as a Yosida approximation, supplies a ``Respond`` instead.

NGSolve's symbolic derivative of an energy takes 3 microseconds a point (neo-Hookean, 3D), because it is a
tree of small tensor operations for each point.  Where an energy can be written with arrays
(``ngvisco.physics.arrays``), every operation acts on all points at once.
"""

import math
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
from ngsolve import CF, ET, L2, VOL, CoefficientFunction, GridFunction, IntegrationRule, VectorValued
from ngsolve.meshes import MakeStructured2DMesh

from ngvisco.errors import ParameterError
from ngvisco.physics.arrays import TINY, Array, derivatives
from ngvisco.physics.material import Material, conjugates_along
from ngvisco.physics.response import Respond, Response
from ngvisco.physics.tensors import Tensor, constant

Both: TypeAlias = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Function of components, (N, points): the energies, (points,), and their slopes, (N, points)."""

_DIFFERENCE = 1e-4
"""Largest accepted relative difference between a Hessian and central differences of the slope."""


def sampled_energies(material: Material, dim: int) -> str:
    """Energies at fixed states, Pa, as a text that does not depend on the versions of libraries."""
    F = np.eye(3) + 0.25 * np.random.default_rng(2024).uniform(-1, 1, (8, 3, 3))
    if dim == 2:
        F[:, 2, :2] = F[:, :2, 2] = 0.0
    return " ".join(f"{value:.8e}" for value in energies_at(material, states_of(material, F, dim), dim))


def energies_at(material: Material, states: np.ndarray, dim: int) -> np.ndarray:
    """Energies, Pa, at states, (n, N); NaN outside of the energy's domain."""
    response, space = material.response(dim), material.states(dim)
    if response is not None:
        return response(states).energy
    return evaluated(lambda c: material.energy(space.tensors(lambda: c)), states)[:, 0]


def states_of(material: Material, F: np.ndarray, dim: int) -> np.ndarray:
    """Components, (n, N), of the states of the distortions F, (n, 3, 3)."""

    def components(entries: Tensor) -> Tensor:
        values = {v.name: v.from_distortion(entries.Reshape((3, 3))) for v in material.variables}
        return material.states(dim).components(values)

    return evaluated(components, F.reshape(-1, 9))


def rest_state(material: Material, dim: int) -> np.ndarray:
    """The state of F = I, (N,)."""
    return states_of(material, np.eye(3)[None], dim)[0]


def evaluated(function: Callable[[Tensor], Tensor], vectors: np.ndarray) -> np.ndarray:
    """Values, (n, values), of a function at n vectors; NaN or inf outside of its domain."""
    count, size = vectors.shape
    mesh, points = squares(math.isqrt(max(count, 1) - 1) + 1)
    field = GridFunction(VectorValued(L2(mesh, order=0), size))
    field.vec.FV().NumPy().reshape(size, -1)[:, :count] = vectors.T
    with np.errstate(all="ignore"):
        return np.asarray(function(field)(points[:count])).reshape(count, -1)


def respond(material: Material, dim: int) -> Respond:
    """The response of a material: its own if it has one, else by arrays or by its energy's expression.

    Arrays are used if they reproduce the expression's energy and slope. Complex increments of the slope then
    give the Hessian.  Raises ParameterError if arrays cannot evaluate the energy, and if then NGSolve's
    second derivative of it is wrong.
    """
    if (response := material.response(dim)) is not None:
        return response
    by_expression, both = ExpressionResponse(material, dim), energy_and_slope(material, dim)
    if both is None or not by_expression.agrees(both):
        by_expression.check()
        return by_expression
    return ArrayResponse(material, dim, both)


def curved_components(material: Material, dim: int) -> np.ndarray:
    """Numbers of a state's components in which the energy is not jointly linear (``Material.linear``)."""
    states = material.states(dim)
    curved = np.ones(states.size, dtype=bool)
    for name in material.linear:
        curved[states.slices[name]] = False
    return np.flatnonzero(curved)


class ArrayResponse:
    """The response of an energy by arrays, with the Hessian by complex increments of the slope."""

    def __init__(self, material: Material, dim: int, both: Both) -> None:
        self.both, self.curved = both, curved_components(material, dim)
        part, slices = material.curved_part, material.states(dim).slices
        places = sorted(part.states(dim).slices.items(), key=lambda entry: entry[1].start)
        self.read = np.concatenate([np.r_[slices[name]] for name, _ in places])
        """Numbers of the components of the variables of ``Material.curved_part``."""
        of_part = both if part is material else energy_and_slope(part, dim)
        assert of_part is not None  # arrays evaluate the whole energy
        self._of_part = of_part

    def slope(self, z: np.ndarray) -> np.ndarray:
        """phi'(z), both (N, points), real or complex."""
        return where_energy_is(*self.both(z))

    def slope_of_part(self, z: np.ndarray) -> np.ndarray:
        """The slope of ``Material.curved_part`` by its components (the numbers ``read``), at their values z,
        both (read, points), real or complex."""
        return where_energy_is(*self._of_part(z))

    def __call__(self, states: np.ndarray) -> Response:
        energy, slope = self.both(np.ascontiguousarray(states.T))
        (count, size), curved, read = states.shape, self.curved, self.read
        hessian = np.zeros((count, size, size))
        units = 1j * TINY * np.eye(size)[read[:, None], curved, None]
        at_once = max(1, CHUNK // max(1, len(curved)))
        for start in range(0, count if len(curved) else 0, at_once):
            some = slice(start, start + at_once)
            along = states.T[read, None, some] + units
            columns = self._of_part(along.reshape(len(read), -1))[1].imag.reshape(along.shape).T / TINY
            for m, column in zip(curved, columns.swapaxes(0, 1), strict=True):
                hessian[some, m, read] = hessian[some, read, m] = column
        # the derivative of a logarithm is finite beyond its pole; NaN marks a state without energy
        hessian[~np.isfinite(energy)] = np.nan
        return Response(energy, np.ascontiguousarray(slope.T), hessian)


class ExpressionResponse:
    """The response of a material that has an expression, by NGSolve's symbolic derivatives."""

    def __init__(self, material: Material, dim: int) -> None:
        self.material, self.dim, states = material, dim, material.states(dim)
        self.size = states.size
        self.mesh, self.points = squares(64)
        self.state = GridFunction(VectorValued(L2(self.mesh, order=0), self.size))
        self._z = {name: value.MakeVariable() for name, value in states.tensors(lambda: self.state).items()}
        self._phi = material.energy(self._z)
        slopes = states.components({name: self._phi.Diff(value) for name, value in self._z.items()})
        self._first = CF((self._phi, slopes))

    @cached_property
    def _first_compiled(self) -> CoefficientFunction:
        """The energy and its slope."""
        return self._first.Compile()

    @cached_property
    def _all(self) -> CoefficientFunction:
        """The energy, its slope and the columns of its Hessian."""
        states, columns = self.material.states(self.dim), []
        for name, space in states.spaces.items():
            for column in space.columns.T:
                unit = CF(1.0) if space.is_scalar else constant(column.reshape(3, 3))
                columns.append(states.components(conjugates_along(self._phi, self._z, {name: unit})))
        return CF((self._first, *columns)).Compile()

    def __call__(self, states: np.ndarray) -> Response:
        n, size = states.shape
        values = self._values(self._all, states, 1 + size + size**2)
        energy, slope, hessian = np.split(values, [1, 1 + size], axis=1)
        return Response(energy[:, 0], slope, hessian.reshape(n, size, size))

    def slope(self, z: np.ndarray) -> np.ndarray:
        """phi'(z) for real ``z``; z and phi'(z) are (N, points)."""
        values = self._values(self._first_compiled, z.T, 1 + self.size).T
        return where_energy_is(values[0], values[1:])

    def _values(self, function: CoefficientFunction, states: np.ndarray, width: int) -> np.ndarray:
        """Values, (n, width), of a function of the state; NaN or inf outside of the energy's domain."""
        result = np.empty((len(states), width))
        for start in range(0, len(states), len(self.points)):
            some = states[start : start + len(self.points)]
            self.state.vec.FV().NumPy().reshape(self.size, -1)[:, : len(some)] = some.T
            values = np.asarray(function(self.points[: len(some)]))
            result[start : start + len(some)] = values.reshape(len(some), width)
        return result

    def _sampled(self) -> np.ndarray:
        """Random states near rest, and near the vector of ones."""
        away = 0.1 * np.random.default_rng(0).standard_normal((20, self.size))
        return np.concatenate([1.0 + away, rest_state(self.material, self.dim) + away])

    def agrees(self, both: Both) -> bool:
        """Whether arrays reproduce the expression's energy and slope, at states where these are finite."""
        states = self._sampled()
        expected = self._values(self._first, states, 1 + self.size)
        energy, slope = both(np.ascontiguousarray(states.T))
        actual, is_finite = np.column_stack([energy, slope.T]), np.isfinite(expected)
        for part in (slice(0, 1), slice(1, None)):
            a, b = actual[:, part][is_finite[:, part]], expected[:, part][is_finite[:, part]]
            if not np.allclose(a, b, rtol=1e-9, atol=1e-12 * abs(b).max(initial=0.0)):
                return False
        return True

    def check(self) -> None:
        """Raise ParameterError if the Hessian differs from central differences of the slope."""
        states, step = self._sampled(), 1e-5
        along = np.random.default_rng(1).standard_normal(states.shape)
        ahead, behind = (self._values(self._first, states + s * step * along, 1 + self.size) for s in (1, -1))
        expected = (ahead - behind)[:, 1:] / (2 * step)
        change = np.einsum("nij,nj->ni", self(states).hessian, along)
        is_finite = np.isfinite(expected).all(axis=1)
        if not is_finite.any():
            return
        size = abs(expected[is_finite]).max(axis=1)
        off = abs(change - expected)[is_finite].max(axis=1)
        if not (off <= _DIFFERENCE * size + 1e-9 * size.max()).all():
            field = self.material.energy_parameter
            raise ParameterError(
                f"{type(self.material).__name__}.{field}",
                getattr(self.material, field),
                "an energy written with the functions of ngvisco.physics.tensors, or one whose second "
                f"derivative NGSolve computes; the relative error of the second derivative is "
                f"{off.max() / size.max():.2g}",
            )


@cache
def squares(cells: int) -> tuple[Any, Any]:
    """A mesh of ``cells`` x ``cells`` squares, and the midpoints of its cells. Cellwise constants on the mesh
    hold states."""
    mesh = MakeStructured2DMesh(quads=True, nx=cells, ny=cells)
    return mesh, mesh.MapToAllElements({ET.QUAD: IntegrationRule([(0.5, 0.5)], [1.0])}, VOL)


CHUNK = 2048
"""Number of points that are evaluated together, so that intermediate arrays stay in the processor's cache."""


def where_energy_is(energy: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The slope, (n, points), set to NaN where the energy, (points,), is not finite.

    The derivative of a logarithm is finite beyond its pole. NaN marks an iterate that has passed the pole.
    """
    return np.where(np.isfinite(energy), slope, np.nan)


def energy_and_slope(material: Material, dim: int) -> Both | None:
    """phi(z), (points,), and phi'(z), both by arrays; None if arrays cannot evaluate the energy."""
    states = material.states(dim)
    spaces = states.spaces
    places = dict(sorted(states.slices.items(), key=lambda entry: entry[1].start))

    def both(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not z.shape[1]:  # a rank may have no cells
            return np.empty(0, z.dtype), np.empty_like(z)
        with np.errstate(all="ignore"):  # NaN outside the energy's domain
            chunks = [of_chunk(z[:, start : start + CHUNK]) for start in range(0, z.shape[1], CHUNK)]
        if len(chunks) == 1:
            return chunks[0]
        energies, slopes = zip(*chunks, strict=True)
        return np.concatenate(energies), np.concatenate(slopes, axis=1)

    def of_chunk(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = {n: Array(z[where.start if spaces[n].is_scalar else where]) for n, where in places.items()}
        energy = material.energy({name: spaces[name].tensor(part) for name, part in parts.items()})
        count, slopes = z.shape[1], derivatives(energy, list(parts.values()))
        by_rows = [np.broadcast_to(slope, (*slope.shape[:-1], count)).reshape(-1, count) for slope in slopes]
        return np.copy(np.broadcast_to(energy.value, (count,))), np.concatenate(by_rows)

    try:
        both(np.ones((states.size, 1)))  # the state may be outside of the energy's domain
    except Exception:  # an energy may raise any error for arrays
        return None
    return both


def slope_at(response: Respond, z: np.ndarray) -> np.ndarray:
    """phi'(z), both (N, points); the Hessian is computed only if the response needs it."""
    if isinstance(response, (ArrayResponse, ExpressionResponse)):
        return response.slope(z)
    return np.ascontiguousarray(response(z.T).slope.T)


def is_affine(response: Respond, rest: np.ndarray) -> bool:
    """Whether phi'(z) is affine in z, from its values near ``rest``, (N,)."""
    rng = np.random.default_rng(0)
    base, step = (0.1 * rng.uniform(-1, 1, (len(rest), 8)) for _ in range(2))
    base += rest[:, None]
    states = np.hstack([base, base + step, base - step])
    with np.errstate(all="ignore"):  # states outside of the energy's domain
        middle, ahead, behind = np.split(slope_at(response, states), 3, axis=1)
        ends = ahead + behind
        return bool(abs(ends - 2 * middle).max() <= 1e-12 * abs(ends).max())

"""Fields as arrays at points, computed at first access, and imaginary increments of fields.

If a value has an infinitesimal imaginary increment, the imaginary part of any result computed from it is the
derivative of the result along the increment.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError
from ngvisco.forms.context import StepLayout
from ngvisco.forms.fields import Fields
from ngvisco.physics.arrays import TINY, Array

TOGETHER = 8192
"""Number of points in one chunk, counted for each direction. The values of a chunk stay in the processor's
cache."""
CELLS, FACETS = "in cells", "on facets"
"""Names of the places of points, for messages."""


class NotAtPointsError(NgviscoError, LookupError):
    """A term asks for a value that does not exist at the points of a rule."""


class Lazy(dict[str, Any]):
    """A dictionary whose values are computed at first access, for the given names only."""

    def __init__(self, make: Callable[[str], Any], names: Iterable[str], place: str, kind: str = "") -> None:
        super().__init__()
        self._make, self._names, self._missing = make, frozenset(names), f"there is no {kind}{{}} {place}"

    def __missing__(self, name: str) -> Any:
        if name not in self._names:
            raise NotAtPointsError(self._missing.format(name))
        self[name] = self._make(name)
        return self[name]


def lazy_fields(
    kind: type[Fields],
    layout: StepLayout,
    values: tuple[Callable[[str], Any], Iterable[str]],
    gradients: tuple[Callable[[str], Any], Iterable[str]],
    place: str,
    context: Any,
) -> Fields:
    """Unknowns or tests whose values and gradients are computed at first access.

    ``values`` and ``gradients`` are pairs: a function of a name, and the names that are allowed.  ``place``
    says in error messages where the points lie."""
    parts, slopes = Lazy(*values, place), Lazy(*gradients, place, "gradient of ")
    return kind(layout, parts, context, slopes.__getitem__)


def with_values(u: Fields, **given: np.ndarray) -> Fields:
    """Fields in which some unknowns, or ``grad_v``, have the values in ``given``."""
    parts = {name: Array(values, None) for name, values in given.items()}
    result = Fields(u.layout, ChainMap(parts, u.parts), u.context, u.gradient)  # type: ignore[arg-type]
    if "grad_v" in parts:
        result.__dict__["grad_v"] = parts["grad_v"]
    return result


def moved(u: Fields, d: Fields, names: Iterable[str], values: bool = True) -> Fields:
    """``u`` with the imaginary increment ``d`` in the values and gradients of the unknowns ``names``.

    Without ``values`` only the gradients are incremented.
    """
    names = frozenset(names)

    def by(value: Array, change: Array) -> Array:
        return Array(value.value + (TINY * 1j) * change.value, None)

    def part(name: str) -> Any:
        return by(u.parts[name], d.parts[name]) if values and name in names else u.parts[name]

    def gradient(name: str) -> Any:
        return by(u.gradient(name), d.gradient(name)) if name in names else u.gradient(name)

    result = Fields(u.layout, Lazy(part, u.layout.names, CELLS), u.context, gradient)
    if "jump" in u.__dict__:
        result.__dict__["jump"] = u.__dict__["jump"]
    return result


def incremented(u: Fields, **along: np.ndarray) -> Iterator[tuple[int, Fields]]:
    """Divide directions into groups; for each group yield its size, and ``u`` with imaginary increments.

    ``along`` has directions by the name of the unknown, or of ``grad_v``, (k, ..., points or 1).  The points
    are repeated for each direction, one direction after the other, because an operation on more points takes
    hardly longer.
    """
    values = {name: (u.grad_v if name == "grad_v" else u.parts[name]).value for name in along}
    first = next(iter(along))
    size = max(1, TOGETHER // max(values[first].shape[-1], 1))
    for start in range(0, len(along[first]), size):
        changed = {name: repeated_along(values[name], d[start : start + size]) for name, d in along.items()}
        count = min(size, len(along[first]) - start)
        yield count, with_values(u if count == 1 else repeated(u, count), **changed)


def repeated_along(value: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``value`` (..., points) with an imaginary increment along each of k ``directions``, (..., k points)."""
    moved = value[..., None, :] + (TINY * 1j) * np.moveaxis(directions, 0, -2)
    return moved.reshape(*value.shape[:-1], moved.shape[-2] * moved.shape[-1])


def derivative_of(values: np.ndarray, directions: int) -> np.ndarray:
    """Derivatives, (..., directions, points), of values computed from ``incremented`` fields."""
    return values.imag.reshape(*values.shape[:-1], directions, -1) / TINY


def repeated(u: Fields, times: int) -> Fields:
    """``u`` and the data of its step, with all points repeated ``times`` times."""

    def over(value: Array) -> Array:
        return value if value.value.shape[-1] == 1 else Array(np.tile(value.value, times), None)

    context: Any = _Repeated(u.context, times, over)
    parts = Lazy(lambda name: over(u.parts[name]), u.layout.names, CELLS)
    return Fields(u.layout, parts, context, lambda name: over(u.gradient(name)))


class _Repeated:
    """A context of cells with all points repeated ``times`` times."""

    def __init__(self, context: Any, times: int, over: Callable[[Array], Array]) -> None:
        self._context, self._times, self._over = context, times, over

    def __getattr__(self, name: str) -> Any:
        value, over = getattr(self._context, name), self._over
        if name == "old":
            value = repeated(value, self._times)
        elif name in ("average", "given"):
            return lambda function: over(value(function))
        elif isinstance(value, Array):
            value = over(value)
        setattr(self, name, value)
        return value

"""Fields at points by arrays: values that are made when they are asked for, and increments of them.

An imaginary increment of a value gives the derivative along it, by the imaginary part of what is computed.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError
from ngvisco.forms.fields import Fields
from ngvisco.forms.spaces import Layout
from ngvisco.physics.arrays import TINY, Array

TOGETHER = 8192
"""Points of all directions that are taken together, so that their values stay in the processor's cache."""
CELLS, FACETS = "in cells", "on facets"
"""Places of values, for messages."""


class NotAtPointsError(NgviscoError, LookupError):
    """A term asks for something that there is not at the points of a rule."""


class Lazy(dict[str, Any]):
    """Values of some names that are made when they are asked for."""

    def __init__(self, make: Callable[[str], Any], names: Iterable[str], place: str) -> None:
        super().__init__()
        self._make, self._names, self._place = make, frozenset(names), place

    def __missing__(self, name: str) -> Any:
        if name not in self._names:
            raise NotAtPointsError(f"there is no {name} {self._place}")
        self[name] = self._make(name)
        return self[name]


def lazy_fields(
    kind: type[Fields],
    layout: Layout,
    values: tuple[Callable[[str], Any], Iterable[str]],
    gradients: tuple[Callable[[str], Any], Iterable[str]],
    place: str,
    context: Any,
) -> Fields:
    """Unknowns or tests by what makes values, or gradients, of a name, and of which names it does."""
    parts, slopes = Lazy(*values, place), Lazy(*gradients, f"{place}, as a gradient")
    return kind(layout, parts, context, slopes.__getitem__)


def with_values(u: Fields, **given: np.ndarray) -> Fields:
    """Fields with other values of some unknowns, or of ``grad_v``."""
    parts = {name: Array(values, None) for name, values in given.items()}
    other = Fields(u.layout, ChainMap(parts, u.parts), u.context, u.gradient)  # type: ignore[arg-type]
    if "grad_v" in parts:
        other.__dict__["grad_v"] = parts["grad_v"]
    return other


def moved(u: Fields, d: Fields, names: Iterable[str], values: bool = True) -> Fields:
    """``u`` with an imaginary increment ``d`` of the unknowns ``names``: of their values and gradients.

    Without ``values`` of their gradients alone.  ``parts`` of the result has what was asked for.
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
    """``u`` with imaginary increments in directions, some at a time, which are counted.

    Each direction has the points for itself, all of the next one following: an operation on few points
    takes no longer on many.

    Parameters
    ----------
    along
        Directions (k, ..., points or 1), of unknowns by name or of ``grad_v``.
    """
    first = next(iter(along))
    points = getattr(u, first).value.shape[-1]
    size = max(1, TOGETHER // max(points, 1))
    for start in range(0, len(along[first]), size):
        changed = {}
        for name, directions in along.items():
            value, some = getattr(u, name).value, directions[start : start + size]
            each = value[..., None, :] + (TINY * 1j) * np.moveaxis(some, 0, -2)
            changed[name] = each.reshape(*value.shape[:-1], -1)
        yield len(some), with_values(u if len(some) == 1 else _repeated(u, len(some)), **changed)


def derivative_of(values: np.ndarray, directions: int) -> np.ndarray:
    """(..., directions, points) of what came of ``incremented`` fields."""
    return values.imag.reshape(*values.shape[:-1], directions, -1) / TINY


def _repeated(u: Fields, times: int) -> Fields:
    """Fields, and the data of the step, at their points ``times`` times over."""

    def over(value: Array) -> Array:
        return value if value.value.shape[-1] == 1 else Array(np.tile(value.value, times), None)

    context: Any = _Repeated(u.context, times, over)
    parts = Lazy(lambda name: over(u.parts[name]), u.layout.names, CELLS)
    return Fields(u.layout, parts, context, lambda name: over(u.gradient(name)))


class _Repeated:
    """A context of cells at points that stand there several times."""

    def __init__(self, context: Any, times: int, over: Callable[[Array], Array]) -> None:
        self._context, self._times, self._over = context, times, over

    def __getattr__(self, name: str) -> Any:
        value, over = getattr(self._context, name), self._over
        if name == "old":
            value = _repeated(value, self._times)
        elif name in ("average", "given"):
            return lambda function: over(value(function))
        elif isinstance(value, Array):
            value = over(value)
        setattr(self, name, value)
        return value

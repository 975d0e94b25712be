"""Fields and tests at the points of a rule by arrays: made when asked for, incremented, recorded."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError
from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.system import Step
from ngvisco.forms.upwinding import SideMean
from ngvisco.physics.arrays import TINY, Array, Linear, slots
from ngvisco.reduced.unknowns import in_cells

Coefficients = Mapping[str, np.ndarray]
"""Coefficients of unknowns by name, (components, functions); of scalars (functions,)."""

TOGETHER = 8192
"""Points of all directions that are taken together: what is made of them stays in the processor's cache."""

CELLS, FACETS = "in cells", "on facets"


class NotAtPointsError(NgviscoError, LookupError):
    """A term asks for something that there is not at the points of a rule."""


class Lazy(Mapping[str, Any]):
    """Values by name that are made when they are asked for."""

    def __init__(self, make: Mapping[str, Callable[[], Any]], place: str) -> None:
        self._make, self._made, self._place = make, {}, place  # type: ignore[var-annotated]

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            if name not in self._make:
                raise NotAtPointsError(f"there is no {name} {self._place}")
            self._made[name] = self._make[name]()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._make)

    def __len__(self) -> int:
        return len(self._make)


def fields_of(
    layout: Any, makers: Mapping[str, Any], gradients: Mapping[str, Any], place: str, context: Any
) -> Fields:
    """Fields of the values and gradients that ``makers`` and ``gradients`` give, (..., points), by name."""

    def constant(make: Callable[[], np.ndarray]) -> Callable[[], Array]:
        return lambda: Array(make(), None)

    parts = Lazy({name: constant(make) for name, make in makers.items()}, place)
    slopes = Lazy({name: constant(make) for name, make in gradients.items()}, f"{place}, as a gradient")
    return Fields(layout, parts, context, lambda name: slopes[name])


def with_values(u: Fields, grad_v: np.ndarray | None = None, **given: np.ndarray) -> Fields:
    """The same fields with other values of some unknowns, or of grad v."""
    parts = {name: Array(values, None) for name, values in given.items()}
    other = Fields(u.layout, ChainMap(parts, u.parts), u.context, u.gradient)  # type: ignore[arg-type]
    if grad_v is not None:
        other.__dict__["grad_v"] = Array(grad_v, None)
    return other


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
    """The same fields, and what is known, at their points ``times`` times over."""

    def over(value: Array) -> Array:
        return value if value.value.shape[-1] == 1 else Array(np.tile(value.value, times), None)

    c = u.context
    known = {name: partial(lambda name: over(getattr(c, name)), name) for name in ("h", "momentum_old")}
    context: Any = _Known(
        known | {"old": lambda: _repeated(c.old, times)},
        rate=c.rate,
        rates=c.rates,
        terms=c.terms,
        average=lambda value: over(c.average(value)),
        given=lambda value: over(c.given(value)),
    )
    parts = Lazy({name: partial(lambda name: over(u.parts[name]), name) for name in u.parts}, CELLS)
    return Fields(u.layout, parts, context, lambda name: over(u.gradient(name)))


class _Known(SimpleNamespace):
    """A context some of which is made where it is asked for."""

    def __init__(self, made: Mapping[str, Callable[[], Any]], **known: Any) -> None:
        super().__init__(_made=made, **known)

    def __getattr__(self, name: str) -> Any:
        value = self._made[name]()
        setattr(self, name, value)
        return value


def shapes_of(step: Step) -> dict[str, tuple[int, ...]]:
    """Shapes of the values of the unknowns that have tests, by name."""
    names = dict.fromkeys((*in_cells(step.layout), *on_sides(step)))
    return {name: step.layout.unknowns[name].shape for name in names if name != "zeta"}


def on_sides(step: Step) -> list[str]:
    """Unknowns with tests on facets: of cells, and means of both sides."""
    means = (term.name for term in step.terms if isinstance(term, SideMean))
    density = [name for name in ("rho", "rho_hat") if name in step.layout.unknowns]
    return ["v", *density, "z", *means]


def tests_of(step: Step, inside: bool, context: Any) -> Fields:
    """Tests that record what multiplies them: with gradients in cells, with those of traces on facets."""
    shapes, d = shapes_of(step), step.mesh.dim
    place = CELLS if inside else FACETS
    names = [name for name in in_cells(step.layout) if name in shapes] if inside else on_sides(step)
    parts = {name: partial(Linear, shapes[name], slot=name) for name in names}
    slopes = {
        name: partial(Linear, (*shapes[name], d), slot=f"grad {name}") for name in (names if inside else ())
    }
    gradients = Lazy(slopes, f"{place}, as a gradient")
    return Tests(step.layout, Lazy(parts, place), context, lambda name: gradients[name])


def slots_of(parts: list[Linear]) -> dict[str, np.ndarray]:
    """What multiplies each test in a sum of linear forms, (..., points), by the test's name."""
    if not parts:
        return {}
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return slots(total)

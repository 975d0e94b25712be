"""What a simulation is given, checked before anything is computed."""

from collections.abc import Mapping, Sequence
from typing import Any

from ngvisco.errors import ParameterError, require_collection, require_names
from ngvisco.physics.walls import Wall


def check_arguments(
    observers: object, walls: object, passive: object, sources: object, terms: object
) -> None:
    """Raise ParameterError for an argument of ``Simulation`` of the wrong type."""
    require_collection("Simulation.observers", observers, "a sequence of observers")
    for observer in observers:  # type: ignore[attr-defined]
        check_observer(observer)
    require_names("Simulation.passive", passive)
    if walls is not None:
        _check_walls(walls)
    if sources is not None and not _has_methods(sources, ("form", "entries")):
        raise ParameterError("Simulation.sources", sources, "a Term, with the methods form and entries")
    require_collection("Simulation.terms", terms, "a sequence of Terms")
    for term in terms:  # type: ignore[attr-defined]
        if isinstance(term, type) or not _has_methods(term, ("form", "entries")):
            raise ParameterError("Simulation.terms", term, "objects with the methods form and entries")


def check_observer(observer: object) -> None:
    """Raise ParameterError unless the object has an observer's methods."""
    if isinstance(observer, type) or not _has_methods(observer, ("start", "step", "finish")):
        raise ParameterError(
            "Simulation.observers", observer, "objects with the methods start, step and finish"
        )


def times_of(start: float, end: float) -> list[float]:
    """The times of a run at which its loads and walls are looked at before it begins, s."""
    return [start + i / _LOOKED_AT * (end - start) for i in range(_LOOKED_AT + 1)]


_LOOKED_AT = 4


def _check_walls(walls: Any) -> None:
    expected = "a mapping of boundary names to Wall objects, e.g. {'top': NoSlip()}"
    pairs = walls.items() if isinstance(walls, Mapping) else walls
    if isinstance(pairs, (str, Wall)):
        raise ParameterError("Simulation.walls", walls, expected)
    try:
        keys = [key for key, _ in pairs]
    except (TypeError, ValueError):
        raise ParameterError("Simulation.walls", walls, expected) from None
    for key in keys:
        names = (key,) if isinstance(key, str) else key
        if not isinstance(names, (tuple, list)) or not all(isinstance(name, str) for name in names):
            raise ParameterError("Simulation.walls", key, "the name of a boundary, or a tuple of names")


def _has_methods(value: object, names: Sequence[str]) -> bool:
    return all(callable(getattr(value, name, None)) for name in names)

"""Checks of the arguments of a ``Simulation``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ngvisco.errors import ParameterError, require_collection, require_names
from ngvisco.forms.term import point_terms
from ngvisco.physics.walls import Wall

_OF_OBSERVERS = ("start", "step", "finish")
_OF_POINT_TERMS = ("unknowns", "projections", "impulses")


def check_arguments(observers: Any, walls: Any, passive: Any, sources: Any, terms: Any) -> None:
    require_observers(require_collection("Simulation.observers", observers, "a sequence of observers"))
    require_names("Simulation.passive", passive)
    if walls is not None:
        _check_walls(walls)
    if sources is not None:
        require_methods("sources", sources, ("form", "entries"), "a Term, with")
    for term in require_collection("Simulation.terms", terms, "a sequence of Terms"):
        require_methods("terms", term, ("form", "entries"))
        if not point_terms([term]) and (names := [n for n in _OF_POINT_TERMS if hasattr(term, n)]):
            has = " and ".join(names)
            expected = f"an object of a class that derives from nv.PointTerm, since the term has {has}"
            raise ParameterError("Simulation.terms", term, expected)


def require_observers(observers: Sequence[Any]) -> None:
    """Raise ParameterError for an object that is no observer, for an observer that is given twice, and for
    two observers that write to one file or to one series of files."""
    places = set[Any]()
    for observer in observers:
        require_methods("observers", observer, _OF_OBSERVERS)
        series = getattr(observer, "directory", None)  # two kinds of series may share a directory
        path = getattr(observer, "path", None) or series
        place = (Path(path).resolve(), series and type(observer)) if path else id(observer)
        if place in places:
            expected = "each observer once, and a file or a directory of its own for each"
            raise ParameterError("Simulation.observers", str(path or observer), expected)
        places.add(place)


def require_methods(name: str, value: object, methods: Sequence[str], kind: str = "objects with") -> None:
    if isinstance(value, type) or not all(callable(getattr(value, method, None)) for method in methods):
        *first, last = methods
        raise ParameterError(f"Simulation.{name}", value, f"{kind} the methods {', '.join(first)} and {last}")


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

"""Typed errors: each names the field, the value and what would be right.

``NgviscoError`` is the root, so that a caller can catch everything of ours and nothing else, and
``NgviscoWarning`` that of the warnings.
"""

import dataclasses
import difflib
import inspect
import math
import numbers
import re
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np


class NgviscoError(Exception):
    """Root of all errors that ngvisco raises on purpose.

    Attributes
    ----------
    key : str
        The parameter at fault, e.g. ``"NeoHookean.G_e"``, ``"walls['top'].f"``; empty where none is.
    """

    key = ""


class ParameterError(NgviscoError, ValueError):
    """A parameter has a value that the model or the scheme does not admit.

    Attributes
    ----------
    field : str
        Name of the offending parameter, e.g. ``"NeoHookean.G_e"``.
    value : object
        What was given.
    expected : str
        What would be right.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field, self.value, self.expected = field, value, expected
        self.key = field
        # objects without a text of their own, such as NGSolve's functions, by their class
        shown = re.sub(r"<(?:[\w.]+\.)?(\w+) object at 0x[0-9a-f]+>", r"<\1>", repr(value))
        super().__init__(f"{field} = {shown}: expected {expected}")


class UnknownNameError(NgviscoError, KeyError):
    """A name (boundary, material variable, column, ...) that does not exist."""

    def __init__(self, kind: str, name: str, known: Iterable[str], key: str = "") -> None:
        self.kind, self.name, self.known, self.key = kind, name, sorted(set(known)), key
        hint = nearest(str(name), self.known)
        self.message = f"unknown {kind} {name!r}{hint} (known: {listed(self.known)})"
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return self.message


def nearest(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` or nothing."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


def listed(names: Iterable[str]) -> str:
    """Names for a message: of the components of a tensor, ``F_11`` to ``F_33``, the first and the last."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"_[1-3]{1,2}$", "_", name), []).append(name)
    parts = (f"{g[0]} ... {g[-1]}" if len(g) > 3 else ", ".join(g) for g in groups.values())
    return ", ".join(parts) or "none"


class MeshError(NgviscoError, ValueError):
    """A mesh on which the scheme cannot be posed (no volume elements, inverted ones, ...)."""


class InitialDataError(NgviscoError, ValueError):
    """Initial data outside the set where the model is defined (rho_0 <= 0, det F_0 <= 0, NaN)."""

    def __init__(self, field: str, value: object, expected: str, key: str = "Initial") -> None:
        self.field, self.value, self.expected, self.key = field, value, expected, key
        super().__init__(f"initial {field}: {value}; expected {expected}")


class StopRequested(NgviscoError):
    """A step was given up because the run was asked to stop; the state is that before it."""


class StepError(NgviscoError, RuntimeError):
    """A Rothe step could not be solved; the state is that before the step.

    Attributes
    ----------
    history : tuple of ``ngvisco.solver.problem.Attempt``
        What was tried: each solve's start values, its iterations and why it failed.
    report : ``ngvisco.run.failure.FailureReport`` or None
        Where and why, and what to change, of a step of a ``Simulation``.
    """

    report: Any = None  # as the attempts, of a room above this one

    def __init__(self, message: str, history: Sequence[Any] = ()) -> None:
        self.history: tuple[Any, ...] = tuple(history)
        super().__init__(message)


class NotANumberError(StepError):
    """A number that a run was to note is none, of a probe, a force or an integral.

    The state is that of the step that has been taken.
    """


class CheckpointError(NgviscoError, RuntimeError):
    """A checkpoint cannot be read, or belongs to another mesh, discretisation or model."""


class NgviscoWarning(UserWarning):
    """Root of all warnings of ngvisco."""


class InputWarning(NgviscoWarning):
    """Input that the model takes otherwise than it may be meant; the message says how, and what to change."""


class Quantity(NamedTuple):
    """An annotation of a parameter beside its type: ``Annotated[float, Quantity("Pa", "> 0")]``.

    Attributes
    ----------
    unit : str
        SI unit; "1" for pure numbers, "" for what is no number.  Exponents may be other parameters.
    range : str
        The numbers that are admitted, as ``"> 0"``, ``"in (0, 1]"`` or ``"from 1 to 8"``; "" for all.
    example : value, optional
        As a case file may have it, for what has no default.
    mean : str
        Which mean of a modulus a cell has where it jumps (``ngvisco.physics.parameters``); "" is geometric
        for what is > 0, and that of a root for what may be 0.
    """

    unit: str = ""
    range: str = ""
    example: Any = None
    mean: str = ""


def as_number(value: object) -> float | None:
    """The finite real number that ``value`` is, or None.

    Numbers of Python and NumPy are taken, and arrays without dimensions; not bool, texts or functions.
    """
    value = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        return None
    try:
        number = float(value)
    except OverflowError:  # an int beyond 1.8e308
        return None
    return number if math.isfinite(number) else None


def _is_number(value: object) -> bool:
    return as_number(value) is not None


def as_integer(value: object) -> int | None:
    """The integer that ``value`` is, of Python's or NumPy's types, or None; 2.0 is none."""
    value = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    is_integer = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return int(value) if is_integer else None  # type: ignore[call-overload]


class Declared(NamedTuple):
    """The declaration of a parameter: its range, and the types that are admitted."""

    range: str
    kinds: tuple[Any, ...]
    mean: str = ""

    @property
    def is_number(self) -> bool:
        """Whether numbers are admitted."""
        return not {int, float}.isdisjoint(self.kinds)

    @property
    def expected(self) -> str:
        """In words, for messages."""
        kinds = [kind for kind in self.kinds if kind in (int, float)] or self.kinds
        return " or ".join(_words(kind, self.range) for kind in kinds if kind is not NoneType)

    def number(self, value: object) -> float | None:
        """The number that the value is, of Python's types; None where it is none of the range."""
        number = as_number(value) if float in self.kinds else as_integer(value)
        if number is None or not _is_within(number, self.range):
            return None
        return value if isinstance(value, (int, float)) else number

    def taken(self, field: str, value: object) -> Any:
        """The value, with numbers of Python and sequences as tuples; raises ParameterError.

        A type that is known to other packages alone takes any value.
        """
        if (value is None and NoneType in self.kinds) or not all(map(_is_known, self.kinds)):
            return value
        for kind in self.kinds:
            if (taken := _taken(kind, self.range, value)) is not None:
                return taken
        raise ParameterError(field, value, self.expected)


def _kinds(hint: Any) -> tuple[Any, ...]:
    """The types of a union, or the one type."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _is_known(kind: Any) -> bool:
    """Whether a type can be checked here: one of Python, a class of this package, or a container."""
    if not isinstance(kind, type) or get_origin(kind) is not None:
        first, *others = get_args(kind) or (None,)
        is_uniform = all(other in (first, Ellipsis) for other in others)
        return get_origin(kind) in (Literal, Sequence, Mapping) or (get_origin(kind) is tuple and is_uniform)
    is_ours = kind.__module__.partition(".")[0] == __name__.partition(".")[0]
    return kind in (int, float, bool, str, NoneType) or (is_ours and not getattr(kind, "_is_protocol", False))


def _taken(kind: Any, range: str, value: Any) -> Any:
    """The value as a type takes it; None where it does not."""
    container, parts = get_origin(kind), get_args(kind)
    if container is Literal:
        key = value if isinstance(value, str) else as_integer(value)
        return key if key in parts else None
    if container is Mapping:
        is_mapping = isinstance(value, Mapping) and all(isinstance(name, str) for name in value)
        return value if is_mapping and _members(parts[1], range, value.values()) is not None else None
    if container is not None:
        if isinstance(value, (str, bytes, Mapping)) or not hasattr(value, "__iter__"):
            return None
        count, members = _count(parts), _members(parts[0], range, value)
        return members if members is None or count in (None, len(members)) else None
    if kind in (int, float):
        return Declared(range, (kind,)).number(value)
    return value if isinstance(value, kind) else None


def _members(hint: Any, range: str, values: Iterable[Any]) -> tuple[Any, ...] | None:
    """The members of a container as their type takes them; None where it does not take one of them."""
    kinds = _kinds(hint)
    if not all(isinstance(kind, type) and _is_known(kind) for kind in kinds):
        return tuple(values)
    found = [next((t for k in kinds if (t := _taken(k, range, one)) is not None), None) for one in values]
    return None if any(member is None for member in found) else tuple(found)


def _count(parts: tuple[Any, ...]) -> int | None:
    """How many members a tuple has; None for any number."""
    return None if len(parts) == 1 or parts[-1] is Ellipsis else len(parts)


def _words(kind: Any, range: str) -> str:
    """A type and the range of its numbers, for messages."""
    container, parts = get_origin(kind), get_args(kind)
    if container is Literal:
        return f"one of {', '.join(map(str, parts))}"
    if container is not None:
        kinds = _kinds(parts[1] if container is Mapping else parts[0])
        plain = {float: f"finite numbers {range}", int: f"whole numbers {range}", str: "names"}
        named = " or ".join(", ".join(k.__name__ for k in kinds).rsplit(", ", 1)) + " objects"
        objects = plain.get(kinds[0], named).rstrip()
        if container is Mapping:
            return f"a mapping of names to {objects}" if all(map(_is_known, kinds)) else "a mapping of names"
        return f"a sequence of {objects}" if (count := _count(parts)) is None else f"{count} {objects}"
    if kind in (int, float):
        whole, is_open = "whole " * (kind is int), range == "" or range.startswith(">")
        return f"a {'finite ' * (is_open and not whole)}{whole}number {range}".rstrip()
    if kind in (bool, str):
        return "True or False" if kind is bool else "a text"
    return f"a{'n' * (kind.__name__[0] in 'AEIOU')} {kind.__name__}"


_RANGE = re.compile(r"(>=?|from|in) ([\[(]?)([\d./]+)(?:,? (?:to )?([\d./]+)([\])]?))?(?: degrees)?")


def _is_within(number: float, text: str) -> bool:
    if not text:
        return True
    sign, left, low, high, right = _RANGE.fullmatch(text).groups()  # type: ignore[union-attr]
    if number < Fraction(low) or (number == Fraction(low) and (sign == ">" or left == "(")):
        return False
    return high is None or number < Fraction(high) or (number == Fraction(high) and right != ")")


@cache
def declared(kind: type) -> dict[str, Declared]:
    """The declarations of a dataclass's parameters: their types, and what ``Quantity`` says of them.

    A class that annotates a parameter of its base anew, without a quantity, keeps the base's range.
    """
    said: dict[str, Quantity] = {}
    for each in reversed(inspect.getmro(kind)):
        for name, hint in get_type_hints(each, include_extras=True).items():
            for part in getattr(hint, "__metadata__", ()):
                if isinstance(part, Quantity):
                    said[name] = part
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    quantities = {name: said.get(name, Quantity()) for name in names}
    return {name: Declared(q.range, _kinds(hints[name]), q.mean) for name, q in quantities.items()}


def require_fields(owner: Any) -> None:
    """Raise ParameterError unless every parameter of a dataclass is of the type and in the range that its
    annotation says.

    What may be more than a number of Python or an object of this package is not looked at.
    """
    for name, said in declared(type(owner)).items():  # type: ignore[arg-type]
        value = getattr(owner, name)
        if (taken := said.taken(f"{type(owner).__name__}.{name}", value)) is not value:
            object.__setattr__(owner, name, taken)


def require_effect(owner: Any, has_effect: bool, where: str, *names: str) -> None:
    """Raise ParameterError for a parameter of a dataclass that is set to no effect.

    Parameters
    ----------
    has_effect : bool
        Whether the parameters have an effect, beside the others.
    where : str
        Where they have none, in words: "with nu = 0".
    names : str
        The parameters; those that the dataclass does not have are left out.
    """
    if has_effect:
        return
    for field in dataclasses.fields(owner):
        if field.name in names and (value := getattr(owner, field.name)) != field.default:
            expected = f"{field.default}, the default: it has no effect {where}"
            raise ParameterError(f"{type(owner).__name__}.{field.name}", value, expected)


def require_positive(owner: str, **values: float) -> None:
    """Raise ParameterError unless every value is a finite number > 0."""
    for name, value in values.items():
        Declared("> 0", (float,)).taken(f"{owner}.{name}", value)


def require_count(owner: str, **values: int) -> None:
    """Raise ParameterError unless every value is an integer >= 1."""
    for name, value in values.items():
        Declared(">= 1", (int,)).taken(f"{owner}.{name}", value)


def require_type(field: str, value: object, kind: type) -> None:
    """Raise ParameterError unless the value is a ``kind``."""
    if not isinstance(value, kind):
        name = f"a {kind.__module__.split('.')[0]}.{kind.__name__}"
        raise ParameterError(field, value, "True or False" if kind is bool else name)


def require_path(field: str, value: object) -> Path:
    """The path; raises ParameterError for what is none."""
    try:
        return Path(value)  # type: ignore[arg-type]
    except TypeError:
        raise ParameterError(field, value, "a path") from None


def require_file(field: str, value: object) -> Path:
    """The path, which a file has or may have; raises ParameterError for a directory and what is no path."""
    path = require_path(field, value)
    if path.is_dir():
        raise ParameterError(field, str(path), "the path of a file; this is a directory")
    return path


def require_collection(field: str, value: object, expected: str) -> list[Any]:
    """The members of a sequence, set or array; raises ParameterError for others, a text and a mapping."""
    is_whole = hasattr(value, "__iter__") and hasattr(value, "__len__")
    if isinstance(value, (str, bytes, Mapping)) or not is_whole:
        raise ParameterError(field, value, expected)
    return list(value)  # type: ignore[call-overload]


def require_names(field: str, value: object) -> list[str]:
    """The names in a sequence of texts; raises ParameterError for anything else, and for one text."""
    names = require_collection(field, value, "a sequence of names")
    if not all(isinstance(name, str) for name in names):
        raise ParameterError(field, value, "a sequence of names")
    return names


def require_some_names(field: str, value: object) -> list[str]:
    """The names, each once and at least one; raises ParameterError."""
    names = require_names(field, value)
    if not names or len(set(names)) < len(names):
        raise ParameterError(field, value, "at least one name, and each once")
    return names


def as_numbers(field: str, value: object, expected: str = "a sequence of finite numbers") -> list[float]:
    """The numbers in a sequence; raises ParameterError for anything that is no finite number."""
    numbers = [as_number(entry) for entry in require_collection(field, value, expected)]
    if None in numbers:
        raise ParameterError(field, value, expected)
    return [number for number in numbers if number is not None]


def as_place(field: str, value: object) -> tuple[float, ...]:
    """Two or three finite numbers, m; raises ParameterError."""
    expected = "two or three finite numbers"
    if len(numbers := as_numbers(field, value, expected)) not in (2, 3):
        raise ParameterError(field, value, expected)
    return tuple(numbers)

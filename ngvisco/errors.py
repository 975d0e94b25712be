"""Typed errors: each names the field, the value and the expected value.

``NgviscoError`` is the root of all errors of ngvisco, so that a caller can catch these alone.
``NgviscoWarning`` is the root of all warnings of ngvisco.
"""

import dataclasses
import difflib
import inspect
import math
import numbers
import pickle
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from ngvisco.words import Mention, Words


class NgviscoError(Exception):
    """Root of all errors that ngvisco raises on purpose.

    Attributes
    ----------
    key : str
        The parameter at fault, e.g. ``"NeoHookean.G_e"``, ``"walls['top'].f"``; empty if there is none.
    """

    key = ""

    def __reduce__(self) -> tuple[Any, ...]:  # Exception.__reduce__ gives the constructor a message alone
        attributes = {name: value for name, value in vars(self).items() if can_be_copied(value)}
        return BaseException.__new__, (type(self), *self.args), attributes


def can_be_copied(value: object) -> bool:
    """True if another process can get a copy of a value."""
    try:
        pickle.loads(pickle.dumps(value))
    except Exception:  # a value's own methods may raise any exception
        return False
    return True


class ParameterError(NgviscoError, ValueError):
    """The parameter ``field``, such as ``"NeoHookean.G_e"``, has a ``value`` that model or scheme do not
    admit; ``expected`` has the parts of ``Words`` that describe admissible values."""

    def __init__(self, field: str, value: object, *expected: object) -> None:
        self.field, self.value, self.expected = field, value, Words(*expected)
        self.key = field
        # objects with Python's default text, such as NGSolve's functions, are shown by their class
        shown = re.sub(r"<(?:[\w.]+\.)?(\w+) object at 0x[0-9a-f]+>", r"<\1>", repr(value))
        said = value if value is None or isinstance(value, bool) else shown
        super().__init__(Words(Mention(field), " = ", said, ": expected ", self.expected))


class UnknownNameError(NgviscoError, KeyError):
    """A name (boundary, material variable, column, ...) does not exist."""

    def __init__(self, kind: str, name: str, known: Iterable[str], key: str = "") -> None:
        self.kind, self.name, self.known, self.key = kind, name, sorted(set(known)), key
        hint = nearest(str(name), self.known)
        self.message = Words("unknown ", Mention(kind), f" {name!r}{hint} (known: {listed(self.known)})")
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return self.message


def planar(field: str, function: Any, dim: int) -> Any:
    """The coefficient function; raises ParameterError if it reads z in the plane, where NGSolve's z is 0."""
    if dim == 2 and "coordinate z" in str(function):
        raise ParameterError(field, function, "a function of x and y, since a mesh in the plane has no z")
    return function


def require_known(kind: str, names: Iterable[str], known: Collection[str], key: str = "") -> None:
    """Raise UnknownNameError for the first name not in ``known``; the name is put into [] of ``key``."""
    for name in names:
        if name not in known:
            raise UnknownNameError(kind, name, known, key.replace("[]", f"[{name!r}]"))


def nearest(name: str, known: Iterable[str]) -> str:
    """Hint ``; did you mean 'x'?`` for a message, or an empty text."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


def listed(names: Iterable[str]) -> str:
    """Names for a message; components of a tensor are shortened to the first and last, ``F_11 ... F_33``."""
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"_[1-3]{1,2}$", "_", name), []).append(name)
    parts = (f"{g[0]} ... {g[-1]}" if len(g) > 3 else ", ".join(g) for g in groups.values())
    return ", ".join(parts) or "none"


class MeshError(NgviscoError, ValueError):
    """The scheme cannot be posed on a mesh (no volume elements, inverted elements, ...)."""


class InitialDataError(NgviscoError, ValueError):
    """Initial data are outside the set where the model is defined (rho_0 <= 0, det F_0 <= 0, NaN)."""

    def __init__(self, field: str, value: object, expected: str, key: str = "Initial") -> None:
        self.field, self.value, self.expected, self.key = field, value, expected, key
        super().__init__(Words(f"initial {field}: {value}; expected ", expected))


class StopRequested(NgviscoError):
    """A step, or derivatives of a run, were given up because the run was asked to stop.

    The state is the one before the step.
    """


class StepError(NgviscoError, RuntimeError):
    """A Rothe step could not be solved; the state before the step is restored.

    Attributes
    ----------
    history : tuple of ``ngvisco.solver.problem.Attempt``
        Attempts: each solve's start values, iterations and reason of failure.
    report : ``ngvisco.run.failure.FailureReport`` or None
        Place and cause of the failure of a ``Simulation``'s step, and remedies.
    """

    report: Any = None  # typed Any, because this room may not import the report's class

    def __init__(self, message: str, history: Sequence[Any] = ()) -> None:
        self.history: tuple[Any, ...] = tuple(history)
        super().__init__(message)


class NotANumberError(StepError):
    """An output number of a run (a probe, a force or an integral) is not a number.

    The state after the step is kept.
    """


class CheckpointError(NgviscoError, RuntimeError):
    """A checkpoint cannot be read, or belongs to another mesh, discretisation or model."""


class NgviscoWarning(UserWarning):
    """Root of all warnings of ngvisco."""


class InputWarning(NgviscoWarning):
    """Input that the user may mean in another sense than the model; the message says what to change."""


class Quantity(NamedTuple):
    """An annotation of a parameter beside its type: ``Annotated[float, Quantity("Pa", "> 0")]``.

    Attributes
    ----------
    unit : str
        SI unit; "1" for pure numbers, "" for other objects.  Exponents may be names of parameters.
    range : str
        Admitted numbers, as ``"> 0"``, ``"in (0, 1]"`` or ``"from 1 to 8"``; "" for all.
    example : value, optional
        Example for a case file, for a parameter without default.
    mean : str
        Mean of a modulus in a cell in which the modulus jumps (``ngvisco.physics.parameters``).  "" stands
        for the geometric mean if the range is > 0, and for the mean by a root if the range includes 0.
    """

    unit: str = ""
    range: str = ""
    example: Any = None
    mean: str = ""


def as_number(value: object) -> float | None:
    """``value`` as a finite real number, or None.

    Numbers of Python and NumPy are accepted, and arrays without dimensions; not bool, texts or functions.
    """
    value = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        return None
    try:
        number = float(value)
    except OverflowError:  # an int beyond 1.8e308
        return None
    return number if math.isfinite(number) else None


def as_integer(value: object) -> int | None:
    """``value`` as an integer if it has an integer type of Python or NumPy, otherwise None (also for 2.0)."""
    value = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    is_integer = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return int(value) if is_integer else None  # type: ignore[call-overload]


class Declared(NamedTuple):
    """The declaration of a parameter: its range, and the admitted types."""

    range: str
    kinds: tuple[Any, ...]
    mean: str = ""

    @property
    def is_number(self) -> bool:
        """Whether numbers are admitted."""
        return not {int, float}.isdisjoint(self.kinds)

    @property
    def expected(self) -> Words:
        """Admitted values in words, for messages."""
        kinds = [kind for kind in self.kinds if kind in (int, float)] or self.kinds
        words = [_words(kind, self.range) for kind in kinds if kind is not NoneType]
        return Words(*[part for each in words for part in (" or ", each)][1:])

    def number(self, value: object) -> float | None:
        """The value as a Python number; None if it is no number in the range."""
        number = as_number(value) if float in self.kinds else as_integer(value)
        if number is None or not _is_within(number, self.range):
            return None
        return value if isinstance(value, (int, float)) else number

    def taken(self, field: str, value: object) -> Any:
        """Convert numbers to Python's and sequences to tuples; raises ParameterError for other values.

        A type of another package admits any value.
        """
        if (value is None and NoneType in self.kinds) or not all(map(_is_known, self.kinds)):
            return value
        for kind in self.kinds:
            if (converted := _taken(kind, self.range, value)) is not None:
                return converted
        choices = [choice for kind in self.kinds if get_origin(kind) is Literal for choice in get_args(kind)]
        hint = nearest(value, map(str, choices)) if isinstance(value, str) else ""
        raise ParameterError(field, value, self.expected, hint)


def _kinds(hint: Any) -> tuple[Any, ...]:
    """Types of a union, or the single type."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _is_known(kind: Any) -> bool:
    """Whether a type can be checked here: a type of Python, a class of this package, or a container."""
    if not isinstance(kind, type) or get_origin(kind) is not None:
        first, *kinds = get_args(kind) or (None,)
        is_uniform = all(member in (first, Ellipsis) for member in kinds)
        return get_origin(kind) in (Literal, Sequence, Mapping) or (get_origin(kind) is tuple and is_uniform)
    is_ours = kind.__module__.partition(".")[0] == __name__.partition(".")[0]
    return kind in (int, float, bool, str, NoneType) or (is_ours and not getattr(kind, "_is_protocol", False))


def _taken(kind: Any, range: str, value: Any) -> Any:
    """The value converted to a type; None if the type does not admit it."""
    container, parts = get_origin(kind), get_args(kind)
    if container is Literal:
        key = value if isinstance(value, str) else as_integer(value)
        return key if key in parts else None
    if container is Mapping:
        is_mapping = isinstance(value, Mapping) and all(isinstance(name, str) for name in value)
        return value if is_mapping and _members(parts[1], range, value.values()) is not None else None
    if container is not None:
        members = _members(parts[0], range, value) if _has_members(value) else None
        return members if members is None or _count(parts) in (None, len(members)) else None
    if kind in (int, float):
        return Declared(range, (kind,)).number(value)
    return value if isinstance(value, kind) else None


def _has_members(value: Any) -> bool:
    """True for iterables other than texts and mappings; an array without dimensions has no members."""
    is_iterable = hasattr(value, "__iter__") and getattr(value, "ndim", 1) > 0
    return is_iterable and not isinstance(value, (str, bytes, Mapping))


def _members(hint: Any, range: str, values: Iterable[Any]) -> tuple[Any, ...] | None:
    """Members of a container converted to their type; None if the type does not admit a member."""
    kinds = _kinds(hint)
    if not all(isinstance(kind, type) and _is_known(kind) for kind in kinds):
        return tuple(values)
    members = [next((t for k in kinds if (t := _taken(k, range, part)) is not None), None) for part in values]
    return None if any(member is None for member in members) else tuple(members)


def _count(parts: tuple[Any, ...]) -> int | None:
    """Number of members of a tuple type; None if it is arbitrary."""
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
        return Words(True, " or ", False) if kind is bool else "a text"
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
    """Declarations of a dataclass's parameters, from their types and their ``Quantity``.

    If a class annotates a parameter of its base again without a quantity, the base's range applies.
    """
    annotated: dict[str, Quantity] = {}
    for base in reversed(inspect.getmro(kind)):
        for name, hint in get_type_hints(base, include_extras=True).items():
            for part in getattr(hint, "__metadata__", ()):
                if isinstance(part, Quantity):
                    annotated[name] = part
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    quantities = {name: annotated.get(name, Quantity()) for name in names}
    return {name: Declared(q.range, _kinds(hints[name]), q.mean) for name, q in quantities.items()}


def require_fields(owner: Any, called: str = "") -> None:
    """Raise ParameterError unless each parameter of a dataclass has the type and range of its annotation.

    Parameters whose type admits objects of other packages are not checked.  ``called`` is the name of the
    object in the error, by default that of its class.
    """
    called = called or type(owner).__name__
    for name, declaration in declared(type(owner)).items():  # type: ignore[arg-type]
        value = getattr(owner, name)
        if (converted := declaration.taken(f"{called}.{name}", value)) is not value:
            object.__setattr__(owner, name, converted)


def require_effect(owner: Any, has_effect: bool, where: str, *names: str) -> None:
    """Raise ParameterError for a parameter of a dataclass that is set without effect.

    Parameters
    ----------
    has_effect : bool
        Whether the parameters have an effect, given the values of other parameters.
    where : str
        Condition without effect, in words: "with nu = 0".
    names : str
        Names of the parameters; names that the dataclass does not have are ignored.
    """
    if has_effect:
        return
    for field in dataclasses.fields(owner):
        if field.name in names and (value := getattr(owner, field.name)) != field.default:
            expected = f"{field.default}, the default, since {field.name} has no effect {where}"
            raise ParameterError(f"{type(owner).__name__}.{field.name}", value, expected)


def require_numbers(owner: str, range: str, kind: type, **values: object) -> None:
    """Raise ParameterError unless every value is a number of the ``kind``, int or float, in the range."""
    for name, value in values.items():
        Declared(range, (kind,)).taken(f"{owner}.{name}", value)


def require_type(field: str, value: object, kind: type) -> None:
    """Raise ParameterError unless the value is a ``kind``."""
    if not isinstance(value, kind):
        name = f"a {kind.__module__.split('.')[0]}.{kind.__name__}"
        raise ParameterError(field, value, _words(bool, "") if kind is bool else name)


def require_path(field: str, value: object) -> Path:
    """The value as a path; raises ParameterError if it is no path."""
    try:
        return Path(value)  # type: ignore[arg-type]
    except TypeError:
        raise ParameterError(field, value, "a path") from None


def require_file(field: str, value: object) -> Path:
    """The value as the path of a possible file; raises ParameterError for directories and other values."""
    path = require_path(field, value)
    if path.is_dir():
        raise ParameterError(field, str(path), "the path of a file, but this path is a directory")
    return path


def require_collection(field: str, value: object, expected: str) -> list[Any]:
    """Members of a sequence, set or array; raises ParameterError for other values, texts and mappings."""
    if not _has_members(value) or not hasattr(value, "__len__"):
        raise ParameterError(field, value, expected)
    return list(value)  # type: ignore[call-overload]


def require_names(field: str, value: object) -> list[str]:
    """Names in a sequence of texts; raises ParameterError for other values, and for a single text."""
    names = require_collection(field, value, "a sequence of names")
    if not all(isinstance(name, str) for name in names):
        raise ParameterError(field, value, "a sequence of names")
    return names


def require_some_names(field: str, value: object) -> list[str]:
    """Names in a sequence of distinct texts, at least one; raises ParameterError for other values."""
    names = require_names(field, value)
    if not names or len(set(names)) < len(names):
        raise ParameterError(field, value, "at least one name, and no name twice")
    return names


def as_numbers(field: str, value: object, expected: str = "a sequence of finite numbers") -> list[float]:
    """Numbers in a sequence; raises ParameterError for a member that is no finite number."""
    numbers = [as_number(entry) for entry in require_collection(field, value, expected)]
    if None in numbers:
        raise ParameterError(field, value, expected)
    return [number for number in numbers if number is not None]


def as_place(field: str, value: object) -> tuple[float, ...]:
    """Coordinates of a place, two or three finite numbers, m; raises ParameterError for other values."""
    expected = "two or three finite numbers"
    if len(numbers := as_numbers(field, value, expected)) not in (2, 3):
        raise ParameterError(field, value, expected)
    return tuple(numbers)

"""Typed errors: each names the field, the value and what would be right.

``NgviscoError`` is the root, so that a caller can catch everything of ours and nothing else.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ngvisco.solver.options import NewtonIteration


class NgviscoError(Exception):
    """Root of all errors that ngvisco raises on purpose."""


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
        super().__init__(f"{field} = {value!r}: expected {expected}")


class UnknownNameError(NgviscoError, KeyError):
    """A name (boundary, material variable, column, ...) that does not exist."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(set(known))
        close = difflib.get_close_matches(name, self.known, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        self.message = f"unknown {kind} {name!r}{hint} (known: {', '.join(self.known) or 'none'})"
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return self.message


class MeshError(NgviscoError, ValueError):
    """A mesh on which the scheme cannot be posed (no volume elements, inverted ones, ...)."""


class InitialDataError(NgviscoError, ValueError):
    """Initial data outside the set where the model is defined (rho_0 <= 0, det F_0 <= 0, NaN)."""

    def __init__(self, field: str, value: object, expected: str) -> None:
        self.field, self.value, self.expected = field, value, expected
        super().__init__(f"initial {field}: {value}; expected {expected}")


class StepError(NgviscoError, RuntimeError):
    """A Rothe step could not be solved; the state is that before the step.

    Attributes
    ----------
    history : tuple of NewtonIteration
        What the solver saw, iteration by iteration, over all its attempts.
    """

    def __init__(self, message: str, history: Sequence[NewtonIteration] = ()) -> None:
        self.history = tuple(history)
        super().__init__(message)


class CheckpointError(NgviscoError, RuntimeError):
    """A checkpoint cannot be read, or belongs to another mesh, discretisation or model."""


def require_positive(owner: object, **values: float) -> None:
    """Raise ParameterError unless every value is a finite number > 0."""
    for name, value in values.items():
        if not (_is_number(value) and value > 0):
            raise ParameterError(f"{type(owner).__name__}.{name}", value, "a finite number > 0")


def require_nonnegative(owner: object, **values: float) -> None:
    """Raise ParameterError unless every value is a finite number >= 0."""
    for name, value in values.items():
        if not (_is_number(value) and value >= 0):
            raise ParameterError(f"{type(owner).__name__}.{name}", value, "a finite number >= 0")


def require_above(owner: object, bound: float, **values: float) -> None:
    """Raise ParameterError unless every value is a finite number > ``bound``."""
    for name, value in values.items():
        if not (_is_number(value) and value > bound):
            raise ParameterError(f"{type(owner).__name__}.{name}", value, f"a finite number > {bound:g}")


def require_type(field: str, value: object, kind: type) -> None:
    """Raise ParameterError unless the value is a ``kind``."""
    if not isinstance(value, kind):
        raise ParameterError(field, value, f"a {kind.__module__.split('.')[0]}.{kind.__name__}")


def require_choice(owner: object, choices: Sequence[object], **values: object) -> None:
    """Raise ParameterError unless every value is one of ``choices``."""
    for name, value in values.items():
        if value not in choices or isinstance(value, (bool, float)):
            raise ParameterError(
                f"{type(owner).__name__}.{name}", value, f"one of {', '.join(map(str, choices))}"
            )


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)

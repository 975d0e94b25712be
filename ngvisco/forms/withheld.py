"""Fields of which some are withheld: a term that asks for one is found out, and refused by its name."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from ngvisco.errors import NgviscoError, ParameterError


class WithheldError(NgviscoError, LookupError):
    """A term asks for a field that it must not take."""


class GivenParts(dict[str, Any]):
    """Fields by name; asking for another one raises ``WithheldError`` with ``reason`` about its name."""

    def __init__(self, fields: dict[str, Any], reason: str) -> None:
        super().__init__(fields)
        self.reason = reason

    def __missing__(self, name: str) -> NoReturn:
        raise WithheldError(self.reason.format(name=name))


@contextmanager
def refused_by_name(term: object) -> Iterator[None]:
    """Raise ParameterError with the term's name for what it must not take."""
    try:
        yield
    except WithheldError as error:
        name = type(term).__name__
        raise ParameterError("Simulation.terms", name, f"{name}: {error}") from error

"""Fields of which some are withheld: to find out what a term takes, by letting it ask."""

from __future__ import annotations

from typing import Any, NoReturn

from ngvisco.errors import NgviscoError


class WithheldError(NgviscoError, LookupError):
    """A term asks for a field that it must not take."""


class GivenParts(dict[str, Any]):
    """Fields by name; asking for another one raises ``WithheldError`` with ``reason`` about its name."""

    def __init__(self, fields: dict[str, Any], reason: str) -> None:
        super().__init__(fields)
        self.reason = reason

    def __missing__(self, name: str) -> NoReturn:
        raise WithheldError(self.reason.format(name=name))

"""Messages that keep Python's names and values as data, so that a case file's words can replace them."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Mention:
    """A parameter, class or function in a message, for which a case file has another name.

    Attributes
    ----------
    name : str
        A parameter, "Initial.F", or a class or function, "Slip".
    arguments : mapping, optional
        Arguments with which the class or function is called, ``...`` for any value; None for a parameter.
    """

    name: str
    arguments: Mapping[str, object] | None = None

    def __str__(self) -> str:
        if self.arguments is None:
            return self.name
        given = ((key, "..." if value is ... else repr(value)) for key, value in self.arguments.items())
        return f"nv.{self.name}({', '.join(f'{key}={value}' for key, value in given)})"


FUNCTION = Mention("coefficient function")


def call(name: str, **arguments: object) -> Mention:
    """The call of a class or function, to be named in a message."""
    return Mention(name, arguments)


class Words(str):
    """A message whose names and values are data, so that a case file's keys can replace those of Python.

    Attributes
    ----------
    parts : tuple of str, ``Mention``, True, False and None
        The message is their texts, joined.
    """

    parts: tuple[object, ...]

    def __new__(cls, *parts: object) -> "Words":
        whole = super().__new__(cls, "".join(map(str, parts)))
        whole.parts = tuple(inner for part in parts for inner in getattr(part, "parts", (part,)))
        return whole


def words_of(message: object) -> str:
    """The text of an error, a warning or a message, as ``Words`` if it was given as such."""
    text = message.args[0] if isinstance(message, Exception) and message.args else message
    return text if isinstance(text, Words) else str(message)

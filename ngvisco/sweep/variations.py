"""Variations: keys of a case file with their values, the combinations of values, and the runs' names."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ngvisco.case.toml import parse_override
from ngvisco.errors import NgviscoError

_LONGEST = 100
"""Largest number of characters in a run's name. File systems allow 255 bytes, and names of files contain the
run's name."""


class SweepError(NgviscoError, ValueError):
    """A parameter study cannot be run as requested."""


@dataclass(frozen=True)
class Variation:
    """A key of the case and its values, as TOML texts.

    Raises SweepError if there is no value, or if a value is repeated.
    """

    key: str
    values: tuple[str, ...]

    def __post_init__(self) -> None:
        if not self.values or not all(self.values):
            raise SweepError(f"--vary {self.key}={','.join(self.values)}: expected values between commas")
        twice = {value for value in self.values if self.values.count(value) > 1}
        if twice:
            raise SweepError(f"--vary {self.key}: expected each value once, but {min(twice)} is given twice")

    @classmethod
    def parse(cls, text: str) -> Variation:
        """Parse ``key.path=value,value,...``; commas in brackets, braces and quotes do not separate values.

        Raises SweepError if the key or values are missing, or a bracket or quote is not closed.
        """
        key, equals, values = text.partition("=")
        try:
            path, _ = parse_override(f"{key}={values}")
        except ValueError:
            path = ()
        if not equals or not path:
            raise SweepError(f"--vary {text}: expected key.path=value,value,...")
        return cls(".".join(path), tuple(_parted(values, text)))


def _parted(values: str, text: str) -> list[str]:
    parts, closing, quote = [""], [], ""
    for character in values:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in "[{(":
            closing.append({"[": "]", "{": "}", "(": ")"}[character])
        elif character in "]})":
            if not closing or closing.pop() != character:
                raise SweepError(f"--vary {text}: {character!r} has no opening bracket")
        elif character == "," and not closing:
            parts.append("")
            continue
        parts[-1] += character
    if quote or closing:
        raise SweepError(f"--vary {text}: expected {quote or closing[-1]!r} before the end of the values")
    return [part.strip() for part in parts]


@dataclass(frozen=True)
class Combination:
    """One value for each varied key; the name of the run directory depends on these keys and values alone."""

    name: str
    values: dict[str, str]
    settings: tuple[str, ...]


def combinations(variations: Sequence[Variation]) -> list[Combination]:
    """All combinations of the values; the last key varies fastest.

    Raises SweepError if there is nothing to vary, or a key is varied twice.
    """
    keys = [variation.key for variation in variations]
    if not keys:
        raise SweepError("there is nothing to vary; expected --vary key.path=value,value,...")
    for key in keys:
        if keys.count(key) > 1:
            raise SweepError(
                f"--vary {key}: expected all values of the key in one option, but the key has two options"
            )
    combinations = []
    for values in itertools.product(*(variation.values for variation in variations)):
        settings = tuple(f"{key}={value}" for key, value in zip(keys, values, strict=True))
        combinations.append(Combination(_name(settings), dict(zip(keys, values, strict=True)), settings))
    return combinations


def _name(settings: Sequence[str]) -> str:
    """Directory name that any file system accepts; a hash replaces dropped characters."""
    text = ",".join(settings)
    plain = re.sub(r"[^A-Za-z0-9._=,+-]+", "_", text)
    if plain == text and len(plain) <= _LONGEST:
        return plain
    return f"{plain[:_LONGEST]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

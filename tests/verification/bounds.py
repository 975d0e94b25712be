"""Bounds on measured numbers.

A physical number (a height, a frequency, a coefficient of restitution) has a bound on both sides, since a
one-sided bound admits any value on the other side.  A bound may be one-sided only if its quantity is of one
of ``KINDS``; each kind states why the other side needs no bound. Words in the name of the quantity determine
its kind.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

from ngvisco.errors import NgviscoError

Relation = Literal["<=", ">=", "in"]
Limit = float | tuple[float, float]


class VerificationError(NgviscoError, RuntimeError):
    """The measured quantities of a case are not those of its bounds, or a report cannot be written."""


@dataclass(frozen=True)
class Kind:
    """A kind of numbers with a one-sided bound: relation, words of the quantities, reason for one side."""

    name: str
    relation: Relation
    words: str
    reason: str

    def has(self, quantity: str, relation: Relation) -> bool:
        """Whether the kind contains bounds with this relation on this quantity."""
        return relation == self.relation and re.search(rf"\b(?:{self.words})\b", quantity) is not None


KINDS = (
    Kind(
        "order",
        ">=",
        "rates? (?:of|in (?:tau|the step))|orders?|ratio of the errors|errors? .* over that",
        "a theorem's least order: an exact scheme has any, and a coarse first mesh raises it",
    ),
    Kind(
        "control",
        ">=",
        "control|distance|difference|errors?|without",
        "a wrong answer on purpose, which must be told from the right one; how wrong it is says nothing",
    ),
    Kind("control", "<=", "control", "the same, of an order that a wrong equation does not reach"),
    Kind(
        "error",
        "<=",
        "errors?|deviation|distance|difference|drift|closure|changes?|defects?|asymmetry|excess|overlap|width"
        "|off|less one|less that|what is left|from the axis|transfers take"
        "|takes? or gives?|dissipation of midpoint|scheme and limiter",
        "the size of what vanishes in the exact solution: 0 is best, and a negative one fails",
    ),
    Kind(
        "sign",
        "<=",
        "rise|negative parts|gives",
        "an inequality that is itself the claim; by how much it holds is the setting's",
    ),
    Kind(
        "sign",
        ">=",
        "(?:least|smallest) (?:numerical )?(?:dissipation|bregman|power)",
        "the same, of what is to be positive",
    ),
    Kind(
        "effort",
        "<=",
        "iterations|processor time|steps without a solution|rejected steps|runs that ended early|cells over",
        "work: less is better",
    ),
    Kind("effort", ">=", "share of the steps", "the share of the work that went well, 1 at most"),
)
"""Kinds of numbers that may have a one-sided bound.  Most are errors and closures."""


@dataclass(frozen=True)
class Bound:
    """A bound on a measured number, and the reason for its value.

    ``relation`` is ``<=`` or ``>=`` with one limit, for the kinds of ``KINDS`` only, or ``in`` with the least
    and the largest value.  Raises VerificationError for a one-sided bound on any other number.
    """

    quantity: str
    relation: Relation
    limit: Limit
    reason: str = ""

    def __post_init__(self) -> None:
        if self.relation == "in":
            least, most = self.sides
            if not least <= most:
                raise VerificationError(f"{self.quantity} in [{least}, {most}]: least <= largest")
        elif self.kind is None:
            raise VerificationError(
                f"{self.quantity} {self.relation} {self.limit}: a physical number has two sides: 'quantity "
                f"in [least, largest]'; one side is for {', '.join(sorted({kind.name for kind in KINDS}))}, "
                "which the words of the quantity tell (tests/verification/bounds.py)"
            )

    @property
    def sides(self) -> tuple[float, float]:
        """The least and the largest value that keep the bound. On a side without a bound, the value is
        infinite."""
        if isinstance(self.limit, tuple):
            return self.limit
        if self.relation == ">=":
            return self.limit, float("inf")
        return 0.0 if self.kind is not None and self.kind.name == "error" else -float("inf"), self.limit

    @property
    def kind(self) -> Kind | None:
        """The kind that allows a one-sided bound; None for a bound with two sides."""
        found = (kind for kind in KINDS if kind.has(self.quantity, self.relation))
        return None if self.relation == "in" else next(found, None)

    def holds(self, value: float) -> bool:
        """Whether a value keeps the bound; NaN and infinite values do not."""
        least, most = self.sides
        return abs(value) < float("inf") and least <= value <= most

    def said(self, number: Callable[[float], str] = repr) -> str:
        """Relation and limit, ``<= 0.01`` or ``in [0.2, 0.4]``, with numbers as ``number`` writes them."""
        if isinstance(self.limit, tuple):
            return f"in [{number(self.limit[0])}, {number(self.limit[1])}]"
        return f"{self.relation} {number(self.limit)}"

    def __str__(self) -> str:
        """The bound as a line of a case's text."""
        return f"- {self.quantity} {self.said()}: {self.reason}"


CLOSURE = Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration")
DRIFT = Bound("drift of the mass", "<=", 1e-10, "conserved")

_NUMBER = r"[-+.\de]+"
_BOUND = re.compile(rf"(.+?) (?:(<=|>=) ({_NUMBER})|in \[({_NUMBER}), ({_NUMBER})\]): (.*)")


def parsed(case: str, text: str) -> list[Bound]:
    """The bounds in a line of a case's text, one for each name in brackets (``Cases``)."""
    if text in ("closure", "drift"):
        return [CLOSURE if text == "closure" else DRIFT]
    found = _BOUND.fullmatch(text)
    if found is None:
        raise VerificationError(
            f"{case}: {text!r}: expected 'quantity <= limit: reason' or 'quantity in [least, largest]: "
            "reason'"
        )
    quantity, relation, limit, least, most, reason = found.groups()
    several = re.fullmatch(r"(.*)\[(.*; .*)\](.*)", quantity)
    quantities = [several[1] + one + several[3] for one in several[2].split("; ")] if several else [quantity]
    if relation is None:
        return [Bound(one, "in", (float(least), float(most)), reason) for one in quantities]
    return [Bound(one, "<=" if relation == "<=" else ">=", float(limit), reason) for one in quantities]


def each(lines: Iterable[Bound | str]) -> str:
    """Lines for a case's text, one for each bound."""
    return "\n".join(map(str, lines))

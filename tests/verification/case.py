"""What a verification case is, and what a run of it gives.

A case states its bounds before it runs: they stand in the code, beside its statement.  ``run`` measures;
``judge`` compares, and can neither drop a bound nor add one.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from ngvisco.errors import NgviscoError

Relation = Literal["<=", ">="]
Status = Literal["holds", "fails", "error"]


class VerificationError(NgviscoError, RuntimeError):
    """A case measured something else than what it has bounds for, or a report cannot be written."""


@dataclass(frozen=True)
class Bound:
    """A bound on a measured number: ``quantity relation limit``, and why it is this limit."""

    quantity: str
    relation: Relation
    limit: float
    reason: str = ""

    def holds(self, value: float) -> bool:
        """False for NaN too."""
        return value <= self.limit if self.relation == "<=" else value >= self.limit


@dataclass(frozen=True)
class Table:
    """A table of the report; cells are texts or numbers, those of arrays too."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float]]

    def __post_init__(self) -> None:
        rows = [[cell if isinstance(cell, str) else float(cell) for cell in row] for row in self.rows]
        object.__setattr__(self, "rows", rows)


@dataclass(frozen=True)
class Curve:
    """One line of a plot, of sequences or arrays; ``style`` is matplotlib's short form, e.g. ``"o-"``."""

    label: str
    x: Sequence[float] | np.ndarray
    y: Sequence[float] | np.ndarray
    style: str = "o-"

    def __post_init__(self) -> None:
        for name in "xy":
            object.__setattr__(self, name, [float(v) for v in getattr(self, name)])


@dataclass(frozen=True)
class Plot:
    """A picture, kept as numbers so that it can be drawn again without running the case."""

    title: str
    xlabel: str
    ylabel: str
    curves: Sequence[Curve]
    log: Literal["", "x", "y", "xy"] = ""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a case measured: a value for each of its bounds, with tables and plots that show more."""

    values: Mapping[str, float]
    tables: Sequence[Table] = ()
    plots: Sequence[Plot] = ()
    remarks: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Case:
    """A claim, how it is measured, and the bounds that the measured numbers must keep.

    Parameters
    ----------
    name : str
        Unique, in lower case with dashes; what the command line takes.
    statement : str
        What is claimed, in one or two sentences.
    label : str
        The paper's labels, or the source of an exact solution.
    setting : str
        The problem and its discretisation in a few lines.
    bounds : tuple of Bound
        At least one.
    run : callable
        Measures, and returns an ``Outcome`` with exactly one value for each bound.
    explanation : str
        Where a bound is known not to be kept: why.  Printed with the failure, which stays a failure.
    reduced : bool
        Whether the case belongs to the reduced set.
    theme : str
        Heading of the report under which it stands, by the list of ``cases/``.
    """

    name: str
    statement: str
    label: str
    setting: str
    bounds: tuple[Bound, ...]
    run: Callable[[], Outcome]
    explanation: str = ""
    reduced: bool = False
    theme: str = ""

    def __post_init__(self) -> None:
        if not self.bounds:
            raise VerificationError(f"{self.name}: a case without a bound shows nothing")
        names = [bound.quantity for bound in self.bounds]
        if len(set(names)) < len(names):
            raise VerificationError(f"{self.name}: two bounds for one quantity among {names}")

    @property
    def fingerprint(self) -> str:
        """Changes with the claim, its setting and its bounds: a result of another one is run again."""
        said = [self.name, self.statement, self.setting, [asdict(bound) for bound in self.bounds]]
        return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class Result:
    """A case's outcome against its bounds."""

    name: str
    fingerprint: str
    version: str
    status: Status
    seconds: float
    outcome: Outcome | None = None
    error: str = ""
    failed: Sequence[str] = field(default_factory=list)

    def to_json(self) -> str:
        """Text that ``from_json`` reads back; not-a-number and infinite values included."""
        return json.dumps(asdict(self), ensure_ascii=False, indent=1)

    @staticmethod
    def from_json(text: str) -> Result:
        """The result that was written; raises ValueError or KeyError for anything else."""
        data = json.loads(text)
        outcome = data.pop("outcome")
        return Result(**data, outcome=None if outcome is None else _outcome(outcome))


def judge(case: Case, outcome: Outcome, seconds: float, version: str) -> Result:
    """Compare the measured values with the bounds.

    Raises VerificationError if a bound has no value, or a value no bound.
    """
    expected, measured = {b.quantity for b in case.bounds}, set(outcome.values)
    if expected != measured:
        raise VerificationError(
            f"{case.name}: bounds for {sorted(expected)}, measured {sorted(measured)}: they must be the same"
        )
    failed = [b.quantity for b in case.bounds if not b.holds(outcome.values[b.quantity])]
    return Result(
        name=case.name,
        fingerprint=case.fingerprint,
        version=version,
        status="fails" if failed else "holds",
        seconds=seconds,
        outcome=outcome,
        failed=failed,
    )


def _outcome(data: dict[str, Any]) -> Outcome:
    plots = [Plot(**{**p, "curves": [Curve(**c) for c in p["curves"]]}) for p in data["plots"]]
    tables = [Table(**table) for table in data["tables"]]
    return Outcome(values=data["values"], tables=tables, plots=plots, remarks=data["remarks"])


def number(value: str | float) -> str:
    """A number as the report prints it; texts as they are."""
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return "–"
    if float(value).is_integer() and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.4g}"

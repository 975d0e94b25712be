"""Verification cases, their outcomes, and the judgement.

A case states its bounds before it runs: the bounds stand in the code, beside the claim of the case. The
function ``run`` measures. The function ``judge`` compares measured values with the bounds, and can neither
drop nor add a bound.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from tests.verification.bounds import Bound, VerificationError, parsed

# --- outcome of a case -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A table of the report. Columns may be given as one text, "a | b"; cells are texts or numbers."""

    title: str
    columns: Sequence[str]
    rows: Iterable[Iterable[Any]]

    def __post_init__(self) -> None:
        if isinstance(self.columns, str):
            object.__setattr__(self, "columns", self.columns.split(" | "))
        rows = [[cell if isinstance(cell, str) else float(cell) for cell in row] for row in self.rows]
        if any(len(row) != len(self.columns) for row in rows):
            raise ValueError(f"{self.title}: expected {len(self.columns)} cells in each row")
        object.__setattr__(self, "rows", rows)

    def drawn(
        self, x: int | None, *of: int, by: int | None = None, log: Literal["", "x", "y", "xy"] = ""
    ) -> Iterator[Table | Plot]:
        """Yield the table, and a picture of the columns ``of`` over the column ``x``, or over the row number.

        If ``by`` is given, each value in the column ``by`` has its own curves. Columns of exact values are
        dashed.
        """
        yield self
        groups: dict[str, list[list[Any]]] = {}
        for row in ([i, *row] for i, row in enumerate(self.rows, 1)):
            groups.setdefault("" if by is None else number(row[by + 1]), []).append(row)
        curves = [
            Curve(
                f"{self.columns[i]} {group}".strip(),
                [row[0 if x is None else x + 1] for row in of_group],
                [row[i + 1] for row in of_group],
                "--" if re.search("exact|theory|analytic|G_e", self.columns[i]) else "o-",
            )
            for group, of_group in groups.items()
            for i in of
        ]
        yield Plot(self.title, "row" if x is None else self.columns[x], "", curves, log)


@dataclass(frozen=True)
class Curve:
    """One curve of a plot, from sequences or arrays; ``style`` is matplotlib's short form, e.g. ``"o-"``."""

    label: str
    x: Iterable[float]
    y: Iterable[float]
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


def extrapolated(coarse: Any, middle: Any, fine: Any) -> Any:
    """Values for a step of 0 from values for tau, tau/2 and tau/4, without errors of order one and two."""
    return (8 * fine - 6 * middle + coarse) / 3


@dataclass
class RateTable:
    """Errors on a sequence of meshes or steps; the report shows them in a table with rates and a picture."""

    title: str
    size: str = "h, m"
    sizes: list[float] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=dict)

    def add(self, size: float, **errors: float) -> None:
        self.sizes.append(size)
        for name, error in errors.items():
            self.errors.setdefault(name, []).append(error)

    def rates(self, name: str) -> list[float]:
        e, h = np.array(self.errors[name]), np.array(self.sizes)
        return list(np.log(e[:-1] / e[1:]) / np.log(h[:-1] / h[1:]))

    def last(self, name: str) -> float:
        """The rate of the finest pair of sizes."""
        return float(self.rates(name)[-1])

    def lasts(self, quantity: str = "rate of {}") -> list[tuple[str, float]]:
        """The rate of the finest pair of sizes for every column, with the name of the column's quantity."""
        return [(quantity.format(name), self.last(name)) for name in self.errors]

    def require(self, **least: float) -> None:
        """Raise VerificationError, whose message is the table, if a column's last rate is smaller or NaN."""
        print(self)
        for name, rate in least.items():
            if not self.last(name) >= rate:
                raise VerificationError(f"rate of {name} < {rate}\n{self}")

    def __str__(self) -> str:
        table = self.table()
        lines = ("  ".join(map(number, row)) for row in (table.columns, *table.rows))
        return "\n".join([self.title, *lines])

    def table(self) -> Table:
        """The table of sizes, errors and rates, with a row for each size."""
        columns, cells = [self.size], [list[str | float]([size]) for size in self.sizes]
        for name, errors in self.errors.items():
            columns += [name, "rate"]
            rates = ["", *(f"{rate:.2f}" for rate in self.rates(name))]
            cells = [[*row, e, r] for row, e, r in zip(cells, errors, rates, strict=True)]
        return Table(self.title, columns, cells)

    def plot(self) -> Plot:
        """The plot of errors over sizes, doubly logarithmic."""
        curves = [Curve(name, self.sizes, errors) for name, errors in self.errors.items()]
        return Plot(self.title, self.size, "error", curves, log="xy")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The measurements of a case: a value for each of its bounds, with further tables, plots and remarks."""

    values: Mapping[str, float] = field(default_factory=dict)
    tables: Sequence[Table] = ()
    plots: Sequence[Plot] = ()
    remarks: Sequence[str] = ()


Measured = Iterable[tuple[str, Any] | Table | RateTable | Plot | str]
"""Results of a case's function: numbers with their quantities, tables, plots, and remarks, in any order."""
Run = Callable[[], Measured]


def collected(parts: Measured) -> Outcome:
    """The outcome with all results of a case's function; raises VerificationError for a repeated quantity."""
    values: dict[str, float] = {}
    tables: list[Table] = []
    plots: list[Plot] = []
    remarks: list[str] = []
    for one in parts:
        if isinstance(one, tuple):
            if one[0] in values:
                raise VerificationError(f"two numbers for one quantity, {one[0]}")
            values[one[0]] = float(one[1])
        elif isinstance(one, str):
            remarks.append(one)
        elif isinstance(one, Plot):
            plots.append(one)
        elif isinstance(one, RateTable):
            tables.append(one.table())
            plots.append(one.plot())
        else:
            tables.append(one)
    return Outcome(values=values, tables=tables, plots=plots, remarks=remarks)


# --- cases -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Case:
    """A claim, its measurement, and the bounds that the measured numbers must keep: see ``Cases``.

    ``run`` gives exactly one value for each bound; ``theme`` is the heading in the report.
    """

    name: str
    statement: str
    label: str
    setting: str
    bounds: tuple[Bound, ...]
    run: Run
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
        """Hash of the claim, its setting and its bounds; a result with another fingerprint is run again."""
        said = [self.name, self.statement, self.setting, [asdict(bound) for bound in self.bounds]]
        return hashlib.sha256(json.dumps(said).encode()).hexdigest()[:16]


class Cases(list[Case]):
    """Cases of a theme in the report's order; a text above the measuring function declares each case.

    The function has no argument, and usually is a generator; its results are ``Measured``.

    ::

        name, in lower case with dashes, and (reduced) if it belongs to the reduced set
        The claim, in one or two sentences.
        label: the paper's labels, or the source of an exact solution
        setting: the problem and its discretisation
        - quantity in [0.9, 1.1]: why the bounds are these
        - error of the quantity <= 1e-3: one side, for the kinds of ``bounds.KINDS``
        - rate of [v; rho] >= 0.9: two bounds, one for each name in the brackets
        - closure
        explanation: reason why a bound is known to fail; the report prints it beside the failure

    A line that does not begin like one of these continues the line before it.  ``closure`` and ``drift`` are
    the bounds ``CLOSURE`` and ``DRIFT``, which ``runner.run_case`` measures on all runs of a case.  ``theme``
    holds for the following cases.
    """

    def __init__(self, theme: str) -> None:
        super().__init__()
        self.theme = theme

    def __call__(self, text: str) -> Callable[[Run], Run]:
        """A decorator that adds a function's case; raises VerificationError for a text that lacks a part."""
        head, *lines = (line.strip() for line in text.splitlines() if line.strip())
        parts, last = dict[str, str](), "statement"
        for line in lines:
            begins = re.match(r"(label|setting|explanation): |- ", line)
            if begins:
                last = begins[1] or f"- {len(parts)}"
                line = line[begins.end() :]
            parts[last] = f"{parts[last]} {line}" if last in parts else line
        said = {name: of for name, of in parts.items() if not name.startswith("- ")}
        bounds = tuple(b for name, of in parts.items() if name.startswith("- ") for b in parsed(head, of))
        if missing := {"statement", "label", "setting"} - said.keys():
            raise VerificationError(f"{head}: a case without {', '.join(sorted(missing))}")
        name, reduced = head.removesuffix(" (reduced)"), head.endswith(" (reduced)")
        if not re.fullmatch(r"[a-z0-9-]+", name):  # pages link to it, and the kept report finds its row by it
            raise VerificationError(f"{name}: a case's name has small letters, digits and hyphens")

        def add(run: Run) -> Run:
            case = Case(name=name, bounds=bounds, run=run, reduced=reduced, theme=self.theme, **said)
            self.append(case)
            return run

        return add


# --- the judgement -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Result:
    """A case's outcome against its bounds."""

    name: str
    fingerprint: str
    version: str
    status: Literal["holds", "fails", "error"]
    seconds: float
    outcome: Outcome = field(default_factory=Outcome)
    error: str = ""
    failed: Sequence[str] = field(default_factory=list)

    def to_json(self) -> str:
        """Text that ``from_json`` reads back, also with values that are not finite."""
        return json.dumps(asdict(self), ensure_ascii=False, indent=1)

    @staticmethod
    def from_json(text: str) -> Result:
        """The result in a text by ``to_json``; raises ValueError, KeyError or TypeError for other texts."""
        data = json.loads(text)
        found = data.pop("outcome")
        plots = [Plot(**{**p, "curves": [Curve(**c) for c in p["curves"]]}) for p in found.pop("plots")]
        tables = [Table(**table) for table in found.pop("tables")]
        return Result(**data, outcome=Outcome(**found, tables=tables, plots=plots))


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


def number(value: str | float) -> str:
    """A number in the report's format; a text is unchanged."""
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return "–"
    if float(value).is_integer() and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.4g}"

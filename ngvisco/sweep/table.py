"""The table of a study's results: a line a run, what became of it and the last row of its ledger."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ngvisco.case.build import Case
from ngvisco.case.directory import RunDirectory
from ngvisco.run.closure import closure_limit
from ngvisco.run.files import write_atomically
from ngvisco.sweep.variations import SweepError

FINISHED, NOT_CLOSED, FAILED = "finished", "not closed", "failed"
STOPPED, WAITING = "stopped", "not started"


@dataclass
class Outcome:
    """What became of one run.

    Attributes
    ----------
    name : str
        Its directory in the study's.
    values : dict of str
        The varied keys.
    state : str
        ``"finished"``; ``"not closed"``, finished with a ledger that does not close; ``"failed"``;
        ``"stopped"`` before its end, with a checkpoint; ``"not started"``.
    message : str
        Why it failed.
    last : dict of float
        The last row of its ledger; ``largest_closure`` is the largest ``|closure_relative|`` of all rows.
    """

    name: str
    values: dict[str, str]
    state: str = WAITING
    message: str = ""
    last: dict[str, float] = field(default_factory=dict)

    @property
    def is_finished(self) -> bool:
        """Whether the run has reached its end."""
        return self.state in (FINISHED, NOT_CLOSED)

    def read(self, place: RunDirectory, case: Case) -> None:
        """Take the ledger from the run's directory, and from it whether the run has reached its end.

        Raises CheckpointError if its file cannot be read.
        """
        if not place.run_file.exists():
            return
        ledger = place.ledger()
        closure = np.abs(ledger["closure_relative"])
        self.last = {name: float(column[-1]) for name, column in ledger.items()}
        self.last["largest_closure"] = float(closure.max())
        if self.last["time"] >= case.until * (1 - 1e-9):
            limit = closure_limit(case.sections.solver.tolerance)  # type: ignore[attr-defined]
            self.state = FINISHED if bool((closure <= limit).all()) else NOT_CLOSED
        else:
            self.state = STOPPED


def read_table(path: Path) -> list[Outcome]:
    """The outcomes that a table holds; none if there is no file.

    Raises SweepError if the file is no such table.
    """
    if not path.exists():
        return []
    try:
        header, *rows = csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline=""))
        state = header.index("state")
        if header[0] != "run" or header[-1] != "message" or any(len(row) != len(header) for row in rows):
            raise ValueError
        keys, columns = header[1:state], header[state + 1 : -1]
        return [
            Outcome(
                row[0],
                {key: value for key, value in zip(keys, row[1:state], strict=True) if value},
                row[state],
                row[-1],
                {name: float(v) for name, v in zip(columns, row[state + 1 : -1], strict=True) if v},
            )
            for row in rows
        ]
    except ValueError:
        raise SweepError(
            f"{path}: expected the table of an earlier study, as it was written; move it away, or choose "
            "another directory"
        ) from None


def write_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the table as CSV, whole or not at all; keys and columns that a run lacks stay empty."""
    keys = list(dict.fromkeys(key for outcome in outcomes for key in outcome.values))
    columns = list(dict.fromkeys(name for outcome in outcomes for name in outcome.last))
    first = [name for name in ("step", "time", "largest_closure") if name in columns]
    columns = first + [name for name in columns if name not in first]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["run", *keys, "state", *columns, "message"])
    for outcome in outcomes:
        values = [outcome.values.get(key, "") for key in keys]
        ledger = [_number(outcome.last.get(name)) for name in columns]
        writer.writerow([outcome.name, *values, outcome.state, *ledger, outcome.message])
    write_atomically(path, text.getvalue().encode())


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)

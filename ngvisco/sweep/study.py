"""A parameter study: all its cases checked, those not finished run, and the table of their results.

| in a study's directory | holds                                                              |
|------------------------|--------------------------------------------------------------------|
| sweep.csv              | the table: a line a run, what became of it, its last rows          |
| cases/NAME.toml        | each run's case as resolved                                        |
| NAME/                  | its run directory (``ngvisco.case.directory``)                     |
"""

import csv
import io
import os
import signal
import threading
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ngvisco.case.build import Case, load_case
from ngvisco.case.directory import RunDirectory
from ngvisco.errors import CheckpointError, ParameterError, as_integer, require_path
from ngvisco.run.files import write_atomically
from ngvisco.run.ledger import closure_limit
from ngvisco.run.series import read_columns
from ngvisco.sweep.processes import connected, message_of, run_or_resume
from ngvisco.sweep.variations import SweepError, Variation, combinations

_LOOK = 0.5
"""Seconds between looks whether the study is to be stopped."""
_STOPPED = (128 + signal.SIGINT, 128 + signal.SIGTERM, -signal.SIGTERM)
"""Exit codes of a run that was told to stop, the last before its first step."""
FINISHED, NOT_CLOSED, FAILED = "finished", "not closed", "failed"
STOPPED, WAITING = "stopped", "not started"


@dataclass
class Outcome:
    """The result of one run.

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
        The last rows of its ledger and of ``bodies.csv``; ``largest_closure`` is the largest
        ``|closure_relative|`` of all rows.
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
        if place.bodies.exists():
            of_bodies = read_columns(place.bodies)
            self.last |= {name: float(column[-1]) for name, column in of_bodies.items() if len(column)}
        if self.last["time"] >= case.until * (1 - 1e-9):
            limit = closure_limit(case.sections.solver.tolerance)  # type: ignore[attr-defined]
            self.state = FINISHED if bool((closure <= limit).all()) else NOT_CLOSED
        else:
            self.state = STOPPED


class Study:
    """One case with some of its keys varied.

    Everything is checked when it is made, and nothing written: keys, values, each combination's case as a
    whole with its mesh, and what is in the directory already.  Raises SweepError if a key is varied twice,
    two combinations are the same case, a run directory has another case's results, or ``sweep.csv`` is no
    table of a study; CaseError with every fault of a combination's case.

    Parameters
    ----------
    path : path
        The case file.
    variations : sequence of Variation
    directory : path
        A run directory for each combination of values, and the table ``sweep.csv``.
    settings : sequence of str
        Overrides ``key.path=value`` that hold for all runs.
    force : bool
        Run all of them anew, rather than what is not finished.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        variations: Sequence[Variation],
        directory: str | os.PathLike[str],
        *,
        settings: Sequence[str] = (),
        force: bool = False,
    ) -> None:
        self.directory = require_path("Study.directory", directory).resolve()
        self.table = self.directory / "sweep.csv"
        self.force = force
        chosen = combinations(variations)
        fixed = {setting.partition("=")[0].strip() for setting in settings}
        if twice := fixed & set(chosen[0].values):
            raise SweepError(f"{min(twice)}: expected --set or --vary, but it is in both")
        self.cases = [load_case(path, [*settings, *one.settings]) for one in chosen]
        names: dict[str, str] = {}
        for one, case in zip(chosen, self.cases, strict=True):
            if (other := names.setdefault(case.resolved, one.name)) != one.name:
                raise SweepError(f"{other} and {one.name} are the same case: expected one of them")
        self.outcomes = [Outcome(one.name, one.values) for one in chosen]
        self._others = [  # of earlier studies, whose case files are there still
            other
            for other in read_table(self.table)
            if other.name not in names.values() and self._case_file(other.name).exists()
        ]
        for outcome, case in zip(self.outcomes, self.cases, strict=True):
            place = self._place(outcome)
            if force or not place.results:
                continue
            if not place.case_file.exists() or place.case().resolved != case.resolved:
                raise SweepError(
                    f"{place.path}: expected a run of this study, but it has the results of another case; "
                    "choose another directory, or run all anew with --force"
                )
            outcome.read(place, case)
        _build([self.cases[number] for number in self.unfinished])

    def _place(self, outcome: Outcome) -> RunDirectory:
        return RunDirectory(self.directory / outcome.name)

    def _case_file(self, name: str) -> Path:
        return self.directory / "cases" / f"{name}.toml"

    @property
    def unfinished(self) -> list[int]:
        """Numbers of the runs that have not reached their end."""
        return [number for number, outcome in enumerate(self.outcomes) if not outcome.is_finished]

    def run(
        self,
        *,
        workers: int | None = None,
        threads: int = 1,
        scheduler: str | None = None,
        report: Callable[[Outcome], None] = lambda outcome: None,
        stop: threading.Event | None = None,
    ) -> list[Outcome]:
        """Run what is not finished, and write the table whenever a run ends.

        Raises SweepError if dask.distributed is missing, or the scheduler cannot be used; nothing is
        written then; ParameterError ; OSError .

        Parameters
        ----------
        workers : int, optional
            Runs at once on this machine; as many as its processors have room for by default.
        threads : int
            Of each run.
        scheduler : str, optional
            Address of a dask scheduler whose workers do the runs; they have to see the same files.
        report : callable
            Called with each run's outcome when it ends.
        stop : threading.Event, optional
            When it is set, running steps are finished, and checkpoints written.
        """
        count = as_integer(max(1, (os.cpu_count() or 1) // threads) if workers is None else workers)
        if count is None or count < 1:
            raise ParameterError("workers", workers, "a whole number >= 1")
        todo = self.unfinished
        if not todo:
            self._write_table()
            return self.outcomes
        with connected(scheduler, min(count, len(todo))) as client:
            self._prepare(todo)
            self._collect(client, todo, threads, report, stop or threading.Event())
        return self.outcomes

    def _prepare(self, todo: Sequence[int]) -> None:
        for number in todo:
            place = self._place(self.outcomes[number])
            if self.force and place.results:
                with place.locked():
                    place.clear()
            file = self._case_file(self.outcomes[number].name)
            write_atomically(file, self.cases[number].resolved.encode())
        self._write_table()

    def _write_table(self) -> None:
        write_table(self.table, [*self._others, *self.outcomes])

    def _collect(
        self,
        client: Any,
        todo: Sequence[int],
        threads: int,
        report: Callable[[Outcome], None],
        stop: threading.Event,
    ) -> None:
        from distributed import Event, wait

        event = Event(f"ngvisco-stop-{uuid.uuid4().hex}", client=client)
        numbers = {}
        for number in todo:
            files = (
                str(self._case_file(self.outcomes[number].name)),
                str(self._place(self.outcomes[number]).path),
            )
            # not pure: the same run may be asked for again after it was stopped
            future = client.submit(run_or_resume, *files, threads, event.name, pure=False)
            numbers[future] = number
        pending = set(numbers)
        with client.as_current():
            while pending:
                if stop.is_set():
                    event.set()
                try:
                    done, pending = wait(pending, timeout=_LOOK, return_when="FIRST_COMPLETED")
                except TimeoutError:
                    continue
                for future in done:
                    self._end(numbers[future], future)
                    report(self.outcomes[numbers[future]])
                self._write_table()

    def _end(self, number: int, future: Any) -> None:
        outcome = self.outcomes[number]
        error = future.exception()
        code, said = (1, f"{type(error).__name__}: {error}") if error is not None else future.result()
        try:
            outcome.read(self._place(outcome), self.cases[number])
        except CheckpointError as fault:
            outcome.state, outcome.message = FAILED, str(fault)
            return
        if code in _STOPPED:
            outcome.state = STOPPED
        elif code is not None and (code not in (0, 4) or not outcome.is_finished):  # None: not begun
            outcome.state = FAILED
            outcome.message = message_of(said) or f"ended with exit code {code}"


def _build(cases: Sequence[Case]) -> None:
    """Mesh each domain once and build each simulation; raises what a case's run would raise at its start."""
    by_domain: dict[str, list[Case]] = {}
    for case in cases:
        by_domain.setdefault(repr(case.sections.domain), []).append(case)
    for same in by_domain.values():
        mesh = same[0].mesh()
        for case in same:
            case.simulation(mesh)


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
        found = []
        for row in rows:
            given = {name: text for name, text in zip(header, row, strict=True) if text}
            values = {key: given[key] for key in header[1:state] if key in given}
            last = {name: float(given[name]) for name in header[state + 1 : -1] if name in given}
            found.append(Outcome(row[0], values, row[state], row[-1], last))
        return found
    except ValueError:
        raise SweepError(
            f"{path}: expected the table of an earlier study, as it was written; move it away, or choose "
            "another directory"
        ) from None


def write_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the table as CSV, whole or not at all; keys and columns that a run lacks stay empty."""
    keys = dict.fromkeys(key for outcome in outcomes for key in outcome.values)
    columns = {name for outcome in outcomes for name in outcome.last}
    first = [name for name in ("step", "time", "largest_closure") if name in columns]
    ledger = dict.fromkeys([*first, *(name for outcome in outcomes for name in outcome.last)])
    text = io.StringIO()
    writer = csv.DictWriter(text, ["run", *keys, "state", *ledger, "message"], lineterminator="\n")
    writer.writeheader()
    for outcome in outcomes:
        last = {name: _number(value) for name, value in outcome.last.items()}
        about = {"run": outcome.name, "state": outcome.state, "message": outcome.message}
        writer.writerow({**outcome.values, **last, **about})
    write_atomically(path, text.getvalue().encode())


def _number(value: float) -> str:
    return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)

"""A parameter study, which checks all its cases, runs unfinished ones, and writes a table of results.

| in a study's directory | holds                                                              |
|------------------------|--------------------------------------------------------------------|
| sweep.csv              | the table: for each run a line with its state and its last rows    |
| cases/NAME.toml        | the resolved case of each run                                      |
| NAME/                  | each run's directory (``ngvisco.case.directory``)                  |
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
"""Seconds between checks whether to stop the study."""
_STOPPED = (128 + signal.SIGINT, 128 + signal.SIGTERM, -signal.SIGTERM)
"""Exit codes of a run stopped by SIGINT or SIGTERM; the last code is that of a stop before the first step."""
FINISHED, NOT_CLOSED, FAILED = "finished", "not closed", "failed"
STOPPED, WAITING = "stopped", "not started"


@dataclass
class Outcome:
    """The result of one run.

    Attributes
    ----------
    name : str
        Name of the run's directory within the study's.
    values : dict of str
        Values of the varied keys, as texts.
    state : str
        ``"finished"``; ``"not closed"`` (finished, but the ledger does not close); ``"failed"``;
        ``"stopped"`` (before its end, with a checkpoint); ``"not started"``.
    message : str
        Reason of a failure.
    last : dict of float
        Last rows of the ledger and of ``bodies.csv``; ``largest_closure`` is the largest
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
        """Read the last rows from the run's directory, and derive the run's state from the ledger.

        Raises CheckpointError if the run's file cannot be read.
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
    """A parameter study: one case with some of its keys varied.

    The constructor checks keys, values, each combination's case with its mesh, and existing files of the
    directory; it writes no file.  Raises SweepError if a key is varied twice, two combinations are the same
    case, ``directory`` or a run of the study has another case's results, or ``sweep.csv`` is no table of a
    study.  Raises CaseError with every fault of a combination's case.

    Parameters
    ----------
    path : path
        The case file.
    variations : sequence of Variation
    directory : path
        The study's directory, for the run directories and the table ``sweep.csv``.
    settings : sequence of str
        Overrides ``key.path=value`` for all runs.
    force : bool
        Whether finished runs are repeated as well.
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
        if RunDirectory(self.directory).versions_file.exists():
            message = f"{self.directory}: this is a run directory; choose another directory for the study"
            raise SweepError(message)
        chosen = combinations(variations)
        if twice := {setting.partition("=")[0].strip() for setting in settings} & set(chosen[0].values):
            raise SweepError(f"{min(twice)}: expected --set or --vary, but the key is in both options")
        self.cases = [load_case(path, [*settings, *variation.settings]) for variation in chosen]
        names: dict[str, str] = {}
        for variation, case in zip(chosen, self.cases, strict=True):
            if (earlier := names.setdefault(case.resolved, variation.name)) != variation.name:
                message = f"{earlier} and {variation.name} are the same case; expected distinct values"
                raise SweepError(message)
        self.outcomes = [Outcome(variation.name, variation.values) for variation in chosen]
        self._others = [  # runs of earlier studies whose case files still exist
            listed
            for listed in read_table(self.table)
            if listed.name not in names.values() and self._case_file(listed.name).exists()
        ]
        for outcome, case in zip(self.outcomes, self.cases, strict=True):
            place = self._place(outcome)
            if force or not place.results:
                continue
            if not place.case_file.exists() or place.case().resolved != case.resolved:
                raise SweepError(
                    f"{place.path}: expected a run of this study, but this directory has the results of "
                    "another case; choose another directory, or run all anew with --force"
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
        """Run the unfinished cases, and write the table whenever a run ends.

        Raises SweepError, before a file is written, if dask.distributed is missing or the scheduler cannot
        be used; ParameterError if ``workers`` is no whole number >= 1; OSError if writing fails.

        Parameters
        ----------
        workers : int, optional
            Number of simultaneous runs on this machine; by default the number of its processors divided by
            ``threads``.
        threads : int
            Number of threads of each run.
        scheduler : str, optional
            Address of a dask scheduler, whose workers need access to the same files.
        report : callable
            Called with each run's outcome when it ends.
        stop : threading.Event, optional
            Event that makes each run give up its present step and write a checkpoint.
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
            outcome = self.outcomes[number]
            files = str(self._case_file(outcome.name)), str(self._place(outcome).path)
            # pure=False makes dask run a stopped case again instead of returning the earlier result
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
        code, output = (1, f"{type(error).__name__}: {error}") if error is not None else future.result()
        try:
            outcome.read(self._place(outcome), self.cases[number])
        except CheckpointError as fault:
            outcome.state, outcome.message = FAILED, str(fault)
            return
        if code in _STOPPED:
            outcome.state = STOPPED
        # the code of a run that was not started is None
        elif code is not None and (code not in (0, 4) or not outcome.is_finished):
            outcome.state = FAILED
            outcome.message = message_of(output) or f"ended with exit code {code}"


def _build(cases: Sequence[Case]) -> None:
    """Mesh each domain once and build each simulation; raises the errors of a run's start."""
    by_domain: dict[str, list[Case]] = {}
    for case in cases:
        by_domain.setdefault(repr(case.sections.domain), []).append(case)
    for same in by_domain.values():
        mesh = same[0].mesh()
        for case in same:
            case.check_end(case.simulation(mesh))


def read_table(path: Path) -> list[Outcome]:
    """Read the outcomes of a table; an empty list if the file is missing.

    Raises SweepError if the file is no table of a study.
    """
    if not path.exists():
        return []
    try:
        header, *rows = csv.reader(io.StringIO(path.read_text(encoding="utf-8"), newline=""))
        state = header.index("state")
        if header[0] != "run" or header[-1] != "message" or any(len(row) != len(header) for row in rows):
            raise ValueError
        outcomes = []
        for row in rows:
            given = {name: text for name, text in zip(header, row, strict=True) if text}
            values = {key: given[key] for key in header[1:state] if key in given}
            last = {name: float(given[name]) for name in header[state + 1 : -1] if name in given}
            outcomes.append(Outcome(row[0], values, row[state], row[-1], last))
        return outcomes
    except ValueError:
        raise SweepError(
            f"{path}: expected the table of an earlier study, unchanged; move the file away, or choose "
            "another directory"
        ) from None


def write_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the table as CSV, atomically; keys and columns that a run lacks stay empty."""
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

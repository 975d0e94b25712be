"""A parameter study: all its cases checked, those not finished run, and the table of their results.

| in a study's directory | holds                                                              |
|------------------------|--------------------------------------------------------------------|
| sweep.csv              | the table: a line a run (``ngvisco.sweep.table``)                  |
| cases/NAME.toml        | each run's case as resolved                                        |
| NAME/                  | its run directory (``ngvisco.case.directory``)                     |
"""

import os
import signal
import threading
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ngvisco.case.build import Case, load_case
from ngvisco.case.directory import RunDirectory
from ngvisco.errors import CheckpointError, ParameterError, as_integer, require_path
from ngvisco.run.files import write_atomically
from ngvisco.sweep.processes import connected, message_of, submit
from ngvisco.sweep.table import FAILED, STOPPED, Outcome, read_table, write_table
from ngvisco.sweep.variations import Combination, SweepError, Variation, combinations

_LOOK = 0.5
"""Seconds between looks whether the study is to be stopped."""
_STOPPED = (128 + signal.SIGINT, 128 + signal.SIGTERM, -signal.SIGTERM)
"""Exit codes of a run that was told to stop, the last before its first step."""


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
        self.combinations = combinations(variations)
        _check_settings(variations, settings)
        self.cases = [load_case(path, [*settings, *c.settings]) for c in self.combinations]
        self._check_distinct()
        self.outcomes = [Outcome(c.name, c.values) for c in self.combinations]
        self._others = self._of_earlier_studies()
        if not force:
            for number, case in enumerate(self.cases):
                self._take_up(number, case)
        _build([self.cases[number] for number in self.unfinished])

    def place(self, number: int) -> RunDirectory:
        """The directory of a run."""
        return RunDirectory(self.directory / self.combinations[number].name)

    @property
    def unfinished(self) -> list[int]:
        """Numbers of the runs that have not reached their end."""
        return [number for number, outcome in enumerate(self.outcomes) if not outcome.is_finished]

    def _of_earlier_studies(self) -> list[Outcome]:
        """The table's rows of runs that this study does not name, and whose case files are there still."""
        own = {combination.name for combination in self.combinations}
        return [
            other
            for other in read_table(self.table)
            if other.name not in own and (self.directory / "cases" / f"{other.name}.toml").exists()
        ]

    def _write_table(self) -> None:
        write_table(self.table, [*self._others, *self.outcomes])

    def _check_distinct(self) -> None:
        seen: dict[str, Combination] = {}
        for combination, case in zip(self.combinations, self.cases, strict=True):
            other = seen.setdefault(case.resolved, combination)
            if other is not combination:
                raise SweepError(
                    f"{other.name} and {combination.name} are the same case: expected one of them"
                )

    def _take_up(self, number: int, case: Case) -> None:
        """What an earlier study left in a run's directory; SweepError where that is no run of this case."""
        place = self.place(number)
        if not place.results:
            return
        if not place.case_file.exists() or place.case().resolved != case.resolved:
            raise SweepError(
                f"{place.path}: expected a run of this study, but it has the results of another case; choose "
                "another directory, or run all anew with --force"
            )
        self.outcomes[number].read(place, case)

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
        if workers is None:
            workers = max(1, (os.cpu_count() or 1) // threads)
        count = as_integer(workers)
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

    def _case_file(self, number: int) -> Path:
        return self.directory / "cases" / f"{self.combinations[number].name}.toml"

    def _prepare(self, todo: Sequence[int]) -> None:
        for number in todo:
            if self.force:
                place = self.place(number)
                if place.results:
                    with place.locked():
                        place.clear()
            write_atomically(self._case_file(number), self.cases[number].resolved.encode())
        self._write_table()

    def _collect(
        self,
        client: Any,
        todo: Sequence[int],
        threads: int,
        report: Callable[[Outcome], None],
        stop: threading.Event,
    ) -> None:
        from distributed import Event, wait

        name = f"ngvisco-stop-{uuid.uuid4().hex}"
        event = Event(name, client=client)
        jobs = [(str(self._case_file(n)), str(self.place(n).path)) for n in todo]
        futures = submit(client, jobs, threads, name)
        pending = set(futures)
        with client.as_current():
            while pending:
                if stop.is_set():
                    event.set()
                try:
                    done, pending = wait(pending, timeout=_LOOK, return_when="FIRST_COMPLETED")
                except TimeoutError:
                    continue
                for future in done:
                    self._end(todo[futures[future]], future)
                    report(self.outcomes[todo[futures[future]]])
                self._write_table()

    def _end(self, number: int, future: Any) -> None:
        outcome, place = self.outcomes[number], self.place(number)
        error = future.exception()
        code, said = (1, f"{type(error).__name__}: {error}") if error is not None else future.result()
        try:
            outcome.read(place, self.cases[number])
        except CheckpointError as fault:
            outcome.state, outcome.message = FAILED, str(fault)
            return
        if code in _STOPPED:
            outcome.state = STOPPED
        elif code is not None and (code not in (0, 4) or not outcome.is_finished):  # None: not begun
            outcome.state = FAILED
            outcome.message = message_of(said) or f"ended with exit code {code}"


def _check_settings(variations: Sequence[Variation], settings: Sequence[str]) -> None:
    fixed = {setting.partition("=")[0].strip() for setting in settings}
    for variation in variations:
        if variation.key in fixed:
            raise SweepError(f"{variation.key}: expected --set or --vary, but it is in both")


def _build(cases: Sequence[Case]) -> None:
    """Mesh each domain once and build each simulation; raises what a case's run would raise at its start."""
    by_domain: dict[str, list[Case]] = {}
    for case in cases:
        by_domain.setdefault(repr(case.sections.domain), []).append(case)
    for same in by_domain.values():
        mesh = same[0].mesh()
        for case in same:
            case.simulation(mesh)

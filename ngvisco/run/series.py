"""Tables over time that observers write as CSV files and keep as arrays.

A resumed run keeps the rows up to its checkpoint and drops rows that the interrupted run wrote out of turn
when it stopped, so that the file equals the file of an uninterrupted run.
"""

from __future__ import annotations

import csv
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ngvisco.errors import (
    CheckpointError,
    NotANumberError,
    Quantity,
    require_file,
    require_known,
    require_numbers,
)
from ngvisco.run.files import AnyPath, append, csv_text, write_atomically

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation


Every = Annotated[int, Quantity("1", ">= 1")]
"""Number of steps from one row, file or checkpoint to the next."""
FIRST = ("step", "time")
"""Names of a table's first columns."""


class Series(ABC):
    """Base class of observers that record numbers over time.

    A subclass gives ``prepare``, which checks its input against the simulation and returns the columns after
    ``step`` and ``time``, and ``_sample``, which returns rows of these columns at the present state. All
    ranks call both methods together and get the same values; the first rank writes the file.

    A value that is not finite ends the run with a NotANumberError, which names the column and the time.

    ``path`` is the CSV file; without a path the rows are kept in memory only.

    Parameters
    ----------
    every : int
        A row every so many steps, and at the end.

    Attributes
    ----------
    columns : list of str
    rows : list of lists of float
    """

    initial = True
    """Whether the state before the first step has a row."""

    group: str | None = None
    """Group of a run's HDF5 file that holds the columns too; None (default) for no group."""

    def __init__(self, path: AnyPath | None = None, every: Every = 1) -> None:
        require_numbers(type(self).__name__, ">= 1", int, every=every)
        self.path = None if path is None else require_file(f"{type(self).__name__}.path", path)
        self.every = every
        self.columns: list[str] = []
        self.rows: list[list[float]] = []
        self._found: tuple[int, list[list[float]]] = -1, []

    @abstractmethod
    def prepare(self, simulation: Simulation) -> list[str]:
        """Check that the observer's input fits a simulation; return the columns after ``step`` and
        ``time``."""

    @abstractmethod
    def _sample(self, simulation: Simulation) -> Any:
        """Rows at the present state, without ``step`` and ``time``."""

    def sample(self, simulation: Simulation) -> np.ndarray:
        """Rows at the present state without ``step`` and ``time``, (rows, columns); not recorded."""
        return np.atleast_2d(np.asarray(self._sample(simulation), dtype=float))

    def unit(self, column: str) -> str:
        """SI unit of a column, for the HDF5 file."""
        return {"time": "s"}.get(column, "1")

    def column(self, name: str) -> np.ndarray:
        """Values of a column in all rows so far; ``"time"`` is in s."""
        require_known("column", [name], self.columns)
        return np.array([row[self.columns.index(name)] for row in self.rows])

    def may_be_nan(self, column: str) -> bool:
        """Whether a column may be NaN where there is nothing to measure; by default no column may be NaN."""
        return False

    def start(self, simulation: Simulation) -> None:
        self.columns = [*FIRST, *self.prepare(simulation)]
        earlier, path, ranks = self.rows, self.path, simulation.ranks
        if not earlier and simulation.number > 0 and path is not None:
            earlier = ranks.on_first(lambda: read_series(path, self.columns))
        number = simulation.number
        self.rows = [row for row in earlier if row[0] <= number and self._was_due(simulation, row)]
        self._found = number, [row for row in earlier if row[0] == number]
        if path is not None:
            ranks.on_first(lambda: write_atomically(path, csv_text([self.columns, *self.rows]).encode()))
        if self.initial and not self._has(number) and simulation.is_due(self.every):
            self._note(simulation)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        if simulation.is_due(self.every):
            self._note(simulation)

    def finish(self, simulation: Simulation) -> None:
        if not self.columns or self._has(simulation.number):
            return
        number, rows = self._found
        if number == simulation.number and not self.initial:  # without a new step the last step's rows stay
            self._add(rows, simulation)
        elif self.initial or simulation.number > 0:
            self._note(simulation)

    def _was_due(self, simulation: Simulation, row: list[float]) -> bool:
        number, ended = simulation.stepper.step_of(row[1], int(row[0]))
        return ended and number % self.every == 0

    def _has(self, number: int) -> bool:
        return bool(self.rows) and self.rows[-1][0] == number

    def _note(self, simulation: Simulation) -> None:
        time = [simulation.number, simulation.t]
        rows = [[*time, *(float(value) + 0.0 for value in row)] for row in self._sample(simulation)]
        for row in rows:
            for column, value in zip(self.columns, row, strict=True):
                if not math.isfinite(value) and not (math.isnan(value) and self.may_be_nan(column)):
                    sentence = f"{type(self).__name__}: {self._said(column, row)} is {value}"
                    raise NotANumberError(f"{sentence} at t = {simulation.t:g} s; expected a number")
        self._add(rows, simulation)

    def _said(self, column: str, row: list[float]) -> str:
        """The name of a row's column in messages."""
        return repr(column)

    def _add(self, rows: list[list[float]], simulation: Simulation) -> None:
        self.rows += rows
        if (path := self.path) is not None:
            simulation.ranks.on_first(lambda: append(path, csv_text(rows)))


def read_series(path: Path, columns: Sequence[str]) -> list[list[float]]:
    """The rows of a table that an earlier part of the run wrote; empty if there is no file.

    Raises CheckpointError if the table has other columns or is damaged.
    """
    if not path.exists():
        return []
    table = read_columns(path)
    if list(table) != list(columns):
        message = f"{path}: the table has other columns than this run writes; move the file away to go on"
        raise CheckpointError(message)
    return [[int(row[0]), *row[1:]] for row in np.transpose(list(table.values())).tolist()]


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """The columns of a table by name; raises CheckpointError if the file is no table."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            head, *body = csv.reader(file)
        return dict(zip(head, np.array(body, dtype=float).reshape(len(body), len(head)).T, strict=True))
    except (ValueError, csv.Error) as error:
        message = f"{path}: this is not a table of numbers ({error}); move the file away to go on"
        raise CheckpointError(message) from error

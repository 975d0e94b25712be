"""Measured data: columns of numbers over time, from a CSV file or arrays."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError, as_number
from ngvisco.run.files import AnyPath

TIME, INTEGRAL = "time", "integral of "
"""Name of the column of times, and prefix of the names of integrals over time."""
_HEAD = re.compile(r"\s*(?P<name>[^\[\]]*[^\[\]\s])\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")


class DataError(NgviscoError, ValueError):
    """A table of measured data is invalid, or does not fit the run."""


@dataclass(frozen=True)
class Data:
    """Measured columns over time.

    Attributes
    ----------
    times : array, (rows,)
        Times in the unit that ``units`` has for ``"time"``, or in s.
    columns : mapping of names to arrays, (rows,)
        Values in the units that ``units`` has for the names, or in SI units; NaN if not measured.
    units : mapping of names to units
    """

    times: np.ndarray
    columns: dict[str, np.ndarray]
    units: dict[str, str]

    @classmethod
    def of(cls, data: AnyPath | Mapping[str, Any]) -> Data:
        """The data of a CSV file, or of arrays by name with the times as ``"time"``.

        A file's first line has the names of the columns, with units in brackets if not SI:
        ``time [s],tip.velocity_2 [mm/s]``.  An empty cell is a value that was not measured.  Raises DataError
        for an invalid table, or one without rows, times or values.
        """
        if isinstance(data, Mapping):
            return _checked("data", {str(name): _column(name, values) for name, values in data.items()}, {})
        path = Path(data)
        try:
            with path.open(newline="", encoding="utf-8-sig") as file:
                rows = [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
        except (UnicodeDecodeError, csv.Error) as error:
            raise DataError(f"{path}: this is not a CSV file ({error})") from error
        if len(rows) < 2:
            raise DataError(f"{path}: the file has no rows of data below the names of the columns")
        names, units = _head(path, rows[0])
        values = np.array([_numbers(path, i, row, names) for i, row in enumerate(rows[1:], 2)])
        return _checked(str(path), dict(zip(names, values.T, strict=True)), units)


def _head(path: Path, cells: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    names, units = [], {}
    for cell in cells:
        head = _HEAD.fullmatch(cell)
        if head is None or number_in(cell) is not None:
            message = f"{path}: {cell!r:.60} is not the name of a column, with or without a unit in brackets"
            raise DataError(message)
        names.append(head["name"])
        if head["unit"] is not None:
            units[head["name"]] = head["unit"].strip()
    return names, units


def number_in(cell: str) -> float | None:
    """The finite number in a text; None for other texts."""
    try:
        return as_number(float(cell))
    except ValueError:
        return None


def _numbers(path: Path, line: int, row: Sequence[str], names: Sequence[str]) -> list[float]:
    if len(row) != len(names):
        counts = f"the number of values is {len(row)}, but the number of columns is {len(names)}"
        raise DataError(f"{path}, row {line}: {counts}")
    numbers = []
    for name, cell in zip(names, row, strict=True):
        number = number_in(cell)
        if number is None and cell.strip():
            raise DataError(f"{path}, row {line}: {name} = {cell!r:.40}; expected a finite number")
        numbers.append(np.nan if number is None else number)
    return numbers


def _column(name: Any, values: Any) -> np.ndarray:
    try:
        column = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"data[{name!r}]: expected a sequence of numbers") from error
    if column.ndim != 1 or np.isinf(column).any():
        message = f"data[{name!r}]: expected a sequence of finite numbers, with NaN for missing numbers"
        raise DataError(message)
    return column


def _checked(where: str, columns: dict[str, np.ndarray], units: dict[str, str]) -> Data:
    times = columns.pop(TIME, None)
    if times is None:
        raise DataError(f"{where}: there is no column {TIME!r}, in s")
    columns.pop("step", None)  # a column of tables written by runs
    if not columns:
        raise DataError(f"{where}: there is no column besides {TIME!r}")
    if not len(times) or any(len(column) != len(times) for column in columns.values()):
        message = f"{where}: expected at least one time, and in each column as many values as there are times"
        raise DataError(message)
    if not (np.isfinite(times) & (times >= 0)).all():
        raise DataError(f"{where}: expected times >= 0 in every row")
    for name, values in columns.items():
        if np.isnan(values).all():
            raise DataError(f"{where}: {name} has no values")
    return Data(times, columns, units)


def converted(data: Data, units: Mapping[str, str | None], factor: Any = None) -> Data:
    """The data in the SI units ``units`` of the columns.

    A column with the unit None is not converted.  ``factor(unit, wanted)`` returns the size of ``unit`` in
    the unit ``wanted``.  Without ``factor`` the data have to be in SI units.  Raises DataError for a wrong
    unit.
    """
    scales = {}
    for name, unit in data.units.items():
        right = "s" if name == TIME else units.get(name)
        if right is None or unit == right:
            continue
        try:
            if factor is None:
                raise ValueError(f"expected {right}; the command ngvisco fit converts units")
            scales[name] = factor(unit, right)
        except ValueError as error:
            raise DataError(f"unit of the column {name}, {unit!r}: {error}") from error
    columns = {name: values * scales.get(name, 1.0) for name, values in data.columns.items()}
    return Data(data.times * scales.get(TIME, 1.0), columns, {})

"""Tables of time in case files: ``{ file = "load.csv" }`` in place of a number, read with the case.

A case that was read has the numbers themselves, so that its run's directory needs no further file.
"""

from pathlib import Path
from typing import Any

from ngvisco.case.faults import Fault, Locator
from ngvisco.errors import ParameterError
from ngvisco.physics.signals import read_table

_KEYS = {"file", "column"}
_SECTIONS = ("loads", "walls")


def with_tables(
    data: dict[str, Any], directory: Path, locator: Locator
) -> tuple[dict[str, Any], list[Fault]]:
    """A case's data with the files' numbers in loads and walls, and the faults of the files."""
    faults: list[Fault] = []

    def read(value: Any, path: tuple[str, ...]) -> Any:
        if isinstance(value, list):
            return [read(part, (*path, str(i))) for i, part in enumerate(value)]
        if not isinstance(value, dict):
            return value
        if "file" not in value or not set(value) <= _KEYS:
            return {name: read(part, (*path, name)) for name, part in value.items()}
        try:
            return _numbers(value, directory)
        except ParameterError as error:
            faults.append(
                locator.fault(path, f"{error.field}: {error.value!r:.60}: expected {error.expected}")
            )
            return value

    return data | {name: read(data[name], (name,)) for name in _SECTIONS if name in data}, faults


def _numbers(value: dict[str, Any], directory: Path) -> dict[str, Any]:
    """Times and values of a file; of its values' columns the one with the number ``column``, from 1 on."""
    file, column = value["file"], value.get("column")
    if not isinstance(file, str):
        raise ParameterError("file", file, "the path of a CSV file, relative to the case file")
    rows = read_table(directory / file)
    if column is None:
        values = rows[:, 1] if rows.shape[1] == 2 else rows[:, 1:]
    elif isinstance(column, int) and not isinstance(column, bool) and 1 <= column < rows.shape[1]:
        values = rows[:, column]
    else:
        raise ParameterError("column", column, f"a whole number from 1 to {rows.shape[1] - 1}")
    return {"times": rows[:, 0].tolist(), "values": values.tolist()}

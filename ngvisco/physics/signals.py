"""Functions of the run's time for loads and walls: steps, pulses, tables.

The means of these functions over a step are exact, because the rule in time (``ngvisco.forms.time_means``)
knows where these functions break.  In any other function the rule looks for an ``IfPos`` whose argument
changes sign within the step.
"""

import csv
import re
import warnings
from collections.abc import Iterator, Sequence
from os import PathLike, fspath

import numpy as np
from ngsolve import CF, BSpline, CoefficientFunction, IfPos, Parameter
from ngsolve.meshes import MakeStructured2DMesh

from ngvisco.errors import Declared, InputWarning, ParameterError, require_file

time = Parameter(0.0)
"""Time in seconds, for functions that depend on it; its value is the end of the last step."""

_PLACES = (0.1, 0.35, 0.6, 0.9)
_NUMBER = re.compile(r"[+-]?\.?\d|[+-]?(nan|inf)", re.IGNORECASE)
"""Pattern of the beginning of a number."""
_TIME = re.compile(r"(t|tau|time|τ)(?![a-z])", re.IGNORECASE)
"""Pattern of the beginning of a name of a column of times."""
_UNIT, _LETTERS = re.compile(r"[\[(]([^\])]+)[\])]"), re.compile(r"[^\W\d_]+|%")
_SI = frozenset(["s", "m", "kg", "Pa", "K", "N", "W", "J", "rad"])
"""Units that the name of a column may have. Plain numbers are in products and powers of these units."""


def reads_time(function: CoefficientFunction) -> bool:
    """Whether a function changes with the run's time; NGSolve's other parameters count as numbers."""
    if not may_read_time(function):
        return False
    present, samples = time.Get(), []
    try:
        for t in (present, present + 0.37, 2 * present + 1.9):
            time.Set(t)
            samples.append(sampled(function))
    finally:
        time.Set(present)
    return not all(one_value(list(values)) for values in zip(*samples, strict=True))


def sampled(function: CoefficientFunction) -> list[float]:
    """The values at places in cells of two sizes; [inf, nan] if the function cannot be evaluated."""
    values = []
    for cells in (1, 3):
        mesh = MakeStructured2DMesh(quads=False, nx=cells, ny=cells)
        try:
            values += [function(mesh(place, 0.5 * place)) for place in _PLACES]
        except Exception:  # NGSolve raises various errors for functions that no mesh can evaluate
            return [np.inf, np.nan]
    return values


def one_value(values: list[float]) -> bool:
    """Whether values are equal up to rounding."""
    return bool(np.allclose(values, values[0], rtol=1e-12, atol=0.0, equal_nan=True))


_CHOICE = "IfPosCoefficientFunction"
_knots: dict[bytes, np.ndarray] = {}


def step(at: float) -> CoefficientFunction:
    """A function of time that is 0 before the time ``at`` (s) and 1 from then on.

    Raises ParameterError if ``at`` is not a finite number.
    """
    return IfPos(Declared("", (float,)).taken("step.at", at) - time, 0.0, 1.0)


def pulse(begin: float, duration: float) -> CoefficientFunction:
    """A function of time that is 1 from ``begin`` (s) for ``duration`` (s), else 0.

    Raises ParameterError if ``begin`` is not a finite number, or ``duration`` not a positive number.
    """
    start = Declared("", (float,)).taken("pulse.begin", begin)
    length = Declared("> 0", (float,)).taken("pulse.duration", duration)
    return step(start) - step(start + length)


def table(
    source: str | PathLike[str] | Sequence[float], values: Sequence[float] | Sequence[Sequence[float]] = ()
) -> CoefficientFunction:
    """A function of time from a table: linear between rows, constant before the first and after the last row.

    Raises ParameterError if the file cannot be read, a number is not finite, or times do not increase.

    Parameters
    ----------
    source : path or sequence of float
        A CSV file of numbers, with at most one line of names before them, comments after #, and the time (s)
        in the first column; or the times, s.
    values : sequence of float, or of rows of float
        With times as ``source``: one value for each time, or a row of values.

    Returns
    -------
    CoefficientFunction
        A scalar for one column of values, a vector for several.
    """
    if isinstance(source, (str, PathLike)):
        rows = read_table(source)
    else:
        rows = _checked("table", _rows_from(source, values))
    times, columns = rows[:, 0], rows[:, 1:]
    _knots[times.tobytes()] = times.copy()
    knots = [times[0], *times, times[-1]]
    begin, end = float(times[0]), float(times[-1])
    within = IfPos(time - begin, IfPos(end - time, time, end), begin)
    # a spline vanishes from its last knot on
    parts = [
        IfPos(end - time, BSpline(2, knots, [float(v) for v in column])(within), float(column[-1]))
        for column in columns.T
    ]
    return parts[0] if len(parts) == 1 else CF(tuple(parts))


def read_table(path: str | PathLike[str]) -> np.ndarray:
    """The rows of a CSV file for ``table``, (rows, 1 + values); raises ParameterError."""
    return _checked(f"table {fspath(path)!r}", number_rows("table", path))


def breaking(function: CoefficientFunction) -> tuple[list[CoefficientFunction], list[np.ndarray]]:
    """Places where a function of time may have kinks or jumps: arguments of its ``IfPos``, and times, s.

    The times are those of all tables of this process, also of tables that the function does not read, because
    additional times do no harm to the rule of a mean.
    """
    return list(_choices(function)), list(_knots.values()) if "bspline" in str(function) else []


def _choices(function: CoefficientFunction) -> Iterator[CoefficientFunction]:
    text = str(function)
    if _CHOICE not in text or not may_read_time(function):
        return
    children = [child for child in function.data["childs"] if child is not None]
    if _CHOICE in text.split("\n", 1)[0] and may_read_time(children[0]):
        yield children[0]
    for child in children:
        yield from _choices(child)


def may_read_time(function: CoefficientFunction) -> bool:
    """Whether a function contains a parameter of NGSolve, such as the run's time."""
    text = str(function)
    return "ParameterCoefficientFunction" in text or "ParameterCF" in text  # an expression such as 2*t


def _checked(name: str, rows: np.ndarray) -> np.ndarray:
    if len(rows) < 2 or rows.shape[1] < 2:
        expected = "at least two rows of two numbers"
        raise ParameterError(name, f"{len(rows)} rows of {rows.shape[1]} numbers", expected)
    if not np.isfinite(rows).all():
        raise ParameterError(name, "a number that is not finite", "finite numbers")
    times = rows[:, 0]
    if (late := np.flatnonzero(np.diff(times) <= 0)).size:
        instants = f"a row at {times[late[0] + 1]:g} s after the row at {times[late[0]]:g} s"
        raise ParameterError(f"{name}, times", instants, "times that increase from row to row")
    return rows


def _rows_from(times: Sequence[float], values: Sequence[float] | Sequence[Sequence[float]]) -> np.ndarray:
    try:
        first, rows = np.array(times, dtype=float), np.array(values, dtype=float)
    except (TypeError, ValueError):
        expected = "times, and one value or one row of values for each time"
        raise ParameterError("table", (times, values), expected) from None
    if first.ndim != 1 or rows.ndim not in (1, 2) or len(first) != len(rows):
        shapes = f"{first.shape} times, values of shape {rows.shape}"
        raise ParameterError("table", shapes, "times, and one value or one row of values for each time")
    return np.column_stack([first, rows])


def number_rows(field: str, source: str | PathLike[str], timed: int = 0) -> np.ndarray:
    """The rows of numbers in a CSV file, (rows, columns). Comments after # and a line of names are left out.

    Semicolons separate the numbers if the file has any, else commas.  No name begins like a number.  Raises
    ParameterError for the parameter ``field``, also if the names contradict that the column ``timed``
    (counted from 0) has times.  Units in names are not read; a unit other than an SI unit causes a warning.
    """
    path = fspath(require_file(field, source))
    try:
        with open(path, encoding="utf-8-sig") as file:
            texts = [(n, line.partition("#")[0].strip()) for n, line in enumerate(file, 1)]
        mark = ";" if any(";" in text for _, text in texts) else ","
        lines = [(n, text, *csv.reader([text], delimiter=mark)) for n, text in texts if text]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ParameterError(field, path, f"a CSV file that can be read ({error})") from None
    rows: list[list[float]] = []
    for number, text, parts in lines:
        if number == lines[0][0] and not any(_NUMBER.match(part.strip()) for part in parts):
            times = [i for i, name in enumerate(parts) if _TIME.match(name.strip())]
            if times and timed not in times:
                raise ParameterError(field, text, f"the times in column {timed + 1} of {path!r}")
            units = [unit for unit in _UNIT.findall(text) if not _SI.issuperset(_LETTERS.findall(unit))]
            if units:
                message = f"the unit {units[0]!r} of a column is not read; numbers are in SI units"
                warnings.warn(f"{path}: {message}, or in [units] of a case file", InputWarning, 4)
            continue
        try:
            rows.append([float(part) for part in parts])
        except ValueError:
            expected = f"numbers like 0.5 with {mark!r} between them in line {number} of {path!r}"
            raise ParameterError(field, text, expected) from None
        if len(parts) != len(lines[0][2]):
            count = f"{len(parts)} numbers"
            expected = f"{len(lines[0][2])} numbers in line {number} of {path!r}, as in the lines before"
            raise ParameterError(field, count, expected)
    return np.array(rows).reshape(len(rows), -1 if rows else 0)

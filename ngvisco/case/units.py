"""Units of a case file, which pint converts to SI units before validation.

A number may have its own unit, and ``[units]`` has the units of plain numbers (``CASES.md``).
"""

import ast
import math
import re
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ngvisco.case.laws import EnergyText
from ngvisco.case.schema import Units
from ngvisco.case.section import Section, given, models_in, quantity, reached, shown, values_of
from ngvisco.case.values import NUMBERS, PLAIN, ValueKind, Wrong, is_table
from ngvisco.errors import ParameterError
from ngvisco.expressions import ExpressionError, parse, parse_region
from ngvisco.physics.materials import read_prony
from ngvisco.physics.signals import read_table

SI: dict[str, str] = {name: field.default for name, field in Units.model_fields.items()}
"""SI units of the quantities that ``[units]`` may name."""

_NUMBER = r"([+-]?\d{1,2}(?:\.\d{1,9})?)"
_POWER = re.compile(rf"(?:\*\*|\^)\s*(?:{_NUMBER}|\(\s*{_NUMBER}\s*(?:/\s*\d{{1,2}}\s*)?\))(?![\w.])")
_CHAIN = re.compile(r"(?:\*\*|\^)[^*^/()A-Za-z]*(?:\*\*|\^)|\d\s*(?:\*\*|\^)")
_LARGEST_POWER = 100.0
"""Bound on the product of a unit's exponents, because pint computes with whole numbers of any length."""

_QUANTITY = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*((?:(?<=\s)1\s*/\s*)?[A-Za-zµμ°Å].{0,80})\s*"
)


class UnitError(ValueError):
    """The error of an unknown unit or a wrong dimension; ``key`` is the faulty key, None for the key whose
    value is being converted."""

    def __init__(self, message: str, key: str | None = None) -> None:
        self.key = key
        super().__init__(message)


@cache
def _registry() -> Any:
    import pint  # the import takes a third of a second, and most cases do not need it

    return pint.UnitRegistry(cache_folder=None)


def factor(unit: str, si_unit: str) -> float:
    """The value of one ``unit`` in ``si_unit`` (SI).  Raises UnitError, also for an offset as in degC."""
    value = converted(1.0, unit, si_unit)
    if not 0 < value < math.inf or converted(0.0, unit, si_unit) != 0.0:
        raise UnitError(f"{unit!r} cannot be converted to {si_unit}")
    return value


def converted(number: float, unit: str, si_unit: str) -> float:
    """A ``number`` in ``unit``, converted to the SI unit ``si_unit``.  Raises UnitError."""
    import pint

    _require_small_powers(unit)
    units = _registry()
    try:
        value = units.Quantity(number, units.parse_units(unit)).to(units.parse_units(si_unit)).magnitude
    except pint.DimensionalityError as error:
        raise UnitError(f"{unit!r} does not have the dimension of {si_unit}") from error
    except Exception as error:  # pint's parser raises many kinds of errors
        raise UnitError(f"{unit!r} is not a known unit") from error
    return float(value)


def has_unit(value: object) -> bool:
    """Whether a value of a case file is a text with a number and its unit."""
    return isinstance(value, str) and not _is(parse, value) and _QUANTITY.fullmatch(value) is not None


def _require_small_powers(unit: str) -> None:
    """Raise UnitError for powers of numbers, powers of powers, and exponents that are too large."""
    powers = [match[1] or match[2] for match in _POWER.finditer(unit)]
    are_plain = len(powers) == len(re.findall(r"\*\*|\^", unit)) and not _CHAIN.search(unit)
    if not are_plain or math.prod(max(abs(float(power)), 1.0) for power in powers) > _LARGEST_POWER:
        raise UnitError(
            f"{unit!r:.60} is not a unit: a power has a unit as base, and a small number such as 2, -1, "
            "0.5 or (1/2) as exponent"
        )


class Converter:
    """Converts the numbers of sections, also numbers from files, to SI units before validation.

    Paths, which are relative to the case file, become absolute.

    Attributes
    ----------
    faults : list of (key path, message)
        Faults in the table ``[units]``.
    converted : list of (key, value)
        Keys and written values of converted numbers.
    """

    def __init__(self, chosen: Any, directory: Path = Path()) -> None:
        """``chosen`` is the value of ``[units]``, also a wrong value that is no table; relative paths start
        at ``directory``."""
        self._directory = directory
        self.faults: list[tuple[tuple[str, ...], str]] = []
        self.converted: list[tuple[str, Any]] = []
        self.scales: dict[str, float] = {}
        for name, unit in chosen.items() if isinstance(chosen, dict) else ():
            if name in SI and isinstance(unit, str) and unit != SI[name]:
                try:
                    self.scales[name] = factor(unit, SI[name])
                except UnitError as error:
                    self.faults.append((("units", name), f"{error}; expected a unit such as {SI[name]}"))

    def __call__(self, model: type[Section], data: dict[str, Any]) -> dict[str, Any]:
        """The data of a section with numbers in SI units; nested tables are converted separately."""
        result = dict(data)
        for name, value in data.items():
            if name not in model.model_fields:
                continue
            if name == "path" and isinstance(value, str):
                result[name] = str((self._directory / value).resolve())
                continue
            try:
                kind = values_of(model).get(name, PLAIN)
                in_si = self._entry(self._of_files(value, kind), model, name, data)
            except ParameterError as error:
                result[name] = Wrong(f"{shown(error.value)}: expected {error.expected}")
                continue
            except UnitError as error:
                key = error.key or name  # the fault may be in an exponent of the unit
                if key == name or not isinstance(data.get(key), (list, dict)):  # the schema refuses these
                    result[key] = Wrong(f"{shown(data[key]) if key in data else 'is missing'}: {error}")
                continue
            if in_si is not value and in_si != value:
                self.converted.append((name, value))
                result[name] = in_si
        return result

    def number(self, text: str, unit: str) -> float:
        """Convert a text to a number in the SI unit ``unit``.

        The text is a number in the case's units, or a number with a unit.

        Raises UnitError.
        """
        try:
            return float(self._value(float(text), unit, False))
        except ValueError:
            in_si = self._value(text, unit, False)
        if isinstance(in_si, str):
            raise UnitError(f"{text!r:.60} is neither a number nor a number with a unit")
        return float(in_si)

    def _entry(self, value: Any, model: type[Section], name: str, data: dict[str, Any]) -> Any:
        annotation, unit = model.model_fields[name].annotation, quantity(model, name).unit
        if models_in(annotation):  # a body's place may be a text
            is_region = isinstance(value, str) and _is(parse_region, value)
            return self._in_si_places(value) if is_region else value
        if annotation is EnergyText:
            # variables of an energy are numbers without units, so that one factor converts the energy; with
            # per = "mass" the factor is 1, since [units] has no unit for J/kg
            scale = 1.0 if data.get("per") == "mass" else self._scale(unit)
            return value if scale == 1.0 or not isinstance(value, str) else f"({value})*{scale!r}"
        is_function = values_of(model).get(name, NUMBERS) is not NUMBERS
        if unit in ("", "any") or (unit == "1" and not is_function):
            return value
        return self._value(value, _with_exponents(unit, model, data), is_function)

    def _of_files(self, value: Any, kind: ValueKind) -> Any:
        """A value in which tables of time, ``{ file = "load.csv" }``, are replaced by their numbers."""
        if kind.is_field and isinstance(value, list):
            return [self._of_files(part, kind) for part in value]
        if not isinstance(value, dict) or "file" not in value or not set(value) <= {"file", "column"}:
            return value
        if kind.is_field:
            return _numbers_of(self._directory, **value)
        is_rows = kind is NUMBERS and isinstance(value["file"], str) and len(value) == 1
        return read_prony(self._directory / value["file"]).tolist() if is_rows else value

    def _in_si_places(self, text: str) -> str:
        """An expression rewritten for x, y, z in m and t in s."""
        length, time = self.scales.get("length", 1.0), self.scales.get("time", 1.0)
        if length == time == 1.0:
            return text
        return ast.unparse(_Scaled(length, time).visit(ast.parse(" ".join(text.split()), mode="eval")))

    def _value(self, value: Any, unit: str, is_function: bool) -> Any:
        scale = self._scale(unit)
        if isinstance(value, list):
            return [self._value(part, unit, is_function) for part in value]
        if is_table(value):
            times = self._value(value["times"], SI["time"], False)
            return {"times": times, "values": self._value(value["values"], unit, False)}
        if isinstance(value, dict):
            return {name: self._value(part, unit, is_function) for name, part in value.items()}
        if isinstance(value, str) and is_function and _is(parse, value):
            inner = self._in_si_places(value)
            return inner if scale == 1.0 else f"{scale!r}*({inner})"
        if isinstance(value, str) and (match := _QUANTITY.fullmatch(value)):
            if unit == "1":
                raise UnitError("a pure number is expected, without a unit")
            return converted(float(match[1]), match[2].strip(), unit)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return value  # the schema refuses the value
        return value if scale == 1.0 else value * scale

    def _scale(self, unit: str) -> float:
        kind = next((kind for kind, si in SI.items() if si == unit), None)
        return 1.0 if kind is None else self.scales.get(kind, 1.0)


def _is(parsed: Callable[[str], object], text: str) -> bool:
    """Whether ``parsed`` accepts a text."""
    try:
        parsed(text)
    except ExpressionError:
        return False
    return True


class _Scaled(ast.NodeTransformer):
    """Rewrites an expression in the case's units for coordinates and time in SI units."""

    def __init__(self, length: float, time: float) -> None:
        self._scales = {"x": length, "y": length, "z": length, "t": time}

    def visit_Name(self, node: ast.Name) -> ast.AST:
        scale = self._scales.get(node.id, 1.0)
        return node if scale == 1.0 else ast.BinOp(node, ast.Div(), ast.Constant(scale))


def key_and_unit_of(
    name: str, sections: Section, numbers: Mapping[str, float] | None = None
) -> tuple[str, str]:
    """The key of a case for a parameter of a run, and the SI unit of the key's number.

    ``name`` is a name of ``sensitivity.parameters``; it may also begin with a key of ``[rheology]``, and
    contain the name of a body in place of its index. The unit is empty for pure numbers and for names that
    are no key. If a number of the case is an exponent in the unit, as for a power law, the exponent is taken
    from ``numbers``, by the number's key, or else from the case.
    """
    at_front = name.partition(".")[0] in type(sections.rheology).model_fields  # type: ignore[attr-defined]
    names = (f"rheology.{name}" if at_front else name).split(".")
    key = next(iter(reached(sections, (), names)), ())
    if len(key) != len(names):
        return name, ""
    # a component of a vector has the unit of the vector, so that the key of the vector is tried, too
    places = ((given(sections, key[:length]), key[length]) for length in reversed(range(len(key))))
    table, last = next((table, last) for table, last in places if isinstance(table, Section))
    whole = ".".join(key)
    beside, data = whole.removesuffix(last), table.model_dump()
    data |= {other: number for other in data if (number := (numbers or {}).get(beside + other)) is not None}
    unit = _with_exponents(quantity(type(table), last).unit, type(table), data)
    return whole, "" if unit in ("1", "any") else unit


def _with_exponents(unit: str, model: type[Section], data: dict[str, Any]) -> str:
    """The unit with the values of the section's keys in place of exponents that name these keys."""

    def exponent(match: re.Match[str]) -> str:
        name = match[2]
        value = data.get(name, model.model_fields[name].default)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise UnitError("expected a number", name)
        return f"^({match[1] or ''}{value!r})"

    return re.sub(r"\^\(?(\d-)?([a-z]+)\b\)?", exponent, unit)


def _numbers_of(directory: Path, file: Any, column: Any = None) -> dict[str, Any]:
    """Times and values of a CSV file; ``column`` chooses one column of values, counted from 1."""
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

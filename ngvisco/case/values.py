"""Kinds of values in case files: functions of place and time, moduli, regions, arrays.

A ``ValueKind`` annotates a key's type with a check, a description in words, and a JSON Schema.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import cache
from typing import Any

from ngsolve import CF, CoefficientFunction
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from ngvisco.case.laws import parse_law
from ngvisco.errors import ParameterError, as_number
from ngvisco.expressions import parse, parse_region
from ngvisco.physics.signals import table
from ngvisco.shapes.shape import Union, Where


@dataclass(frozen=True, eq=False)
class ValueKind:
    """A kind of values.

    Attributes
    ----------
    words : str
        The kind in words, for the reference of the keys.
    check : callable
        Returns the value, or raises ValueError if it is not of this kind.
    made : callable
        Makes the object that a value describes; returns the value if the object needs more than the value.
    is_field : bool
        Whether the value is a number, or a function of place and time, or a table of functions by name.
    json : dict
        The JSON Schema.
    """

    words: str
    check: Callable[[Any], Any]
    json: dict[str, Any]
    _: KW_ONLY
    made: Callable[[Any], Any] = lambda value: value
    is_field: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return dict(self.json)


def is_table(value: Any) -> bool:
    """Whether a value is a table of times and values; numbers have replaced the name of a file."""
    return isinstance(value, dict) and set(value) == {"times", "values"}


def _number(value: Any, alternative: str = "an expression in quotes") -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"expected a number, or {alternative}")
    if as_number(value) is None:
        raise ValueError("expected a finite number")
    return value


def _scalar(value: Any) -> Any:
    if is_table(value):
        if table(value["times"], value["values"]).dim != 1:
            raise ValueError(
                "expected one column of values; choose a column of the file by its number, as in column = 1"
            )
        return value
    if not isinstance(value, str):
        return _number(value)
    parse(value)
    return value


def _vector(value: Any) -> Any:
    """Check an array of components, each of which may be a table of times, or one table for all of them."""
    if is_table(value):
        table(value["times"], value["values"])
        return value
    if not isinstance(value, list) or not value or any(isinstance(part, list) for part in value):
        raise ValueError('expected an array of components, as in [0, "-1 + x"]')
    for part in value:
        _scalar(part)
    return value


def _rows(value: Any) -> Any:
    rows = value if isinstance(value, list) else []
    if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3, 3]:
        raise ValueError("expected three rows of three, as in [[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    for part in (part for row in rows for part in row):
        _scalar(part)
    return value


def _numbers(value: Any) -> Any:
    if not isinstance(value, list):
        raise ValueError("expected an array, as in [1, 1]")
    for part in value:
        if isinstance(part, list):
            _numbers(part)
        elif as_number(part) is None:
            raise ValueError(f"expected an array of finite numbers, but the entry {part!r:.30} is none")
    return value


def _modulus(value: Any) -> Any:
    if not isinstance(value, str):
        return float(_number(value, "an expression of x, y, z in quotes"))
    names = parse(value).names
    if "t" in names or not names:
        raise ValueError("expected a number, or an expression of the initial place (x, y, z)")
    return value


def _law(value: Any) -> Any:
    if isinstance(value, str):
        parse_law(value)
        return value
    return _numbers(value) if isinstance(value, list) else _number(value)


def _region(value: Any) -> Any:
    if "t" in parse_region(value).names:
        message = "expected a condition that reads only x, y and z, since bodies are placed only at the start"
        raise ValueError(message)
    return value


def shape_of(value: Any) -> Any:
    """The shape that a condition describes; a shape as it is; several shapes as their union."""
    if value == []:
        raise ParameterError("Body.where", value, "at least one shape")
    if isinstance(value, list):
        return Union(value)
    return Where(parse_region(value).coefficient()) if isinstance(value, str) else value


def as_function(value: Any) -> CoefficientFunction:
    """The coefficient function of a field's value; an array of arrays is a 3x3 matrix."""
    if isinstance(value, dict):
        return table(value["times"], value["values"])
    if not isinstance(value, list):
        return _of_text(value) if isinstance(value, str) else CF(float(value))
    rows = [part if isinstance(part, list) else [part] for part in value]
    dims = {"dims": (3, 3)} if isinstance(value[0], list) else {}
    return CF(tuple(as_function(part) for row in rows for part in row), **dims)


@cache
def _of_text(text: str) -> CoefficientFunction:
    """The coefficient function of a text, made once: laws with equal texts share one parameter."""
    return parse(text).coefficient()


def _field(words: str, check: Callable[[Any], Any], json: dict[str, Any]) -> ValueKind:
    def made(value: Any) -> Any:
        if isinstance(value, dict) and not is_table(value):
            return {name: as_function(part) for name, part in value.items()}
        return value if isinstance(value, (int, float)) else as_function(value)

    return ValueKind(words, check, json, made=made, is_field=True)


_EXPRESSION = "number or expression"
_TEXT, _ARRAY = {"type": ["number", "string"]}, {"type": ["number", "string", "array"]}
SCALAR = _field(_EXPRESSION, _scalar, {"type": ["number", "string", "object"]})
_COMPONENTS = {"type": ["array", "object"], "items": {"type": ["number", "string", "object"]}}
VECTOR = _field("array of numbers or expressions", _vector, _COMPONENTS)
ROWS = _field("three rows of three numbers or expressions", _rows, {"type": "array"})
TENSOR = _field(
    "number, expression, or three rows of three numbers or expressions",
    lambda value: (_rows if isinstance(value, list) else _scalar)(value),
    _ARRAY,
)
NUMBERS = ValueKind("array of numbers", _numbers, {"type": "array", "items": {}})
"""Arrays of finite numbers, or of such arrays."""
MODULUS = ValueKind(
    _EXPRESSION, _modulus, _TEXT, made=lambda v: parse(v).coefficient() if isinstance(v, str) else v
)
"""A modulus: a number, or a function of the initial place, which the matter then carries."""
LAW = ValueKind(
    "number, expression of theta, or three rows of three numbers",
    _law,
    _ARRAY,
    made=lambda value: parse_law(value) if isinstance(value, str) else value,
)
"""A function of the temperature theta, K."""
REGION = ValueKind("condition", _region, {"type": "string"}, made=shape_of)
"""A condition on x, y, z."""
PLAIN = ValueKind("", lambda value: value, {})
"""Numbers, texts and tables from which no object is made."""


class Wrong(str):
    """The message about a value with a wrong unit. The message stands in the data in place of the value, and
    no key accepts such a message as its value."""

"""Kinds of values in case files: functions of place and time, moduli, regions, arrays.

Each kind is a class with a check, a description in words, and a JSON Schema.
"""

from abc import ABC, abstractmethod
from functools import cache
from typing import Any, ClassVar

from ngsolve import CF, CoefficientFunction
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from ngvisco.case.laws import parse_law
from ngvisco.errors import ParameterError, as_number
from ngvisco.expressions import parse, parse_region
from ngvisco.physics.signals import table
from ngvisco.shapes.shape import Union, Where


class Value(ABC):
    """Base of the kinds of values."""

    words: ClassVar[str]
    json: ClassVar[dict[str, Any]]

    @staticmethod
    @abstractmethod
    def check(value: Any) -> Any:
        """The value; raises ValueError if it is not of this kind."""

    @classmethod
    def made(cls, value: Any) -> Any:
        """Make the object of a value, if it needs nothing but the value; else return the value."""
        return value

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(cls.check)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return dict(cls.json)


def is_table(value: Any) -> bool:
    """Whether a value is a table of time, with numbers in place of the name of a file."""
    return isinstance(value, dict) and set(value) == {"times", "values"}


def _checked_number(value: Any, alternative: str = "an expression in quotes") -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"expected a number, or {alternative}")
    if as_number(value) is None:
        raise ValueError("expected a finite number")
    return value


class FieldValue(Value):
    """A number, or a function of place and time, or a table of functions by name."""

    @classmethod
    def made(cls, value: Any) -> Any:
        if isinstance(value, dict) and not is_table(value):
            return {name: as_function(part) for name, part in value.items()}
        return value if isinstance(value, (int, float)) else as_function(value)


class ScalarValue(FieldValue):
    """A scalar field."""

    words, json = "number or expression", {"type": ["number", "string"]}

    @staticmethod
    def check(value: Any) -> Any:
        if not isinstance(value, str):
            return _checked_number(value)
        parse(value)
        return value


class VectorValue(FieldValue):
    """A vector field: an array of components, each possibly a table of time, or one table of time for all."""

    words = "array of numbers or expressions"
    json: ClassVar = {"type": ["array", "object"], "items": {"type": ["number", "string", "object"]}}

    @staticmethod
    def check(value: Any) -> Any:
        parts = [value] if is_table(value) else value
        if not isinstance(parts, list) or not parts or any(isinstance(part, list) for part in parts):
            raise ValueError('expected an array of its components, as in [0, "-1 + x"]')
        for part in parts:
            if is_table(part):
                table(part["times"], part["values"])
            else:
                ScalarValue.check(part)
        return value


class RowsValue(FieldValue):
    """A tensor field."""

    words, json = "three rows of three numbers or expressions", {"type": "array"}

    @staticmethod
    def check(value: Any) -> Any:
        rows = value if isinstance(value, list) else []
        if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3, 3]:
            raise ValueError("expected three rows of three, as in [[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
        for part in (part for row in rows for part in row):
            ScalarValue.check(part)
        return value


class TensorValue(FieldValue):
    """A scalar or tensor field."""

    words = "number, expression, or three rows of three numbers or expressions"
    json: ClassVar = {"type": ["number", "string", "array"]}

    @staticmethod
    def check(value: Any) -> Any:
        return (RowsValue if isinstance(value, list) else ScalarValue).check(value)


class NumberValues(Value):
    """Arrays of finite numbers, or of such arrays."""

    words, json = "array of numbers", {"type": "array", "items": {}}

    @staticmethod
    def check(value: Any) -> Any:
        if not isinstance(value, list):
            raise ValueError("expected an array, as in [1, 1]")
        for part in value:
            if isinstance(part, list):
                NumberValues.check(part)
            elif as_number(part) is None:
                raise ValueError(
                    f"expected an array of finite numbers, or of such arrays, not of {part!r:.30}"
                )
        return value


class ModulusValue(Value):
    """A modulus: a number, or a function of the initial place, which the matter then carries."""

    words, json = ScalarValue.words, ScalarValue.json

    @staticmethod
    def check(value: Any) -> Any:
        if not isinstance(value, str):
            return float(_checked_number(value, "an expression of x, y, z in quotes"))
        names = parse(value).names
        if "t" in names or not names:
            raise ValueError("expected a number, or a function of the initial place, of x, y and z alone")
        return value

    @classmethod
    def made(cls, value: Any) -> Any:
        return parse(value).coefficient() if isinstance(value, str) else value


class LawValue(Value):
    """A function of the temperature theta, K."""

    words = "number, expression of theta, or three rows of three numbers"
    json = TensorValue.json

    @staticmethod
    def check(value: Any) -> Any:
        if isinstance(value, str):
            parse_law(value)
            return value
        return NumberValues.check(value) if isinstance(value, list) else _checked_number(value)

    @classmethod
    def made(cls, value: Any) -> Any:
        return parse_law(value) if isinstance(value, str) else value


class RegionText(Value):
    """A condition on x, y, z."""

    words, json = "condition", {"type": "string"}

    @staticmethod
    def check(value: Any) -> Any:
        if "t" in parse_region(value).names:
            raise ValueError("expected a condition on x, y and z alone: it says where a body is at the start")
        return value

    @classmethod
    def made(cls, value: Any) -> Any:
        """The shape of a condition, the shape itself, or the union of several shapes."""
        if value == []:
            raise ParameterError("Body.where", value, "at least one shape")
        if isinstance(value, list):
            return Union(value)
        return Where(parse_region(value).coefficient()) if isinstance(value, str) else value


class Wrong(str):
    """The message about a value with a wrong unit. It replaces the value in the data, and every key refuses
    it."""


def as_function(value: Any) -> Any:
    """The coefficient function of a ``FieldValue``; arrays of rows are 3x3 matrices."""
    if not isinstance(value, list):
        return _scalar(value)
    if isinstance(value[0], list):
        return CF(tuple(_scalar(part) for row in value for part in row), dims=(3, 3))
    return CF(tuple(_scalar(part) for part in value))


def _scalar(value: Any) -> CoefficientFunction:
    if isinstance(value, dict):
        return table(value["times"], value["values"])
    return _of_text(value) if isinstance(value, str) else CF(float(value))


@cache
def _of_text(text: str) -> CoefficientFunction:
    """The coefficient function of a text, made once: laws with equal texts share one parameter."""
    return parse(text).coefficient()

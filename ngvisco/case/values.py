"""Values of case files that are more than a number: functions of place and time, moduli, regions, arrays."""

from __future__ import annotations

from typing import Annotated, Any

from ngsolve import CF, CoefficientFunction
from pydantic import AfterValidator, WithJsonSchema

from ngvisco.errors import ParameterError, as_number
from ngvisco.expressions import parse, parse_region


def _check_field(value: Any) -> Any:
    """A number, an expression, or an array (of arrays) of them; raises ValueError."""
    if isinstance(value, list):
        if not value:
            raise ValueError("expected a number, an expression or an array of them, not an empty array")
        for part in value:
            _check_field(part)
    elif isinstance(value, str):
        parse(value)
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("expected a number, an expression in quotes, or an array of them")
    elif as_number(value) is None:
        raise ValueError("expected a finite number")
    return value


FieldValue = Annotated[
    Any, AfterValidator(_check_field), WithJsonSchema({"type": ["number", "string", "array"]})
]
"""A scalar, vector or tensor field as it stands in a case file."""


def _check_numbers(value: list[Any]) -> list[Any]:
    """Arrays of arrays of finite numbers; raises ValueError."""
    for part in value:
        if isinstance(part, list):
            _check_numbers(part)
        elif as_number(part) is None:
            raise ValueError(f"expected an array of finite numbers, or of such arrays, not of {part!r:.30}")
    return value


NumberValues = Annotated[list[Any], AfterValidator(_check_numbers)]
"""Numbers in arrays of arrays."""


def _check_modulus(value: Any) -> Any:
    """A finite number, or an expression of x, y, z; raises ValueError."""
    if isinstance(value, str):
        names = parse(value).names
        if "t" in names or not names:
            raise ValueError("expected a number, or a function of the initial place, of x, y and z alone")
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("expected a number, or an expression of x, y, z in quotes")
    try:
        return float(value)
    except OverflowError:
        raise ValueError("expected a finite number") from None


ModulusValue = Annotated[Any, AfterValidator(_check_modulus), WithJsonSchema({"type": ["number", "string"]})]
"""A modulus: a number, or a function of the initial place, which then travels with the matter."""


def _check_region(value: str) -> str:
    if "t" in parse_region(value).names:
        raise ValueError("expected a condition on x, y and z alone: it says where a body is at the start")
    return value


RegionText = Annotated[str, AfterValidator(_check_region)]
"""A condition on x, y, z."""


def as_function(value: Any) -> Any:
    """A number, text or array as a coefficient function; arrays of arrays are matrices."""
    if not isinstance(value, list):
        return _scalar(value)
    if not all(isinstance(row, list) for row in value):
        if any(isinstance(row, list) for row in value):
            raise ParameterError("array", value, "a vector, or a matrix of equally long rows")
        return CF(tuple(_scalar(part) for part in value))
    widths = {len(row) for row in value}
    if len(widths) != 1 or any(isinstance(part, list) for row in value for part in row):
        raise ParameterError("array", value, "a matrix of equally long rows")
    flat = tuple(_scalar(part) for row in value for part in row)
    return CF(flat, dims=(len(value), widths.pop()))


def _scalar(value: Any) -> CoefficientFunction:
    return parse(value).coefficient() if isinstance(value, str) else CF(float(value))

"""Values of case files that are more than a number: functions of place and time, moduli, regions, arrays."""

from functools import cache
from typing import Annotated, Any

from ngsolve import CF, CoefficientFunction
from pydantic import AfterValidator, WithJsonSchema

from ngvisco.case.energies import parse_law
from ngvisco.errors import as_number
from ngvisco.expressions import parse, parse_region
from ngvisco.physics.signals import table


def is_table(value: Any) -> bool:
    """Whether a value is a table of time, which a case that was read has in place of its file."""
    return isinstance(value, dict) and set(value) == {"times", "values"}


def _check_scalar(value: Any) -> Any:
    """A number or an expression; raises ValueError."""
    if isinstance(value, str):
        parse(value)
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("expected a number, or an expression in quotes")
    elif as_number(value) is None:
        raise ValueError("expected a finite number")
    return value


def _check_vector(value: Any) -> Any:
    """An array of numbers, expressions and tables of time, or one such table; raises ValueError."""
    if is_table(value):
        table(value["times"], value["values"])
        return value
    if not isinstance(value, list) or not value or any(isinstance(part, list) for part in value):
        raise ValueError('expected an array of its components, as in [0, "-1 + x"]')
    for part in value:
        if is_table(part):
            table(part["times"], part["values"])
        else:
            _check_scalar(part)
    return value


def _check_tensor(value: Any) -> Any:
    """A number or an expression, or three rows of three of them; raises ValueError."""
    return _check_rows(value) if isinstance(value, list) else _check_scalar(value)


def _check_rows(value: Any) -> Any:
    """Three rows of three numbers or expressions; raises ValueError."""
    rows = value if isinstance(value, list) else []
    if [len(row) if isinstance(row, list) else 0 for row in rows] != [3, 3, 3]:
        raise ValueError("expected three rows of three, as in [[1, 0, 0], [0, 1, 0], [0, 0, 1]]")
    for row in rows:
        for part in row:
            _check_scalar(part)
    return value


ScalarValue = Annotated[Any, AfterValidator(_check_scalar), WithJsonSchema({"type": ["number", "string"]})]
"""A scalar field as it stands in a case file."""
VectorValue = Annotated[
    Any,
    AfterValidator(_check_vector),
    WithJsonSchema({"type": ["array", "object"], "items": {"type": ["number", "string", "object"]}}),
]
"""A vector field; an object is a table of time."""
TensorValue = Annotated[
    Any, AfterValidator(_check_tensor), WithJsonSchema({"type": ["number", "string", "array"]})
]
"""A tensor field, or a variable, which may be a scalar."""
RowsValue = Annotated[Any, AfterValidator(_check_rows), WithJsonSchema({"type": "array"})]
"""A tensor field."""
FIELDS = (ScalarValue, VectorValue, TensorValue, RowsValue)


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
    if as_number(value) is None:
        raise ValueError("expected a finite number")
    return float(value)


ModulusValue = Annotated[Any, AfterValidator(_check_modulus), WithJsonSchema({"type": ["number", "string"]})]
"""A modulus: a number, or a function of the initial place, which then travels with the matter."""


def _check_region(value: str) -> str:
    if "t" in parse_region(value).names:
        raise ValueError("expected a condition on x, y and z alone: it says where a body is at the start")
    return value


RegionText = Annotated[str, AfterValidator(_check_region)]
"""A condition on x, y, z."""


def _check_law(value: Any) -> Any:
    """A number, three rows of three, or an expression of theta; raises ValueError."""
    if isinstance(value, str):
        parse_law(value)
        return value
    return _check_numbers(value) if isinstance(value, list) else _check_scalar(value)


LawValue = Annotated[Any, AfterValidator(_check_law), WithJsonSchema({"type": ["number", "string", "array"]})]
"""A function of the temperature theta, K."""


def as_function(value: Any) -> Any:
    """A number, text or array as a coefficient function; arrays of rows are 3x3 matrices."""
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
    """One function for one text: what laws read by it is then carried once."""
    return parse(text).coefficient()

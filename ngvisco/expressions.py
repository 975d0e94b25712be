"""Expressions of x, y, z and t in texts, as NGSolve coefficient functions.

A text is parsed to Python's syntax tree and only the nodes listed here are evaluated, by this module
and never by Python: a case file, or an integrand of ``Integrals``, cannot execute code.  Written are

* numbers, ``x y z`` (m), ``t`` (s, the run's time ``ngvisco.time``), ``pi``;
* ``+ - * / **``, parentheses, unary ``+ -``;
* ``sin cos tan asin acos atan exp log sqrt abs sinh cosh tanh min max atan2``;
* ``a if condition else b`` (or ``where(condition, a, b)``), conditions being comparisons
  ``< <= > >=`` (also chained) joined by ``and``, ``or``, ``not``.

A region (``parse_region``) is written as a condition, ``"(x - 0.6)**2 + y**2 < 0.04 and y < 0.6"``; without
a comparison, ``"x - 0.5"``, it is none, and is refused.

Constant parts are computed at once, so that ``1/0`` or ``log(-1)`` is an error with its position.
"""

import ast
import difflib
import math
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import ngsolve
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import NgviscoError, listed
from ngvisco.physics.signals import time
from ngvisco.physics.tensors import exp, if_positive, log, sqrt

Value: TypeAlias = float | CoefficientFunction

MAX_LENGTH = 2000
MAX_DEPTH = 80
MAX_NODES = 1000
MAX_OPERATIONS = 5000
"""Of a text when all is written out that is used several times, as the base of a whole power."""
_LARGEST_WHOLE_POWER = 16

COORDINATES = ("x", "y", "z")
CONSTANTS = {"pi": math.pi}
_SYMBOLS: dict[str, Value] = {"x": ngsolve.x, "y": ngsolve.y, "z": ngsolve.z, "t": time, **CONSTANTS}
NAMES = tuple(_SYMBOLS)


class ExpressionError(NgviscoError, ValueError):
    """A text that is no expression; ``position`` is the index of the offending character."""

    def __init__(self, text: str, position: int, reason: str) -> None:
        self.text, self.position, self.reason = text, position, reason
        shown = text if len(text) <= 80 else text[:77] + "..."
        super().__init__(f"{reason}, at character {position + 1} of {shown!r}")


@dataclass(frozen=True)
class Expression:
    """A checked expression: its text and the names that it reads."""

    text: str
    names: frozenset[str]
    _tree: ast.expr
    is_region: bool = False

    def coefficient(self, fields: Mapping[str, CoefficientFunction] | None = None) -> CoefficientFunction:
        """The expression as a coefficient function; ``t`` is ``ngvisco.time``.

        ``fields`` has the scalars of the further names that ``parse`` was given.
        """
        evaluator = Evaluator(self.text, dict(fields or {}) | _SYMBOLS)
        return CF(evaluator.level(self._tree) if self.is_region else evaluator.value(self._tree))


def parse(text: str, fields: Collection[str] = ()) -> Expression:
    """Check a text completely; ``fields`` are further names that it may read.

    Raises ExpressionError with the position: syntax, unknown name or function, a constant part that is no
    finite number, or one of the limits on length, depth and operations.
    """
    tree, lead = syntax_tree(text)
    # any scalar function stands for a field
    evaluator = Evaluator(text, _SYMBOLS | {name: ngsolve.x for name in fields if name not in NAMES}, lead)
    evaluator.value(tree)
    return Expression(text, frozenset(evaluator.seen), shifted(tree, lead))


def parse_region(text: str) -> Expression:
    """Check the text of a region; its coefficient function is positive inside, and continuous at the edges of
    comparisons: ``a < b`` is b - a, ``and`` the smaller, ``or`` the larger one, ``not`` the negative.

    Raises ExpressionError as ``parse``, and for what is no condition.
    """
    tree, lead = syntax_tree(text)
    evaluator = Evaluator(text, _SYMBOLS, lead)
    evaluator.level(tree)
    return Expression(text, frozenset(evaluator.seen), shifted(tree, lead), is_region=True)


def number(text: str) -> float:
    """The value of a constant expression, such as ``"-5/6"``; raises ExpressionError."""
    tree, lead = syntax_tree(text)
    return float(Evaluator(text, CONSTANTS, lead).value(tree))


def syntax_tree(text: str) -> tuple[ast.expr, int]:
    """A text's tree and the number of blanks before it, which the tree's columns leave out.

    Raises ExpressionError for what is no expression by its syntax or size.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(text, MAX_LENGTH, f"longer than {MAX_LENGTH} characters")
    if not text.isascii() or "\0" in text:
        where = next(i for i, c in enumerate(text) if not c.isascii() or c == "\0")
        raise ExpressionError(text, where, f"unexpected character {text[where]!r}")
    # leading blanks would be an indentation; line breaks may stand in a TOML string
    source = "".join(" " if c in "\t\r\n\f\v" else c for c in text)
    lead = len(source) - len(source.lstrip())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of doubtful literals, which the evaluator judges itself
            tree = ast.parse(source.lstrip(), mode="eval").body
    except SyntaxError as error:
        position = lead + max(0, (error.offset or 1) - 1)
        raise ExpressionError(text, min(position, len(text)), "not an expression") from None
    except (ValueError, MemoryError, RecursionError):  # absurd nesting or number
        raise ExpressionError(text, 0, "too deeply nested") from None
    _check_size(text, tree, lead)
    if (count := _operations(tree)) > MAX_OPERATIONS:
        reason = f"too long: written out it has {count:.0e} operations, at most {MAX_OPERATIONS} are taken"
        raise ExpressionError(text, lead, reason)
    return tree, lead


def shifted(tree: ast.expr, lead: int) -> ast.expr:
    """The tree with columns that count from the text's first character."""
    for node in ast.walk(tree):
        if hasattr(node, "col_offset"):
            node.col_offset += lead
    return tree


def _check_size(text: str, tree: ast.expr, lead: int) -> None:
    count, layer, depth = 0, [tree], 0
    while layer:
        count, depth = count + len(layer), depth + 1
        if count > MAX_NODES or depth > MAX_DEPTH:
            position = lead + getattr(layer[0], "col_offset", 0)
            raise ExpressionError(text, position, "too long or too deeply nested")
        layer = [child for node in layer for child in ast.iter_child_nodes(node)]  # type: ignore[misc]


def _operations(node: ast.AST) -> float:
    """How many operations a tree has when every use of a part is written out; of numbers alone none."""
    if isinstance(node, ast.Name):
        return 1
    inner = sum(_operations(child) for child in ast.iter_child_nodes(node))
    uses = 1
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        inner -= 1  # the function's name
        uses = _USES.get(node.func.id, 1)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        uses = _factors(node.right)
    return inner * uses + (inner > 0)


def _factors(exponent: ast.expr) -> int:
    """How many factors a power is written out to, at most."""
    try:
        value = abs(Evaluator("", CONSTANTS).value(exponent))
    except ExpressionError:  # a parameter of an energy, or nothing that can be taken
        return _LARGEST_WHOLE_POWER
    return int(value) if value.is_integer() and 1 < value <= _LARGEST_WHOLE_POWER else 1


_USES = {
    "abs": 2,
    "tanh": 3,
    "min": 2,
    "max": 2,
    "cof": 4,
    "inv": 6,
    "det": 2,
    "dev": 2,
    "sym": 2,
    "norm2": 2,
}
"""How often the value of a function has its arguments in it, at least."""


class Evaluator:
    """Evaluates a tree with floats where it is constant, and coefficient functions elsewhere.

    Attributes
    ----------
    seen : set of str
        The names that were read.
    """

    allowed = "only numbers, names, + - * / ** and the listed functions are allowed"

    def __init__(self, text: str, symbols: Mapping[str, Any], lead: int = 0) -> None:
        self.text, self.symbols, self.lead = text, symbols, lead
        self.seen: set[str] = set()

    @property
    def functions(self) -> Mapping[str, tuple[Any, ...]]:
        """What can be called: the number of arguments first, then what computes the value."""
        return FUNCTIONS

    def value(self, node: ast.expr) -> Any:
        """The value of a node; raises ExpressionError."""
        if isinstance(node, ast.Constant):
            return self._number(node)
        if isinstance(node, ast.Name):
            return self._name(node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
            operand = self.value(node.operand)
            return operand if isinstance(node.op, ast.UAdd) else -operand
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        if isinstance(node, ast.IfExp):
            return self._choice(node, node.test, node.body, node.orelse)
        if isinstance(node, (ast.Compare, ast.BoolOp)) or (
            isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
        ):
            raise self._error(node, "a condition may only stand in 'a if condition else b'")
        raise self._error(node, self.allowed)

    def _error(self, node: ast.AST, reason: str) -> ExpressionError:
        return ExpressionError(self.text, self.lead + getattr(node, "col_offset", 0), reason)

    def _number(self, node: ast.Constant) -> float:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._error(node, f"{value!r:.40} is not a number")
        return self._finite(node, lambda: float(value))

    def _finite(self, node: ast.AST, compute: Callable[[], float]) -> float:
        try:
            result = compute()
        except (ValueError, ArithmeticError) as error:
            raise self._error(node, f"no finite number ({error})") from None
        if isinstance(result, complex) or not math.isfinite(result):
            raise self._error(node, "no finite number")
        return result

    def _name(self, node: ast.Name) -> Any:
        name = node.id
        if name not in self.symbols:
            if name in self.functions:
                raise self._error(node, f"function {name!r} needs its arguments in parentheses")
            hint, known = _hint(name, self.symbols), listed(self.symbols)
            raise self._error(node, f"unknown name {name!r}{hint} (known: {known})")
        self.seen.add(name)
        return self.symbols[name]

    def _binary(self, node: ast.BinOp) -> Any:
        operation = _BINARY.get(type(node.op))
        if operation is None:
            raise self._error(node, "the operators are + - * / **")
        a, b = self.value(node.left), self.value(node.right)
        return self._combined(node, operation, a, b)

    def _combined(self, node: ast.BinOp, operation: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
        if isinstance(a, float) and isinstance(b, float):
            return self._finite(node, lambda: operation(a, b))
        if isinstance(node.op, ast.Div) and b == 0.0 and isinstance(b, float):
            raise self._error(node, "division by zero")
        return operation(a, b)

    def _call(self, node: ast.Call) -> Any:
        if not isinstance(node.func, ast.Name):
            raise self._error(node, "only the listed functions can be called")
        name = node.func.id
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._error(node, f"{name} takes plain arguments only")
        if name == "where":
            if len(node.args) != 3:
                raise self._error(node, f"where takes 3 arguments, not {len(node.args)}")
            return self._choice(node, *node.args)
        if name not in self.functions:
            known = ", ".join([*self.functions, "where"])
            hint = _hint(name, [*self.functions, "where"])
            raise self._error(node, f"unknown function {name!r}{hint} (known: {known})")
        count = self.functions[name][0]
        if len(node.args) != count:
            plural = "" if count == 1 else "s"
            raise self._error(node, f"{name} takes {count} argument{plural}, not {len(node.args)}")
        return self._applied(node, name, [self.value(argument) for argument in node.args])

    def _applied(self, node: ast.Call, name: str, arguments: list[Any]) -> Any:
        _, exact, general = self.functions[name]
        if all(isinstance(argument, float) for argument in arguments):
            return self._finite(node, lambda: exact(*arguments))
        return general(*arguments)

    def _choice(self, node: ast.AST, test: ast.expr, yes: ast.expr, no: ast.expr) -> Any:
        condition, a, b = self._condition(test), self.value(yes), self.value(no)
        self._check_choice(node, a, b)
        if isinstance(condition, float):
            return a if condition > 0 else b
        return if_positive(condition, a, b)

    def _check_choice(self, node: ast.AST, a: Any, b: Any) -> None:
        """Raise ExpressionError where a value cannot be one or the other."""

    def _condition(self, node: ast.expr) -> Any:
        """A number or function that is 1 where the condition holds and 0 elsewhere."""
        if isinstance(node, ast.BoolOp):
            parts = [self._condition(value) for value in node.values]
            if isinstance(node.op, ast.And):
                return math.prod(parts[1:], start=parts[0])
            return 1.0 - math.prod((1.0 - part for part in parts[1:]), start=1.0 - parts[0])
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return 1.0 - self._condition(node.operand)
        if not isinstance(node, ast.Compare):
            raise self._error(node, "expected a condition such as x < 0.5")
        values = [self._scalar(part) for part in (node.left, *node.comparators)]
        for operator in node.ops:
            if type(operator) not in _COMPARE:
                raise self._error(node, "the comparisons are < <= > >=")
        pairs = zip(node.ops, values, values[1:], strict=False)
        parts = [_COMPARE[type(operator)](a, b) for operator, a, b in pairs]
        return math.prod(parts[1:], start=parts[0])

    def level(self, node: ast.expr) -> Any:
        """Of a condition a value that is positive where it holds; raises ExpressionError for what is none."""
        if isinstance(node, ast.BoolOp):
            parts = [self.level(value) for value in node.values]
            return _extremum(parts, "min" if isinstance(node.op, ast.And) else "max")
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return -self.level(node.operand)
        self._condition(node)  # which checks it, and refuses what is no comparison
        assert isinstance(node, ast.Compare)
        values = [self._scalar(part) for part in (node.left, *node.comparators)]
        pairs = zip(node.ops, values, values[1:], strict=False)
        is_less = (ast.Lt, ast.LtE)
        return _extremum([b - a if isinstance(op, is_less) else a - b for op, a, b in pairs], "min")

    def _scalar(self, node: ast.expr) -> Any:
        """The value of a node that has to be a scalar."""
        return self.value(node)


def _power(a: Value, b: Value) -> Value:
    is_array = not isinstance(a, (float, CoefficientFunction))  # which has powers of its own
    if is_array or (isinstance(a, float) and isinstance(b, float)):
        return a**b
    if isinstance(b, float) and b.is_integer() and abs(b) <= _LARGEST_WHOLE_POWER:
        # repeated multiplication: exact signs for negative bases, which exp(b log a) has not
        product = math.prod([a] * int(abs(b)), start=CF(1.0))
        return product if b >= 0 else 1 / product
    return CF(a) ** CF(b)


def _less(a: Value, b: Value) -> Value:
    """1 where a < b, 0 elsewhere."""
    if isinstance(a, float) and isinstance(b, float):
        return 1.0 if a < b else 0.0
    return if_positive(b - a, 1.0, 0.0)


_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: _less,
    ast.Gt: lambda a, b: _less(b, a),
    ast.LtE: lambda a, b: 1.0 - _less(b, a),
    ast.GtE: lambda a, b: 1.0 - _less(a, b),
}

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: _power,
}


def _tanh(a: Any) -> Any:
    # of the exponential that does not overflow
    return if_positive(a, 1 - 2 / (exp(2 * a) + 1), 2 / (exp(-2 * a) + 1) - 1)


def _of_exponentials(a: Any, sign: float) -> Any:
    """sinh (sign -1) or cosh (sign 1), of arrays too."""
    if isinstance(a, CoefficientFunction):
        return ngsolve.sinh(a) if sign < 0 else ngsolve.cosh(a)
    return 0.5 * (exp(a) + sign * exp(-a))


FUNCTIONS: dict[str, tuple[int, Callable[..., float], Callable[..., Any]]] = {
    "sin": (1, math.sin, ngsolve.sin),
    "cos": (1, math.cos, ngsolve.cos),
    "tan": (1, math.tan, ngsolve.tan),
    "asin": (1, math.asin, ngsolve.asin),
    "acos": (1, math.acos, ngsolve.acos),
    "atan": (1, math.atan, ngsolve.atan),
    "atan2": (2, math.atan2, lambda a, b: ngsolve.atan2(CF(a), CF(b))),
    "exp": (1, math.exp, exp),
    "log": (1, math.log, log),
    "sqrt": (1, math.sqrt, sqrt),
    "abs": (1, abs, lambda a: if_positive(a, a, -a)),
    "sinh": (1, math.sinh, lambda a: _of_exponentials(a, -1.0)),
    "cosh": (1, math.cosh, lambda a: _of_exponentials(a, 1.0)),
    "tanh": (1, math.tanh, _tanh),
    "min": (2, min, lambda a, b: if_positive(a - b, b, a)),
    "max": (2, max, lambda a, b: if_positive(a - b, a, b)),
}
"""Name -> count of arguments, the function of numbers, that of coefficient functions."""


def _extremum(values: list[Any], name: str) -> Any:
    """The smallest or the largest of some values."""
    _, exact, general = FUNCTIONS[name]
    result = values[0]
    for value in values[1:]:
        is_constant = isinstance(result, float) and isinstance(value, float)
        result = exact(result, value) if is_constant else general(result, value)
    return result


def _hint(name: str, known: Any) -> str:
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""

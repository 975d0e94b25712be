"""Expressions of x, y, z and t in texts, as NGSolve coefficient functions.

A text is parsed to Python's syntax tree, and this module evaluates only the nodes listed here.  Python does
not evaluate the text, so that a case file or an integrand of ``Integrals`` cannot execute code.  Allowed are

* numbers, ``x y z`` (m), ``t`` (s, the run's time ``ngvisco.time``), ``pi``;
* ``+ - * / **``, parentheses, unary ``+ -``;
* ``sin cos tan asin acos atan exp log sqrt abs sinh cosh tanh min max atan2``;
* ``a if condition else b`` (or ``where(condition, a, b)``), with conditions that are comparisons
  ``< <= > >=`` (also chained) joined by ``and``, ``or``, ``not``.

An energy in a case file (``ngvisco.case.laws``) contains scalars, 3x3 tensors, and functions of both.

A region (``parse_region``) is a condition, ``"(x - 0.6)**2 + y**2 < 0.04 and y < 0.6"``; a text without a
comparison, ``"x - 0.5"``, is refused.

Constant parts are evaluated at once, so that ``1/0`` or ``log(-1)`` is an error with its position.
"""

import ast
import math
import operator
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

import ngsolve
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import NgviscoError, listed, nearest
from ngvisco.physics.signals import time
from ngvisco.physics.tensors import cof, det, dev, exp, if_positive, inner, log, sph, sqrt, square, sym, tr

Evaluated: TypeAlias = float | CoefficientFunction

MAX_LENGTH = 2000
MAX_DEPTH = 80
MAX_NODES = 1000
MAX_OPERATIONS = 5000
"""Largest number of operations of a text after expanding repeated parts, such as the base of an integer
power."""
_LARGEST_WHOLE_POWER = 16

CONSTANTS = {"pi": math.pi}
_SYMBOLS: dict[str, Evaluated] = {"x": ngsolve.x, "y": ngsolve.y, "z": ngsolve.z, "t": time, **CONSTANTS}
NAMES = tuple(_SYMBOLS)


class ExpressionError(NgviscoError, ValueError):
    """A text is no expression; ``position`` is the index of the offending character."""

    def __init__(self, text: str, position: int, reason: str) -> None:
        self.text, self.position, self.reason = text, position, reason
        shown = text if len(text) <= 80 else text[:77] + "..."
        super().__init__(f"{reason}, at character {position + 1} of {shown!r}")


@dataclass(frozen=True)
class Expression:
    """A checked expression: its text, and the names in it."""

    text: str
    names: frozenset[str]
    _tree: ast.expr
    is_region: bool = False

    def coefficient(self, fields: Mapping[str, CoefficientFunction] | None = None) -> CoefficientFunction:
        """The expression as a coefficient function; ``t`` is ``ngvisco.time``.

        ``fields`` maps the further names given to ``parse`` to scalar functions.
        """
        evaluator = Evaluator(self.text, dict(fields or {}) | _SYMBOLS)
        return CF(evaluator.level(self._tree) if self.is_region else evaluator.value(self._tree))


def parse(text: str, fields: Collection[str] = ()) -> Expression:
    """Check a text completely; ``fields`` are further names that it may contain.

    Raises ExpressionError with the position for a syntax error, an unknown name or function, a constant part
    that is no finite number, or an exceeded limit on length, depth or operations.
    """
    # x replaces each field here, because any scalar function suffices for the check
    evaluator = Evaluator(text, _SYMBOLS | {name: ngsolve.x for name in fields if name not in NAMES})
    tree = syntax_tree(text)
    evaluator.value(tree)
    return Expression(text, frozenset(evaluator.seen), tree)


def parse_region(text: str) -> Expression:
    """Check the text of a region.  Its coefficient function is positive inside the region.

    The function is continuous across the region's surface: ``a < b`` stands for b - a, ``and`` for the
    minimum, ``or`` for the maximum, and ``not`` for the negative.

    Raises ExpressionError as ``parse``, and for a text that is no condition.
    """
    evaluator, tree = Evaluator(text, _SYMBOLS), syntax_tree(text)
    evaluator.level(tree)
    return Expression(text, frozenset(evaluator.seen), tree, is_region=True)


def number(text: str) -> float:
    """Value of a constant expression, such as ``"-5/6"``; raises ExpressionError."""
    return float(Evaluator(text, CONSTANTS).value(syntax_tree(text)))


def syntax_tree(text: str) -> ast.expr:
    """Syntax tree of a text; raises ExpressionError if its syntax or size is not allowed."""
    if len(text) > MAX_LENGTH:
        raise ExpressionError(text, MAX_LENGTH, f"the text is longer than {MAX_LENGTH} characters")
    if not text.isascii() or "\0" in text:
        where = next(i for i, c in enumerate(text) if not c.isascii() or c == "\0")
        raise ExpressionError(text, where, f"unexpected character {text[where]!r}")
    # Python takes leading blanks as indentation; a TOML string may contain line breaks
    source = "".join(" " if c in "\t\r\n\f\v" else c for c in text)
    lead = len(source) - len(source.lstrip())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the evaluator itself checks doubtful literals
            tree = ast.parse(source.lstrip(), mode="eval").body
    except SyntaxError as error:
        position = lead + max(0, (error.offset or 1) - 1)
        raise ExpressionError(text, min(position, len(text)), "the text is not an expression") from None
    except (ValueError, MemoryError, RecursionError):  # too deep nesting, or too large a number
        raise ExpressionError(text, 0, "the expression is too deeply nested") from None
    for node in ast.walk(tree):
        if hasattr(node, "col_offset"):
            node.col_offset += lead
    _check_size(text, tree)
    if (count := _operations(tree)) > MAX_OPERATIONS:
        reason = (
            f"the expression has {count:.0e} operations when its powers are written out; "
            f"expected at most {MAX_OPERATIONS}"
        )
        raise ExpressionError(text, lead, reason)
    return tree


def _check_size(text: str, tree: ast.AST) -> None:
    count, layer, depth = 0, [tree], 0
    while layer:
        count, depth = count + len(layer), depth + 1
        if count > MAX_NODES or depth > MAX_DEPTH:
            position = getattr(layer[0], "col_offset", 0)
            raise ExpressionError(text, position, "the expression is too long or too deeply nested")
        layer = [child for node in layer for child in ast.iter_child_nodes(node)]


def _operations(node: ast.AST) -> float:
    """Number of operations of a tree, in which each use of a part counts; 0 for numbers alone."""
    if isinstance(node, ast.Name):
        return 1
    inner = sum(_operations(child) for child in ast.iter_child_nodes(node))
    uses = 1
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        inner -= 1  # the function's name is a child of the call, but no operation
        uses = _USES.get(node.func.id, 1)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        uses = _factors(node.right)
    return inner * uses + (inner > 0)


def _factors(exponent: ast.expr) -> int:
    """Largest number of factors into which a power is expanded."""
    try:
        value = abs(Evaluator("", CONSTANTS).value(exponent))
    except ExpressionError:  # a parameter of an energy, or an invalid exponent
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
"""Least number of times that the formula of a function contains the function's arguments."""


class Evaluator:
    """Evaluates constant parts of a tree as floats, and other parts as coefficient functions.

    If ``of_tensors`` is True, an expression may contain 3x3 tensors, and names may also stand for arrays.

    Attributes
    ----------
    seen : set of str
        Names found in the expression.
    """

    def __init__(self, text: str, symbols: Mapping[str, Any], of_tensors: bool = False) -> None:
        self.text, self.symbols, self.of_tensors = text, symbols, of_tensors
        self.functions = FUNCTIONS_OF_TENSORS if of_tensors else FUNCTIONS
        self.seen: set[str] = set()

    def value(self, node: ast.expr) -> Any:
        """Value of a node; raises ExpressionError."""
        match node:
            case ast.Constant():
                return self._number(node)
            case ast.Name():
                return self._name(node)
            case ast.UnaryOp(op=ast.UAdd()):
                return self.value(node.operand)
            case ast.UnaryOp(op=ast.USub()):
                return -self.value(node.operand)
            case ast.BinOp():
                return self._binary(node)
            case ast.Call():
                return self._call(node)
            case ast.IfExp():
                return self._choice(node, node.test, node.body, node.orelse)
            case ast.Subscript() if self.of_tensors:
                return self._entry(node)
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                raise self._error(node, "a condition may only stand in 'a if condition else b'")
        entries = "entries F[0, 1], " if self.of_tensors else ""
        allowed = f"only numbers, names, {entries}+ - * / ** and the listed functions are allowed"
        raise self._error(node, allowed)

    def _error(self, node: ast.AST, reason: str) -> ExpressionError:
        return ExpressionError(self.text, getattr(node, "col_offset", 0), reason)

    def _number(self, node: ast.Constant) -> float:
        value = node.value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self._error(node, f"{value!r:.40} is not a number")
        return self._finite(node, float, value)

    def _finite(self, node: ast.AST, function: Callable[..., float], *arguments: Any) -> float:
        try:
            result = function(*arguments)
        except (ValueError, ArithmeticError) as error:
            raise self._error(node, f"the value is not finite ({error})") from None
        if isinstance(result, complex) or not math.isfinite(result):
            raise self._error(node, "the value is not finite")
        return result

    def _name(self, node: ast.Name) -> Any:
        name = node.id
        if name not in self.symbols:
            if name in self.functions:
                raise self._error(node, f"function {name!r} needs its arguments in parentheses")
            hint, symbols = nearest(name, self.symbols), listed(self.symbols)
            raise self._error(node, f"unknown name {name!r}{hint} (known: {symbols})")
        self.seen.add(name)
        return self.symbols[name]

    def _entry(self, node: ast.Subscript) -> Any:
        tensor = self.value(node.value)
        if not is_tensor(tensor):
            raise self._error(node, "only tensors have entries")
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        indices = [part.value for part in parts if isinstance(part, ast.Constant)]
        if not len(parts) == 2 == sum(type(i) is int and 0 <= i <= 2 for i in indices):
            raise self._error(node.slice, "an entry has two indices from 0 to 2, as in F[0, 1]")
        return tensor[indices[0], indices[1]]

    def _binary(self, node: ast.BinOp) -> Any:
        kind = type(node.op)
        if kind not in _BINARY:
            raise self._error(node, "only the operators + - * / ** are allowed")
        a, b = self.value(node.left), self.value(node.right)
        if isinstance(a, float) and isinstance(b, float):
            return self._finite(node, _BINARY[kind], a, b)
        if kind in (ast.Add, ast.Sub) and is_tensor(a) != is_tensor(b):
            raise self._error(
                node, "a scalar cannot be added to a tensor; multiply the scalar by the identity I"
            )
        if kind is ast.Div and is_tensor(b):
            raise self._error(
                node, "a divisor cannot be a tensor; multiply by inv(A) in place of a division by A"
            )
        if kind is ast.Div and isinstance(b, float) and b == 0.0:
            raise self._error(node, "division by zero")
        if kind is ast.Pow and (is_tensor(a) or is_tensor(b)):
            raise self._error(node, "only scalars have powers; write the square of a tensor as A*A")
        if kind is ast.Pow and self.of_tensors and not isinstance(b, float):
            raise self._error(
                node, "an exponent has to be a number or a parameter; write any other a**b as exp(b*log(a))"
            )
        return _BINARY[kind](a, b)

    def _call(self, node: ast.Call) -> Any:
        if not isinstance(node.func, ast.Name):
            raise self._error(node, "a function is called by its name alone, as in sqrt(x)")
        name = node.func.id
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self._error(node, f"{name} takes only positional arguments, without keywords and without *")
        functions = [*self.functions, "where"]
        if name not in functions:
            hint = nearest(name, functions)
            raise self._error(node, f"unknown function {name!r}{hint} (known: {', '.join(functions)})")
        count, exact, general = (3, None, None) if name == "where" else self.functions[name]
        if len(node.args) != count:
            plural = "" if count == 1 else "s"
            raise self._error(node, f"{name} takes {count} argument{plural}, not {len(node.args)}")
        if general is None:
            return self._choice(node, *node.args)
        arguments = [self.value(argument) for argument in node.args]
        if any(is_tensor(argument) != (exact is None) for argument in arguments):
            raise self._error(node, f"{name} takes {'tensors' if exact is None else 'scalars'}")
        if exact is not None and all(isinstance(argument, float) for argument in arguments):
            return self._finite(node, exact, *arguments)
        return general(*arguments)

    def _choice(self, node: ast.AST, test: ast.expr, yes: ast.expr, no: ast.expr) -> Any:
        condition, a, b = self._condition(test), self.value(yes), self.value(no)
        if is_tensor(a) != is_tensor(b):
            raise self._error(node, "the two alternatives have to be two scalars or two tensors")
        if isinstance(condition, float):
            return a if condition > 0 else b
        return if_positive(condition, a, b)

    def _compared(self, node: ast.expr) -> list[tuple[type[ast.cmpop], Any, Any]]:
        """Comparisons of a chain, each with its two values; raises ExpressionError for other nodes."""
        if not isinstance(node, ast.Compare):
            raise self._error(node, "expected a condition such as x < 0.5")
        values = []
        for part in (node.left, *node.comparators):
            values.append(self.value(part))
            if is_tensor(values[-1]):
                raise self._error(part, "tensors cannot be compared")
        kinds = [type(kind) for kind in node.ops]
        if not _COMPARE.keys() >= set(kinds):
            raise self._error(node, "only the comparisons < <= > >= are allowed")
        return list(zip(kinds, values[:-1], values[1:], strict=True))

    def _condition(self, node: ast.expr) -> Any:
        """Number or function that is 1 where the condition holds and 0 elsewhere."""
        match node:
            case ast.BoolOp(op=ast.And()):
                return reduce(operator.mul, map(self._condition, node.values))
            case ast.BoolOp():
                return 1.0 - reduce(operator.mul, (1.0 - self._condition(part) for part in node.values))
            case ast.UnaryOp(op=ast.Not()):
                return 1.0 - self._condition(node.operand)
        return reduce(operator.mul, (_COMPARE[kind](a, b) for kind, a, b in self._compared(node)))

    def level(self, node: ast.expr) -> Any:
        """Convert a condition to a value that is positive where the condition holds; raises ExpressionError
        for any other node."""
        match node:
            case ast.BoolOp(op=ast.And()):
                return reduce(_smaller, map(self.level, node.values))
            case ast.BoolOp():
                return -reduce(_smaller, (-self.level(part) for part in node.values))
            case ast.UnaryOp(op=ast.Not()):
                return -self.level(node.operand)
        is_less = (ast.Lt, ast.LtE)
        return reduce(_smaller, (b - a if kind in is_less else a - b for kind, a, b in self._compared(node)))


def is_tensor(value: Any) -> bool:
    """Whether a number, coefficient function or array is a 3x3 tensor."""
    if isinstance(value, CoefficientFunction):
        return len(value.dims) == 2
    return not (isinstance(value, float) or value.is_scalar)


def _power(a: Evaluated, b: Evaluated) -> Evaluated:
    is_array = not isinstance(a, (float, CoefficientFunction))  # arrays have powers of their own
    if is_array or (isinstance(a, float) and isinstance(b, float)):
        return a**b
    if isinstance(b, float) and b.is_integer() and abs(b) <= _LARGEST_WHOLE_POWER:
        # repeated multiplication has exact signs for negative bases, unlike exp(b log a)
        product = math.prod([a] * int(abs(b)), start=CF(1.0))
        return product if b >= 0 else 1 / product
    return CF(a) ** CF(b)


def _less(a: Evaluated, b: Evaluated) -> Evaluated:
    """Indicator that is 1 where a < b, and 0 elsewhere."""
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
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: _power,
}


def _of_exponentials(a: Any, sign: float) -> Any:
    """The function sinh (sign -1) or cosh (sign 1), also for arrays."""
    if isinstance(a, CoefficientFunction):
        return ngsolve.sinh(a) if sign < 0 else ngsolve.cosh(a)
    return 0.5 * (exp(a) + sign * exp(-a))


FUNCTIONS: dict[str, tuple[int, Callable[..., float], Callable[..., Any]]] = {
    **{n: (1, getattr(math, n), getattr(ngsolve, n)) for n in ("sin", "cos", "tan", "asin", "acos", "atan")},
    "atan2": (2, math.atan2, lambda a, b: ngsolve.atan2(CF(a), CF(b))),
    "exp": (1, math.exp, exp),
    "log": (1, math.log, log),
    "sqrt": (1, math.sqrt, sqrt),
    "abs": (1, abs, lambda a: if_positive(a, a, -a)),
    "sinh": (1, math.sinh, lambda a: _of_exponentials(a, -1.0)),
    "cosh": (1, math.cosh, lambda a: _of_exponentials(a, 1.0)),
    # each branch uses the exponential that does not overflow
    "tanh": (1, math.tanh, lambda a: if_positive(a, 1 - 2 / (exp(2 * a) + 1), 2 / (exp(-2 * a) + 1) - 1)),
    "min": (2, min, lambda a, b: if_positive(a - b, b, a)),
    "max": (2, max, lambda a, b: if_positive(a - b, a, b)),
}
"""Number of arguments, function of numbers, and function of coefficient functions, by name."""

FUNCTIONS_OF_TENSORS: dict[str, tuple[int, Callable[..., float] | None, Callable[..., Any]]] = {
    "tr": (1, None, tr),
    "det": (1, None, det),
    "norm2": (1, None, square),
    "dot": (2, None, inner),
    "cof": (1, None, cof),
    "inv": (1, None, lambda A: cof(A).trans / det(A)),
    "trans": (1, None, lambda A: A.trans),
    "sym": (1, None, sym),
    "dev": (1, None, dev),
    "sph": (1, None, sph),
    **{name: FUNCTIONS[name] for name in ["exp", "log", "sqrt", "abs", "sinh", "cosh", "tanh", "min", "max"]},
}
"""Functions in expressions with tensors, as in ``FUNCTIONS``; a function of tensors has None for numbers."""


def _smaller(a: Any, b: Any) -> Any:
    _, exact, general = FUNCTIONS["min"]
    return (exact if isinstance(a, float) and isinstance(b, float) else general)(a, b)

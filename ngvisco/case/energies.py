"""Energies of case files: expressions of the material's variables, for coefficient functions and arrays.

A text is an expression as in ``ngvisco.expressions``, of scalars and 3x3 tensors, and is computed by
this package, never by Python.  Written are

* numbers, the variables' names, the parameters' names, ``pi`` and the identity ``I``; not x, y, z or t;
* entries of a tensor, ``F[0, 1]`` with indices 0, 1, 2;
* ``+ -`` of two scalars or two tensors, ``*`` (of two tensors the matrix product), ``/`` by a scalar, and
  ``**`` of a scalar with a number;
* ``tr det norm2 dot`` (of tensors: norm2(A) is A : A, dot(A, B) is A : B), ``cof inv trans sym dev sph``;
* ``exp log sqrt abs sinh cosh tanh min max`` of scalars, ``a if condition else b`` and ``where``.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.expressions import (
    CONSTANTS,
    FUNCTIONS,
    UNKNOWN,
    Evaluator,
    ExpressionError,
    Unknown,
    shifted,
    syntax_tree,
)
from ngvisco.physics.tensors import (
    IDENTITY,
    cof,
    det,
    dev,
    entry,
    exp,
    if_positive,
    inner,
    log,
    sph,
    sqrt,
    square,
    sym,
    tr,
)
from ngvisco.physics.variables import Variable

UNIT = "I"
RESERVED = (*CONSTANTS, UNIT)
"""Names that a parameter cannot have."""

_TENSOR: Any = Unknown()
"""A tensor while a text is checked; UNKNOWN is a scalar."""


@dataclass(frozen=True)
class EnergyExpression:
    """A checked text as a function of the variables' values: coefficient functions or arrays.

    Attributes
    ----------
    text : str
    parameters : mapping of names to numbers
    """

    text: str
    parameters: Mapping[str, float]
    _tree: ast.expr = field(repr=False, compare=False)

    def __call__(self, **values: Any) -> Any:
        backend = next(iter(values.values()))
        identity = backend.constant(np.eye(3)) if hasattr(backend, "constant") else IDENTITY
        symbols = {**CONSTANTS, UNIT: identity, **self.parameters, **values}
        return _EnergyEvaluator(self.text, symbols).value(self._tree)


def parse_energy(
    text: str, variables: Sequence[Variable], parameters: Mapping[str, float] | None = None
) -> EnergyExpression:
    """Check an energy's text completely.

    Parameters
    ----------
    text : str
    variables : sequence of Variable
        Their names are scalars or tensors by their kinds.
    parameters : mapping of names to numbers, optional

    Raises
    ------
    ExpressionError
        With the position and what is allowed: for syntax, unknown names and functions, scalars in place of
        tensors and the like, constant parts that are no finite numbers, a tensor as the result, and a text
        that reads none of the variables.
    """
    constants = {name: float(value) for name, value in (parameters or {}).items()}
    kinds = {v.name: UNKNOWN if v.kind == "scalar" else _TENSOR for v in variables}
    tree, lead = syntax_tree(text)
    symbols = {**CONSTANTS, UNIT: _TENSOR, **constants, **kinds}
    evaluator = _EnergyEvaluator(text, symbols, lead, [*kinds, *constants, *RESERVED])
    if evaluator.value(tree) is _TENSOR:
        raise ExpressionError(
            text, lead + tree.col_offset, "an energy is a scalar, this is a tensor (tr, det, norm2, dot)"
        )
    if not evaluator.seen & set(kinds):
        raise ExpressionError(
            text, lead + tree.col_offset, f"an energy reads at least one of {', '.join(kinds)}"
        )
    return EnergyExpression(text, constants, shifted(tree, lead))


class _EnergyEvaluator(Evaluator):
    """As ``Evaluator``, of scalars and tensors; each operation is one of ``ngvisco.physics.tensors``."""

    allowed = "only numbers, names, entries F[0, 1], + - * / ** and the listed functions are allowed"

    @property
    def functions(self) -> Mapping[str, tuple[Any, ...]]:
        return _FUNCTIONS

    def value(self, node: ast.expr) -> Any:
        return self._entry(node) if isinstance(node, ast.Subscript) else super().value(node)

    def _entry(self, node: ast.Subscript) -> Any:
        tensor = self.value(node.value)
        if not _is_tensor(tensor):
            raise self._error(node, "only tensors have entries")
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        values = [part.value for part in parts if isinstance(part, ast.Constant)]
        indices = [value for value in values if type(value) is int and 0 <= value <= 2]
        if not len(parts) == len(indices) == 2:
            raise self._error(node.slice, "an entry has two indices from 0 to 2, as in F[0, 1]")
        return UNKNOWN if tensor is _TENSOR else entry(tensor, indices[0], indices[1])

    def _combined(self, node: ast.BinOp, operation: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
        tensors, kind = (_is_tensor(a), _is_tensor(b)), type(node.op)
        if kind in (ast.Add, ast.Sub) and tensors[0] != tensors[1]:
            raise self._error(node, "a scalar and a tensor have no sum (the identity is I)")
        if kind is ast.Div and tensors[1]:
            raise self._error(node, "nothing is divided by a tensor (inv(A) is its inverse)")
        if kind is ast.Pow and any(tensors):
            raise self._error(node, "only scalars have powers (A*A is a product of tensors)")
        if kind is ast.Pow and not isinstance(b, float):
            raise self._error(node, "an exponent is a number or a parameter (a**b is exp(b*log(a)))")
        if isinstance(a, Unknown) or isinstance(b, Unknown):
            if not any(tensors):
                return super()._combined(node, operation, a, b)
            if kind is ast.Div and b == 0.0:
                raise self._error(node, "division by zero")
            return _TENSOR
        if kind is ast.Pow and not isinstance(a, (float, CoefficientFunction)):
            return a**b
        return super()._combined(node, operation, a, b)

    def _applied(self, node: ast.Call, name: str, arguments: list[Any]) -> Any:
        _, takes, exact, general, gives = _FUNCTIONS[name]
        if any(_is_tensor(argument) != (takes == "tensor") for argument in arguments):
            raise self._error(node, f"{name} takes {'tensors' if takes == 'tensor' else 'scalars'}")
        if exact is not None and all(isinstance(argument, float) for argument in arguments):
            return self._finite(node, lambda: exact(*arguments))
        if any(isinstance(argument, Unknown) for argument in arguments):
            return _TENSOR if gives == "tensor" else UNKNOWN
        return general(*arguments)

    def _check_choice(self, node: ast.AST, a: Any, b: Any) -> None:
        if _is_tensor(a) != _is_tensor(b):
            raise self._error(node, "both values are scalars, or both are tensors")

    def _scalar(self, node: ast.expr) -> Any:
        value = self.value(node)
        if _is_tensor(value):
            raise self._error(node, "tensors are not compared")
        return value


def _is_tensor(value: Any) -> bool:
    if isinstance(value, CoefficientFunction):
        return len(value.dims) == 2
    return value is _TENSOR or not (isinstance(value, float) or value is UNKNOWN or value.is_scalar)


def _tanh(a: Any) -> Any:
    # of the exponential that does not overflow
    return if_positive(a, 1 - 2 / (exp(2 * a) + 1), 2 / (exp(-2 * a) + 1) - 1)


_SCALARS: dict[str, Callable[..., Any]] = {
    "exp": exp,
    "log": log,
    "sqrt": sqrt,
    "abs": lambda a: if_positive(a, a, -a),
    "sinh": lambda a: 0.5 * (exp(a) - exp(-a)),
    "cosh": lambda a: 0.5 * (exp(a) + exp(-a)),
    "tanh": _tanh,
    "min": lambda a, b: if_positive(a - b, b, a),
    "max": lambda a, b: if_positive(a - b, a, b),
}

_TENSORS: dict[str, tuple[int, Callable[..., Any], str]] = {
    "tr": (1, tr, "scalar"),
    "det": (1, det, "scalar"),
    "norm2": (1, square, "scalar"),
    "dot": (2, inner, "scalar"),
    "cof": (1, cof, "tensor"),
    "inv": (1, lambda A: cof(A).trans / det(A), "tensor"),
    "trans": (1, lambda A: A.trans, "tensor"),
    "sym": (1, sym, "tensor"),
    "dev": (1, dev, "tensor"),
    "sph": (1, sph, "tensor"),
}

_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    **{name: (count, "tensor", None, f, gives) for name, (count, f, gives) in _TENSORS.items()},
    **{name: (FUNCTIONS[name][0], "scalar", FUNCTIONS[name][1], f, "scalar") for name, f in _SCALARS.items()},
}
"""Name -> number of arguments, what they are, the function of numbers, that of values, what it gives."""

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

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, x

from ngvisco.expressions import CONSTANTS, FUNCTIONS, Evaluator, ExpressionError, shifted, syntax_tree
from ngvisco.physics.materials.thermal import Entropy
from ngvisco.physics.tensors import IDENTITY, cof, det, dev, inner, sph, square, sym, tr
from ngvisco.physics.variables import Variable

UNIT = "I"
TEMPERATURE = "theta"
RESERVED = (*CONSTANTS, UNIT)
"""Names that a parameter cannot have."""

_ANY = {"scalar": x, "symmetric": IDENTITY, "full": IDENTITY}
"""What stands for a variable while a text is checked, by its kind."""


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


def parse_law(text: str) -> Callable[[Any], Any]:
    """Check the text of a law theta -> value; raises ExpressionError as ``parse_energy``."""
    law = parse_energy(text, (Entropy(name=TEMPERATURE),), what="a law of the temperature")
    return lambda theta: law(**{TEMPERATURE: theta})


def parse_energy(
    text: str,
    variables: Sequence[Variable],
    parameters: Mapping[str, float] | None = None,
    what: str = "an energy",
) -> EnergyExpression:
    """Check an energy's text completely.

    Raises ExpressionError with the position and what is allowed: for syntax, unknown names and functions,
    scalars in place of tensors and the like, constant parts that are no finite numbers, a tensor as the
    result, and a text that reads none of the variables.

    Parameters
    ----------
    variables : sequence of Variable
        Their names are scalars or tensors by their kinds.
    parameters : mapping of names to numbers, optional
    what : str
        What errors call it.
    """
    constants = {name: float(value) for name, value in (parameters or {}).items()}
    kinds = {v.name: _ANY[v.kind] for v in variables}
    tree, lead = syntax_tree(text)
    evaluator = _EnergyEvaluator(text, {**kinds, **constants, **CONSTANTS, UNIT: IDENTITY}, lead)
    if _is_tensor(evaluator.value(tree)):
        raise ExpressionError(
            text, lead + tree.col_offset, f"{what} is a scalar, this is a tensor (tr, det, norm2, dot)"
        )
    if not evaluator.seen & set(kinds):
        raise ExpressionError(
            text, lead + tree.col_offset, f"{what} reads at least one of {', '.join(kinds)}"
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
        return tensor[indices[0], indices[1]]

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
        return super()._combined(node, operation, a, b)

    def _applied(self, node: ast.Call, name: str, arguments: list[Any]) -> Any:
        takes = "tensor" if name in _TENSORS else "scalar"
        if any(_is_tensor(argument) != (takes == "tensor") for argument in arguments):
            raise self._error(node, f"{name} takes {takes}s")
        return super()._applied(node, name, arguments)

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
    return not (isinstance(value, float) or value.is_scalar)


_TENSORS: dict[str, tuple[int, None, Callable[..., Any]]] = {
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
}
_SCALARS = ("exp", "log", "sqrt", "abs", "sinh", "cosh", "tanh", "min", "max")
_FUNCTIONS: dict[str, tuple[Any, ...]] = {**_TENSORS, **{name: FUNCTIONS[name] for name in _SCALARS}}

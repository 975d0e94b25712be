"""Values at many points as arrays, with derivatives by reverse differentiation and by complex increments.

``Array`` has the operations of coefficient functions that energies, laws and terms use
(``ngvisco.physics.tensors``).  Each operation acts on all points at once and stores the map that carries
derivatives back to its operands. ``Linear`` stands for a test function: it has no value, and records the
factors that multiply it.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any, Self, TypeAlias

import numpy as np

from ngvisco.physics.point_products import applied, contracted, cross, product, subscripts
from ngvisco.physics.recording import called

TINY = 1e-30
"""Size of the imaginary increment, as a multiple of the direction."""

Map: TypeAlias = Callable[[np.ndarray], np.ndarray]


def slope_along(function: Map, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The derivative of an analytic function of arrays in a direction.

    The derivative is the imaginary part at a tiny complex increment. No difference is taken, so that no
    digits cancel.
    """
    return np.ascontiguousarray(function(at + (TINY * 1j) * direction).imag) / TINY


_number = count(1)


_ONE = np.ones(1)
"""The derivative of a sum by its summands."""


class _Node:
    """The base class of arrays and linear forms: linear maps of entries, and the transposes of the maps.

    The class is not an abstract class of Python, because ``isinstance`` would then take five times as long.
    """

    __slots__ = ()
    __array_ufunc__ = None  # numpy's numbers leave the operation to these classes
    shape: tuple[int, ...]

    _mapped: Callable[[tuple[int, ...], Map, Map], Self]
    """A method that returns the image, of a given shape, under a linear map. Its last argument is the
    transposed map, for derivatives."""

    @property
    def rank(self) -> int:
        """0 for scalars, 1 for vectors, 2 for matrices."""
        return len(self.shape)

    @property
    def is_scalar(self) -> bool:
        return not self.shape

    def __neg__(self) -> Self:
        return self._mapped(self.shape, np.negative, np.negative)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    @property
    def trans(self) -> Self:
        """The transpose."""
        self._require_matrix()
        return self._mapped(self.shape[::-1], _transposed, _transposed)

    def trace(self) -> Self:
        """The trace."""
        self._require_matrix()
        identity = np.eye(self.shape[0])[:, :, None]
        return self._mapped((), lambda a: np.einsum("iip->p", a), lambda g: g * identity)

    def __getitem__(self, index: int | tuple[int, int]) -> Self:
        """The entry A_ij or v_i, a scalar at each point."""
        shape = self.shape
        if len(shape) != (len(index) if isinstance(index, tuple) else 1):
            raise TypeError(f"a tensor of rank {self.rank} has no entry {index}")

        return self._mapped((), lambda a: a[index], lambda g: called(_placed, g, shape, index))

    def mapped(self, matrix: np.ndarray, shape: tuple[int, ...]) -> Self:
        """The tensor of ``shape`` whose entries, in row-major order, are ``matrix`` @ these entries."""
        source_shape = self.shape
        return self._mapped(
            shape, lambda a: applied(matrix, a, shape), lambda g: applied(matrix.T, g, source_shape)
        )

    def masked(self, mask: np.ndarray) -> Self:
        """The vector or matrix with zeros in the rows where ``mask`` is False."""
        rows = mask.reshape(-1, *(1,) * self.rank)
        return self._mapped(self.shape, lambda a: a * rows, lambda g: g * rows)

    def _require_matrix(self) -> None:
        if self.rank != 2:
            raise TypeError("only matrices have a transpose, a trace and entries")


class Array(_Node):
    """Scalars (points,), vectors (n, points) or matrices (n, m, points), with the operands of their
    operation.

    Products, quotients and powers are those of coefficient functions: ``*`` is the inner product of two
    vectors and the matrix product of two matrices.  An operation that is not supported raises TypeError.
    Values may be complex: an increment of 1e-30 i carries a derivative along (``slope_along``).
    """

    __slots__ = ("is_constant", "number", "parents", "shape", "value")
    is_constant: bool

    def __init__(self, value: np.ndarray, parents: Sequence[tuple[Array, Any]] | None = ()) -> None:
        """``parents`` are operands. Each has the map from a derivative by this array to the derivative by the
        operand.

        With an empty sequence the array is an independent argument, with None it is a constant.
        """
        self.value, self.shape = value, value.shape[:-1]
        if parents:
            parents = [parent for parent in parents if not parent[0].is_constant] or None
        self.is_constant = parents is None
        self.number = 0 if parents is None else next(_number)
        self.parents = parents or ()

    def _mapped(self, shape: tuple[int, ...], there: Map, back: Map) -> Array:
        return Array(there(self.value), [(self, back)])

    def like(self, number: float) -> Array:
        """Scalars all equal to ``number``."""
        return Array(np.full(self.value.shape[-1], number), None)

    def mapped(self, matrix: np.ndarray, shape: tuple[int, ...]) -> Array:
        return MappedArray(self, matrix, shape)

    @staticmethod
    def constant(value: float | np.ndarray) -> Array:
        """A number or one 3x3 tensor, constant in derivatives."""
        return _array(value)

    def __add__(self, other: Any) -> Array:
        return self._joined(other, np.add, _same)

    def __sub__(self, other: Any) -> Array:
        return self._joined(other, np.subtract, np.negative)

    def _joined(self, other: Any, operation: Any, pull: Map) -> Array:
        if isinstance(other, Linear):
            return NotImplemented
        other = _array(other)
        if len(self.shape) != len(other.shape):
            raise TypeError("a scalar, a vector and a tensor cannot be added to each other")
        return Array(operation(self.value, other.value), [(self, _same), (other, pull)])

    def __mul__(self, other: Any) -> Array:
        if isinstance(other, Linear):
            return NotImplemented
        a, b = self, _array(other)
        left, right, out = subscripts(a.shape, b.shape)
        value = product(left, right, out, a.value, b.value)
        of_a = a, lambda g: product(out, right, left, g, b.value)
        of_b = b, lambda g: product(out, left, right, g, a.value)
        return Array(value, [of_a, of_b])

    def __truediv__(self, other: Any) -> Array:
        other = _divisor(other)
        if self.is_constant and other.is_constant:
            return Array(self.value / other.value, None)
        inverse = 1 / other.value
        return self * Array(inverse, [(other, lambda g: -g * inverse * inverse)])

    def __pow__(self, exponent: float) -> Array:
        if not self.is_scalar or not isinstance(exponent, (int, float)):
            raise TypeError("a power needs a scalar as base and a number as exponent")
        if exponent < 1:  # at zero, a power with this exponent has no derivative
            value = self.value ** float(exponent)
            return Array(value, [(self, lambda g: exponent * self.value ** float(exponent - 1) * g)])
        lower = self.value ** float(exponent - 1)
        return Array(lower * self.value, [(self, lambda g: exponent * lower * g)])

    def __radd__(self, other: Any) -> Array:
        return self + other

    def __rmul__(self, other: Any) -> Array:
        return _array(other) * self

    def __rtruediv__(self, other: Any) -> Array:
        return _array(other) / self

    def InnerProduct(self, other: Any) -> Any:
        """The inner product a : b; NGSolve's function ``InnerProduct`` calls the method of this name."""
        if isinstance(other, Linear):
            return other.InnerProduct(self)
        a, b = self, _array(other)
        if a.rank != b.rank:
            raise TypeError("the inner product of a scalar and a tensor is not defined")
        return Array(contracted(a.value, b.value), [(a, lambda g: g * b.value), (b, lambda g: g * a.value)])

    def log(self) -> Array:
        """The natural logarithm of scalars."""
        self._require_scalar("a logarithm")
        return Array(np.log(self.value), [(self, lambda g: g / self.value)])

    def sqrt(self) -> Array:
        """The square root of scalars."""
        self._require_scalar("a square root")
        root = np.sqrt(self.value)
        return Array(root, [(self, lambda g: 0.5 * g / root)])

    def exp(self) -> Array:
        """The exponential of scalars."""
        self._require_scalar("an exponential")
        value = np.exp(self.value)
        return Array(value, [(self, lambda g: g * value)])

    def expm1(self) -> Array:
        """exp(a) - 1 of scalars a, to all digits also for small a."""
        self._require_scalar("an exponential")
        value = np.expm1(self.value)
        return Array(value, [(self, lambda g: g * (value + 1))])

    def _require_scalar(self, operation: str) -> None:
        if not self.is_scalar:
            raise TypeError(f"only scalars have {operation}")

    def cofactor(self) -> Array:
        """The cofactors of 3x3 tensors, (det A) A^-T."""
        self._require_matrix()
        return Array(0.5 * cross(self.value, self.value), [(self, lambda g: cross(self.value, g))])

    def determinant(self) -> Array:
        """The determinants of 3x3 tensors."""
        self._require_matrix()
        cofactor = 0.5 * cross(self.value, self.value)
        return Array((self.value[0] * cofactor[0]).sum(axis=0), [(self, lambda g: g * cofactor)])

    def where_positive(self, then: Any, otherwise: Any) -> Array:
        """The value of ``then`` where this scalar is > 0, and the value of ``otherwise`` elsewhere."""
        a, b, positive = _array(then), _array(otherwise), self.value.real > 0
        pulls = [(a, lambda g: np.where(positive, g, 0.0)), (b, lambda g: np.where(positive, 0.0, g))]
        return Array(np.where(positive, a.value, b.value), pulls)


class MappedArray(Array):
    """The image of an array under a constant matrix. The image is computed at first access, because a trace
    does not need it."""

    __slots__ = ("_made", "_matrix", "_source")

    def __init__(self, source: Array, matrix: np.ndarray, shape: tuple[int, ...]) -> None:
        self._source, self._matrix, self.shape = source, matrix, shape
        self._made: np.ndarray | None = None
        self.is_constant = source.is_constant
        self.number = 0 if self.is_constant else next(_number)
        size = source.shape
        self.parents = () if self.is_constant else [(source, lambda g: applied(matrix.T, g, size))]

    @property
    def value(self) -> np.ndarray:  # type: ignore[override]
        """Values at all points, (..., points)."""
        if self._made is None:
            self._made = applied(self._matrix, self._source.value, self.shape)
        return self._made

    def trace(self) -> MappedArray:
        self._require_matrix()
        return MappedArray(self._source, self._matrix[:: self.shape[0] + 1].sum(axis=0, keepdims=True), ())


class ConstantInCells(Array):
    """Matrices that are constant in each cell, so that a product with vectors is one small product a cell."""

    __slots__ = ("_by_cells", "_points")

    def __init__(self, by_cells: np.ndarray, points: int) -> None:
        """``by_cells`` are real, (n, m, cells); ``points`` is the number of points in a cell."""
        self._by_cells, self._points = by_cells, points
        self.shape, self.is_constant, self.number, self.parents = by_cells.shape[:-1], True, 0, ()

    @property
    def value(self) -> np.ndarray:  # type: ignore[override]
        """Values at all points, (n, m, points), computed at each access."""
        return np.repeat(self._by_cells, self._points, axis=-1)

    def __mul__(self, other: Any) -> Array:
        if isinstance(other, Array) and other.is_constant and other.rank == 1:
            return Array(called(_times, self._by_cells.transpose(2, 0, 1), other.value, self._points), None)
        return super().__mul__(other)

    def transposed_times(self, vectors: np.ndarray) -> np.ndarray:
        """The transposed matrices times vectors, (n, points)."""
        return called(_times, self._by_cells.transpose(2, 1, 0), vectors, self._points)


def _times(matrices: np.ndarray, vectors: np.ndarray, per: int) -> np.ndarray:
    """Products of the cells' matrices, (cells, n, m), with vectors at ``per`` points a cell, (m, points)."""
    cells, n, m = matrices.shape
    if vectors.shape[1] != cells * per or np.iscomplexobj(vectors):
        return np.einsum("pnm,mp->np", np.repeat(matrices, per, axis=0), vectors)
    result = np.empty((n, cells, per))
    np.matmul(matrices, vectors.reshape(m, cells, per).swapaxes(0, 1), out=result.swapaxes(0, 1))
    return result.reshape(n, cells * per)


class Linear(_Node):
    """A linear form in test functions: a shape and maps back to the test functions, without a value.

    ``Term.cells`` and ``Term.facets`` return an integrand that is linear in the test functions, if they get a
    ``Linear`` for each test function. ``factors_of_tests`` returns the factor of each test function.
    """

    def __init__(
        self, shape: tuple[int, ...], parents: Sequence[tuple[Linear, Any]] = (), test: str | None = None
    ) -> None:
        """``test`` is the name of a test function; ``parents`` are as for ``Array``."""
        self.shape, self.parents, self.test, self.number = shape, parents, test, next(_number)

    def _mapped(self, shape: tuple[int, ...], there: Map, back: Map) -> Linear:
        return Linear(shape, [(self, back)])

    def __add__(self, other: Any) -> Linear:
        if not isinstance(other, Linear):
            if isinstance(other, (int, float)) and other == 0:
                return self
            message = "a linear form can only be added to a form that is linear in the test functions too"
            raise TypeError(message)
        if self.shape != other.shape:
            raise TypeError("a scalar, a vector and a tensor cannot be added to each other")
        return Linear(self.shape, [(self, _same), (other, _same)])

    __radd__ = __add__

    def __sub__(self, other: Any) -> Linear:
        return self + (-other)

    def __mul__(self, other: Any) -> Linear:
        b = _array(other)
        left, right, out = subscripts(self.shape, b.shape)
        sizes = dict(zip(left + right, self.shape + b.shape, strict=True))
        return Linear(tuple(sizes[i] for i in out), [(self, lambda g: product(out, right, left, g, b.value))])

    def __rmul__(self, other: Any) -> Linear:
        a = _array(other)
        left, right, out = subscripts(a.shape, self.shape)
        sizes = dict(zip(left + right, a.shape + self.shape, strict=True))
        shape = tuple(sizes[i] for i in out)
        if isinstance(a, ConstantInCells) and self.rank == 1:
            return Linear(shape, [(self, a.transposed_times)])
        return Linear(shape, [(self, lambda g: product(out, left, right, g, a.value))])

    def __truediv__(self, other: Any) -> Linear:
        return self * Array(1 / _divisor(other).value, None)

    def InnerProduct(self, other: Any) -> Linear:
        """The inner product a : b; NGSolve's function ``InnerProduct`` calls the method of this name."""
        b = _array(other).value
        if b.ndim - 1 != self.rank:
            raise TypeError("the inner product of a scalar and a tensor is not defined")
        return Linear((), [(self, lambda g: b if g is _ONE else g * b)])


def factors_of_tests(form: Linear) -> dict[str, np.ndarray]:
    """The factors of the test functions in a scalar linear form, by the functions' names."""
    if form.shape:
        raise TypeError("an integrand has to be a scalar")
    return {node.test: g for node, g in _backwards(form, _ONE) if node.test is not None}


def derivatives(result: Array, arguments: Sequence[Array]) -> list[np.ndarray]:
    """Derivatives of a scalar ``result`` by each of ``arguments``, in the arguments' shapes."""
    if not result.is_scalar:
        raise TypeError("only scalars are differentiated")
    size, numbers = max(a.value.shape[-1] for a in arguments), {a.number for a in arguments}
    slopes = {node.number: g for node, g in _backwards(result, np.ones(size)) if node.number in numbers}
    return [slopes.get(a.number, np.zeros(a.value.shape)) for a in arguments]


def _backwards(root: Any, seed: np.ndarray) -> Iterator[tuple[Any, np.ndarray]]:
    """Yield ``root`` and the nodes that it depends on, latest first, each with the derivative of the result
    by this node; ``seed`` is the derivative by ``root``."""
    slopes, nodes, latest = {root.number: seed}, {root.number: root}, [-root.number]
    while latest:
        number = -heapq.heappop(latest)  # all nodes computed from this node have larger numbers
        node, g = nodes.pop(number), slopes.pop(number)
        yield node, g
        for parent, pull in node.parents:
            share, number = pull(g), parent.number
            if number in slopes:
                slopes[number] = slopes[number] + share
            else:
                slopes[number], nodes[number] = share, parent
                heapq.heappush(latest, -number)


def _array(value: Any) -> Array:
    if isinstance(value, Array):
        return value
    if isinstance(value, (int, float, np.floating)):
        return Array(np.array([float(value)]), None)
    if isinstance(value, np.ndarray) and value.ndim in (1, 2) and value.dtype.kind == "f":
        return Array(value[..., None], None)
    raise TypeError(f"{type(value).__name__} does not combine with arrays")


def _divisor(value: Any) -> Array:
    if not (divisor := _array(value)).is_scalar:
        raise TypeError("division by a tensor is not defined")
    return divisor


def _placed(entry: np.ndarray, shape: tuple[int, ...], index: Any) -> np.ndarray:
    """Tensors of ``shape`` with one ``entry``, and zeros elsewhere."""
    result = np.zeros((*shape, entry.shape[-1]), entry.dtype)
    result[index] = entry
    return result


def _transposed(a: np.ndarray) -> np.ndarray:
    return a.swapaxes(0, 1)


def _same(g: np.ndarray) -> np.ndarray:
    return g

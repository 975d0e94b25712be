"""Energies at many points as arrays, and their derivatives by the chain rule backwards.

NGSolve's symbolic derivative of an energy takes 3 microseconds a point (neo-Hookean, 3D), because it is a
tree of small tensor operations for each point.  Here every operation of ``Material.energy`` acts on all
points at once and remembers how to carry derivatives back.  An energy can be written with coefficient
functions' operations that have no counterpart here; it is then left to NGSolve (``array_slope``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any, TypeAlias

import numpy as np

from ngvisco.physics.material import Material, component_count, component_slices
from ngvisco.physics.tensors import tensor_space

CHUNK = 2048
"""Points at a time, so that what is made on the way stays in the processor's cache."""

_number = count()

Slope: TypeAlias = Callable[[np.ndarray], np.ndarray]


class Array:
    """Scalars (points,) or 3x3 tensors (3, 3, points), with what they were made of.

    Products, quotients and powers mean what they mean for coefficient functions: ``*`` of two tensors is
    the matrix product.  What is not supported raises TypeError.
    """

    __array_ufunc__ = None  # numpy's numbers leave the operation to this class

    def __init__(self, value: np.ndarray, parents: Sequence[tuple[Array, Any]] = ()) -> None:
        """``parents`` come with the maps that carry a derivative by this one back to them."""
        self.value, self.parents, self.number = value, parents, next(_number)
        self.is_constant = False

    @property
    def is_scalar(self) -> bool:
        return self.value.ndim == 1

    def like(self, number: float) -> Array:
        """Scalars all equal to ``number``."""
        return Array(np.full(self.value.shape[-1], number))

    def __add__(self, other: Any) -> Array:
        other = _array(other)
        value = self.value + other.value
        if value.ndim != max(self.value.ndim, other.value.ndim) or self.is_scalar != other.is_scalar:
            raise TypeError("sums of scalars and tensors are not defined")
        return Array(value, [(self, _same), (other, _same)])

    def __neg__(self) -> Array:
        return Array(-self.value, [(self, np.negative)])

    def __sub__(self, other: Any) -> Array:
        return self + (-_array(other))

    def __mul__(self, other: Any) -> Array:
        a, b = self, _array(other)
        if a.is_scalar or b.is_scalar:
            return Array(
                a.value * b.value,
                [(a, lambda g: _summed(g * b.value, a)), (b, lambda g: _summed(g * a.value, b))],
            )
        return Array(
            np.einsum("ikp,kjp->ijp", a.value, b.value),
            [
                (a, lambda g: np.einsum("ijp,kjp->ikp", g, b.value)),
                (b, lambda g: np.einsum("ijp,ikp->kjp", g, a.value)),
            ],
        )

    def __truediv__(self, other: Any) -> Array:
        other = _array(other)
        if not other.is_scalar:
            raise TypeError("division by a tensor is not defined")
        inverse = 1 / other.value
        return self * Array(inverse, [(other, lambda g: -g * inverse * inverse)])

    def __pow__(self, exponent: float) -> Array:
        if not self.is_scalar or not isinstance(exponent, (int, float)):
            raise TypeError("only scalars have powers, with numbers as exponents")
        lower = self.value ** float(exponent - 1)
        return Array(lower * self.value, [(self, lambda g: exponent * lower * g)])

    def __radd__(self, other: Any) -> Array:
        return self + other

    def __rsub__(self, other: Any) -> Array:
        return -self + other

    def __rmul__(self, other: Any) -> Array:
        return _array(other) * self

    def __rtruediv__(self, other: Any) -> Array:
        return _array(other) / self

    def InnerProduct(self, other: Any) -> Array:
        """a : b, under the name by which NGSolve's function asks for it."""
        a, b = self, _array(other)
        if a.is_scalar != b.is_scalar:
            raise TypeError("the inner product of a scalar and a tensor is not defined")
        if a.is_scalar:
            return a * b
        return Array(
            np.einsum("ijp,ijp->p", a.value, b.value),
            [(a, lambda g: g * b.value), (b, lambda g: g * a.value)],
        )

    @property
    def trans(self) -> Array:
        """The transpose."""
        self._require_tensor()
        return Array(self.value.swapaxes(0, 1), [(self, lambda g: g.swapaxes(0, 1))])

    def trace(self) -> Array:
        """The trace."""
        self._require_tensor()
        identity = np.eye(3)[:, :, None]
        return Array(np.einsum("iip->p", self.value), [(self, lambda g: g * identity)])

    def entry(self, i: int, j: int) -> Array:
        """The scalars A_ij."""
        self._require_tensor()

        def pull(g: np.ndarray) -> np.ndarray:
            result = np.zeros((3, 3, g.shape[-1]), g.dtype)
            result[i, j] = g
            return result

        return Array(self.value[i, j], [(self, pull)])

    def log(self) -> Array:
        """The natural logarithm of scalars."""
        if not self.is_scalar:
            raise TypeError("only scalars have a logarithm")
        return Array(np.log(self.value), [(self, lambda g: g / self.value)])

    def exp(self) -> Array:
        """The exponential of scalars."""
        if not self.is_scalar:
            raise TypeError("only scalars have an exponential")
        value = np.exp(self.value)
        return Array(value, [(self, lambda g: g * value)])

    def cofactor(self) -> Array:
        """The cofactors, (det A) A^-T."""
        self._require_tensor()
        return Array(0.5 * _cross(self.value, self.value), [(self, lambda g: _cross(self.value, g))])

    def determinant(self) -> Array:
        """The determinants."""
        self._require_tensor()
        cofactor = 0.5 * _cross(self.value, self.value)
        value = (self.value[0] * cofactor[0]).sum(axis=0)
        return Array(value, [(self, lambda g: g * cofactor)])

    @staticmethod
    def constant(value: float | np.ndarray) -> Array:
        """A number or one 3x3 tensor, which nothing is differentiated by."""
        return _array(value)

    def where_positive(self, then: Any, otherwise: Any) -> Array:
        """``then`` where this scalar is > 0, ``otherwise`` elsewhere."""
        a, b, positive = _array(then), _array(otherwise), self.value > 0
        return Array(
            np.where(positive, a.value, b.value),
            [(a, lambda g: np.where(positive, g, 0.0)), (b, lambda g: np.where(positive, 0.0, g))],
        )

    def _require_tensor(self) -> None:
        if self.is_scalar:
            raise TypeError("a scalar has no transpose, trace or entries")


def derivatives(result: Array, arguments: Sequence[Array]) -> list[np.ndarray]:
    """Derivatives of scalars by each of ``arguments``, in their shapes."""
    if not result.is_scalar:
        raise TypeError("only scalars are differentiated")
    size = max(a.value.shape[-1] for a in arguments)
    found: dict[int, np.ndarray] = {result.number: np.ones(size)}
    nodes = {result.number: result}
    wanted = {a.number for a in arguments}
    results: dict[int, np.ndarray] = {}
    while nodes:
        number = max(nodes)  # whatever is made of it has a larger number
        node, g = nodes.pop(number), found.pop(number)
        if number in wanted:
            results[number] = g
        for parent, pull in node.parents:
            if parent.is_constant:
                continue
            share = pull(g)
            found[parent.number] = found[parent.number] + share if parent.number in found else share
            nodes[parent.number] = parent
    return [results.get(a.number, np.zeros(a.value.shape)) for a in arguments]


def array_slope(material: Material, dim: int) -> Slope | None:
    """phi'(z) for components z (n, points), by arrays; None where the energy does not allow for them."""
    slices = component_slices(material, dim)
    spaces = {variable.name: tensor_space(variable.kind, dim) for variable in material.variables}

    def slope(z: np.ndarray) -> np.ndarray:
        result = np.empty_like(z)
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN outside the energy's domain
            for start in range(0, z.shape[1], CHUNK):
                _slope(z[:, start : start + CHUNK], result[:, start : start + CHUNK])
        return result

    def _slope(z: np.ndarray, result: np.ndarray) -> None:
        values = {}
        for name, where in slices.items():
            space = spaces[name]
            part = z[where.start] if space.is_scalar else (space.columns @ z[where]).reshape(3, 3, -1)
            values[name] = Array(part)
        energy = material.energy(values)
        for (name, where), g in zip(slices.items(), derivatives(energy, list(values.values())), strict=True):
            result[where] = g if spaces[name].is_scalar else spaces[name].columns.T @ g.reshape(9, -1)

    try:
        with np.errstate(all="ignore"):  # the point need not be in the energy's domain
            slope(np.ones((component_count(material, dim), 1)))
    except Exception:  # whatever an energy raises at values that it does not know
        return None
    return slope


def _array(value: Any) -> Array:
    if isinstance(value, Array):
        return value
    if isinstance(value, (int, float)):
        constant = Array(np.array([float(value)]))
    elif isinstance(value, np.ndarray) and value.shape == (3, 3):
        constant = Array(value[:, :, None])
    else:
        raise TypeError(f"{type(value).__name__} does not combine with arrays")
    constant.is_constant = True
    return constant


def _cross(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The symmetric bilinear map with _cross(A, A) = 2 Cof A; _cross(A, B) : C is that of any order."""
    return _minors(A, B) + _minors(B, A)


def _minors(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """A_jJ B_kK - A_jK B_kJ at (i, I), for (i, j, k) and (I, J, K) cyclic."""
    one, two = (np.roll(np.arange(3), -1), np.roll(np.arange(3), -2))
    return A[one][:, one] * B[two][:, two] - A[one][:, two] * B[two][:, one]


def _same(g: np.ndarray) -> np.ndarray:
    return g


def _summed(g: np.ndarray, target: Array) -> np.ndarray:
    """A derivative by scalars, of one in the shape of tensors."""
    return g.sum(axis=(0, 1)) if target.is_scalar and g.ndim == 3 else g

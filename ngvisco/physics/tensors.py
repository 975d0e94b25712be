"""Tensor algebra on 3x3 coefficient functions, and the spaces of the fields' tensors.

All tensors are 3x3.  On a mesh of two dimensions, in plane strain and about an axis, a tensor keeps its 33
entry and has zero 13, 23, 31, 32 entries.  This subspace is closed under every operation used here; fields
store components in an orthonormal basis of it.  The functions that energies use also accept
``ngvisco.physics.arrays``.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TypeAlias, TypeVar

import ngsolve
import numpy as np
from ngsolve import CF, CoefficientFunction, Cof, Det, Id, IfPos, InnerProduct, Trace

IDENTITY = Id(3)

Tensor: TypeAlias = CoefficientFunction
"""A scalar or a 3x3 tensor: a coefficient function, or an array of ``ngvisco.physics.arrays``."""

Scalar = TypeVar("Scalar", CoefficientFunction, np.ndarray)


def sym(A: Tensor) -> Tensor:
    """The symmetric part (A + A^T)/2."""
    return 0.5 * (A + A.trans)


def skw(A: Tensor) -> Tensor:
    """The skew part (A - A^T)/2; W = skw(grad v) is the spin (paper: ZJ)."""
    return 0.5 * (A - A.trans)


def tr(A: Tensor) -> Tensor:
    """Trace."""
    return A.trace() if hasattr(A, "trace") else Trace(A)


def sph(A: Tensor) -> Tensor:
    """Spherical part (tr A / 3) I (paper: St.Venenat-Kirchhoff-linear)."""
    return (1 / 3) * tr(A) * identity_like(A)


def identity_like(A: Tensor) -> Tensor | np.ndarray:
    """The 3x3 identity: an array if A is an array, else a coefficient function."""
    return np.eye(3) if hasattr(A, "trace") else IDENTITY


def dev(A: Tensor) -> Tensor:
    """Deviatoric part A - sph A."""
    return A - sph(A)


def shear_across(A: Tensor, P: Tensor) -> Tensor:
    """P A + A P - 2 P A P of symmetric A, 3x3: the shear across the normal n, P = n x n."""
    PA = P * A
    return PA + PA.trans - 2 * (PA * P)


def opening(D: Tensor, P: Tensor) -> Tensor:
    """(tr D) P plus the shear of D across n, 3x3, P = n x n: opening and sliding of an interface of normal n
    at the strain rate D.  The rest of D stretches matter along the interface and keeps its volume."""
    return tr(D) * P + shear_across(D, P)


def opening_stress(T: Tensor, P: Tensor) -> Tensor:
    """Transpose of ``opening``, 3x3: its product with D is T : opening(D, P)."""
    return inner(P, T) * identity_like(T) + shear_across(T, P)


def inner(A: Tensor, B: Tensor) -> Tensor:
    """The inner product A : B (or a . b)."""
    return InnerProduct(A, B)


def square(A: Tensor) -> Tensor:
    """The squared Frobenius norm |A|^2 = A : A."""
    return InnerProduct(A, A)


def log(a: Tensor) -> Tensor:
    """Natural logarithm of a scalar, or of an array of numbers."""
    if isinstance(a, np.ndarray):
        return np.log(a)
    return a.log() if hasattr(a, "log") else ngsolve.log(a)


def sqrt(a: Tensor) -> Tensor:
    """Square root of a scalar."""
    return a.sqrt() if hasattr(a, "sqrt") else ngsolve.sqrt(a)


def exp(a: Tensor) -> Tensor:
    """Exponential of a scalar."""
    return a.exp() if hasattr(a, "exp") else ngsolve.exp(a)


def expm1(a: Tensor) -> Tensor:
    """exp(a) - 1 of a scalar, to all digits also for small a."""
    if hasattr(a, "expm1"):
        return a.expm1()
    half = 0.5 * a
    return 2 * ngsolve.sinh(half) * ngsolve.exp(half)


def det(A: Tensor) -> Tensor:
    """Determinant of a 3x3 tensor."""
    return A.determinant() if hasattr(A, "determinant") else Det(A)


def cof(A: Tensor) -> Tensor:
    """Cofactor of a 3x3 tensor, (det A) A^-T where A is invertible."""
    return A.cofactor() if hasattr(A, "cofactor") else Cof(A)


def as_array(value: object) -> np.ndarray:
    """The value as an array of finite numbers; for other values an empty array, (0,)."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        return np.zeros(0)
    return array if np.isfinite(array).all() else np.zeros(0)


def constant(array: np.ndarray) -> Tensor:
    """An array of numbers as a coefficient function of its shape; equal arrays give one object."""
    return _constant(np.asarray(array, dtype=float).tobytes(), array.shape)


@lru_cache(maxsize=1024)
def _constant(numbers: bytes, shape: tuple[int, ...]) -> Tensor:
    """The function of ``constant``. Each distinct number is made once, as a conversion takes 0.1 ms."""
    values, which = np.unique(np.frombuffer(numbers), return_inverse=True)
    functions = [CF(float(value)) for value in values]
    return CF(tuple(functions[i] for i in which.ravel()), dims=shape)


def linear_map(matrix: np.ndarray, A: Tensor, shape: tuple[int, ...]) -> Tensor:
    """A constant matrix times the entries of A, row by row, as a vector or matrix of ``shape``."""
    if hasattr(A, "mapped"):
        return A.mapped(matrix, shape)
    entries, read = A.Reshape((matrix.shape[1],)), np.flatnonzero(matrix.any(axis=0))
    if 0 < len(read) < matrix.shape[1]:  # NGSolve would also multiply by the zeros, at every point
        some = slice(int(read[0]), int(read[-1]) + 1)
        matrix, entries = matrix[:, some], entries[some]
    product = constant(matrix) * entries
    return product if len(shape) == 1 else product.Reshape(shape)


def masked(A: Tensor, mask: np.ndarray) -> Tensor:
    """A vector or a matrix with zeros in the rows where ``mask`` is False."""
    if hasattr(A, "masked"):
        return A.masked(mask)
    return constant(np.diag(mask.astype(float))) * A


def log_det(A: Tensor) -> Tensor:
    """ln det A of a symmetric positive definite 3x3 tensor; NaN for any other tensor.

    The result is the sum of the pivots' logarithms. det A alone would not do, because it is also positive for
    two negative eigenvalues.
    """
    a, b, c = (A[i, i] for i in range(3))
    d, e, f = (A[i, j] for i, j in ((0, 1), (0, 2), (1, 2)))
    minor = a * b - d * d
    det = minor * c - a * f * f + 2 * d * e * f - b * e * e
    return log(a) + log(minor / a) + log(det / minor)


def if_positive(a: Tensor, then: Tensor | float, otherwise: Tensor | float) -> Tensor:
    """The value of ``then`` where a > 0, and the value of ``otherwise`` elsewhere."""
    return a.where_positive(then, otherwise) if hasattr(a, "where_positive") else IfPos(a, then, otherwise)


def is_number(a: Tensor, then: Tensor | float, otherwise: Tensor | float) -> Tensor:
    """The value of ``then`` where the scalar a is not NaN, and the value of ``otherwise`` elsewhere."""
    return if_positive(1.0 + a * a, then, otherwise)


def embed_gradient(grad: Tensor, dim: int, hoop: Tensor | None = None) -> Tensor:
    """The 3x3 velocity gradient, (grad v)_ij = d_j v_i, from the dim x dim gradient. In 2D ``hoop`` is its
    entry 33; None gives zero, for plane strain."""
    if dim == 3:
        return grad
    if hasattr(grad, "mapped"):
        plane = grad.mapped(_EMBEDDING, (3, 3))
        return plane if hoop is None else plane + hoop.mapped(_HOOP, (3, 3))
    columns = constant(_COLUMNS)
    plane = columns * grad * columns.trans
    return plane if hoop is None else plane + hoop * constant(_HOOP.reshape(3, 3))


_COLUMNS, _HOOP = np.eye(3, 2), np.eye(9)[:, 8:]
_EMBEDDING = np.zeros((9, 4))
_EMBEDDING[(0, 1, 3, 4), (0, 1, 2, 3)] = 1.0
"""Matrix (9, 4) that embeds the entries of a 2x2 matrix in a 3x3 matrix."""


def is_even(power: float) -> bool:
    """Whether |.|^(power - 2) is a polynomial; ``power_of_square`` smooths all other powers."""
    half = 0.5 * power - 1
    return abs(half - round(half)) < 1e-14 and 0 <= round(half) <= 8


def power_of_square(s: Scalar, exponent: float, floor: float) -> Scalar:
    """s^exponent for s = |.|^2 >= 0, a coefficient function or an array; differentiable at s = 0.

    Small integer exponents are exact.  Other exponents give (floor^2 + s)^exponent, because the derivative of
    a real power is NaN at zero; ``floor`` has the units of |.| and is far below any value of interest.
    """
    rounded = round(exponent)
    if abs(exponent - rounded) < 1e-14 and 0 <= rounded <= 8:
        if isinstance(s, np.ndarray):
            result = np.ones_like(s)
        else:
            result = s.like(1.0) if hasattr(s, "like") else CF(1.0)
        for _ in range(rounded):
            result = result * s
        return result
    return (floor**2 + s) ** exponent


def _unit(i: int, j: int) -> np.ndarray:
    E = np.zeros((3, 3))
    E[i, j] = 1.0
    return E


@dataclass(frozen=True)
class TensorSpace:
    """A linear space of scalars or 3x3 tensors with an orthonormal basis (Frobenius product)."""

    name: str
    basis: tuple[tuple[tuple[float, ...], ...], ...]
    """A basis of 3x3 tensors; empty for scalars."""

    @property
    def size(self) -> int:
        """Number of components."""
        return max(1, len(self.basis))

    @property
    def is_scalar(self) -> bool:
        return not self.basis

    @cached_property
    def columns(self) -> np.ndarray:
        """The basis as a (9, size) array, tensors in row-major order; (1, 1) for scalars."""
        return np.ones((1, 1)) if self.is_scalar else np.array(self.basis).reshape(len(self.basis), 9).T

    def tensor(self, components: Tensor) -> Tensor:
        """The 3x3 tensor (or scalar) with these components, a vector of length ``size``."""
        if self.is_scalar:
            is_vector = components.rank if hasattr(components, "rank") else components.dims
            return components[0] if is_vector else components
        return linear_map(self.columns, components, (3, 3))

    def components(self, value: Tensor) -> Tensor:
        """Components of the orthogonal projection of a 3x3 tensor (or scalar) onto this space."""
        if self.is_scalar:
            return value.mapped(np.ones((1, 1)), (1,)) if hasattr(value, "mapped") else CF((value,))
        return linear_map(self.columns.T, value, (self.size,))


def _space(name: str, basis: list[np.ndarray]) -> TensorSpace:
    return TensorSpace(name, tuple(tuple(tuple(float(x) for x in row) for row in B) for B in basis))


SCALAR = TensorSpace("scalar", ())


def _pairs(dim: int) -> list[tuple[int, int]]:
    if dim == 3:
        return [(i, j) for i in range(3) for j in range(3)]
    return [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)]


def full_tensors(dim: int) -> TensorSpace:
    """The space of all 3x3 tensors (9 components), or of block tensors in plane strain (5 components)."""
    return _space("full", [_unit(*pair) for pair in _pairs(dim)])


def symmetric_tensors(dim: int) -> TensorSpace:
    """The space of symmetric tensors: 6 components, 4 in plane strain; basis e_ii, (e_ij + e_ji)/sqrt 2."""
    pairs = [(i, j) for i, j in _pairs(dim) if i <= j]
    basis = [_unit(i, j) if i == j else (_unit(i, j) + _unit(j, i)) / math.sqrt(2) for i, j in pairs]
    return _space("symmetric", basis)


def vectors(dim: int) -> TensorSpace:
    """The space of vectors of the mesh's dimension, each stored in the first column of a tensor."""
    return _space("vector", [_unit(i, 0) for i in range(dim)])


def trace_free_tensors(dim: int) -> TensorSpace:
    """The space R^{3x3}_dev of symmetric trace-free tensors: 5 components, 3 in plane strain."""
    off = [(i, j) for i, j in _pairs(dim) if i < j]
    basis = [(_unit(i, j) + _unit(j, i)) / math.sqrt(2) for i, j in off]
    basis.append((_unit(0, 0) - _unit(1, 1)) / math.sqrt(2))
    basis.append((_unit(0, 0) + _unit(1, 1) - 2 * _unit(2, 2)) / math.sqrt(6))
    return _space("trace_free", basis)


def tensor_space(kind: str, dim: int) -> TensorSpace:
    """The space of a kind ("scalar", "vector", "full", "symmetric") on a mesh of dimension ``dim``."""
    if kind == "scalar":
        return SCALAR
    return {"vector": vectors, "full": full_tensors, "symmetric": symmetric_tensors}[kind](dim)


_SPREAD = 1e-6
"""Error of the closed form for eigenvalues, relative to the tensors' size. The value is fifty times the error
near a double eigenvalue."""


def least_eigenvalues(tensors: np.ndarray) -> np.ndarray:
    """Least eigenvalues of symmetric tensors, (n, 3, 3); the least of the returned numbers is always right.

    Tensors that cannot have the least eigenvalue of all are left out, as a closed form shows: decompositions
    take twenty times as long.  The result has NaN if a tensor has NaN.
    """
    (a, b, c), (_, d, e), (_, _, f) = np.ascontiguousarray(tensors.transpose(1, 2, 0))
    mean = (a + d + f) / 3
    a, d, f, b2, c2, e2 = a - mean, d - mean, f - mean, b * b, c * c, e * e
    size = np.sqrt((a * a + d * d + f * f) / 6 + (b2 + c2 + e2) / 3)
    determinant = a * (d * f - e2) - f * b2 - d * c2 + 2 * b * c * e
    cosine = 0.5 * determinant / np.maximum(size**3, np.finfo(float).tiny)
    least = mean + 2 * size * np.cos((np.arccos(np.clip(cosine, -1, 1)) + 2 * math.pi) / 3)
    bound = least.min(initial=math.inf) + _SPREAD * (abs(mean) + size).max(initial=0.0)
    if math.isnan(bound):
        return least
    return np.asarray(np.linalg.eigvalsh(tensors[~(least > bound)])[:, 0])

"""Exact fields of manufactured solutions.

The fields are written once, for coefficient functions and for numpy arrays alike.  They meet the
natural conditions of the walls of the unit box: v.n = 0, no tangential traction, hess v:(n x n) = 0 (not
those of the delta-regularisation, whose fluxes through walls ``sources`` supplies), (n . grad) Pi = 0.
With f = sin(pi x) and g = 1 - 2S, S the smooth step of degree 7 (g', g'', g''' vanish at 0 and 1),
v_i = c_i(t) f(x_i) prod_{j != i} g(x_j), and shear components of E and F vanish where they must.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, cos, exp, sin, x, y, z

import ngvisco as nv
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.material import cauchy_stress, conjugates
from ngvisco.physics.tensors import square

PI = np.pi
COORDINATES = (x, y, z)


@dataclass(frozen=True)
class Functions:
    """The functions that the exact fields are made of, of one kind of argument."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    exp: Callable[[Any], Any]


SYMBOLIC = Functions(sin, cos, exp)
NUMERIC = Functions(np.sin, np.cos, np.exp)


def plateau(s: Any) -> Any:
    """1 - 2S(s): from 1 to -1 over [0, 1], with three vanishing derivatives at both ends."""
    cube = s * s * s
    return 1 - 2 * (s * cube) * (35 - 84 * s + 70 * s * s - 20 * cube)


def velocity(X: Sequence[Any], t: Any, m: Functions) -> list[Any]:
    amplitudes = (0.4 * (1 + t), -0.3 * m.cos(t), 0.2 * (1 - t))
    result = []
    for i in range(len(X)):
        value = amplitudes[i] * m.sin(PI * X[i])
        for j in range(len(X)):
            if j != i:
                value = value * plateau(X[j])
        result.append(value)
    return result


def density(X: Sequence[Any], t: Any, m: Functions) -> Any:
    value = 0.3 * (1 - 0.5 * t)
    for i, s in enumerate(X):
        value = value * m.cos(PI * s + 0.2 * (i + 1))
    return 1.2 + value


def wave(X: Sequence[Any], amplitude: Any, m: Functions) -> Any:
    """Without a slope on the walls."""
    for s in X:
        amplitude = amplitude * m.cos(PI * s)
    return amplitude


def jacobian(X: Sequence[Any], t: Any, m: Functions) -> Any:
    return 1.1 + wave(X, 0.2 * m.cos(t), m)


def reciprocal(X: Sequence[Any], t: Any, m: Functions) -> Any:
    return 0.9 + wave(X, 0.15 * m.sin(1 + t), m)


def entropy(X: Sequence[Any], t: Any, m: Functions) -> Any:
    """In units of the heat capacity; as J and A without a slope on the walls, which are insulated by that."""
    return 0.1 + wave(X, 0.25 * m.cos(2 * t), m)


def tensor(X: Sequence[Any], t: Any, m: Functions, identity: float) -> list[list[Any]]:
    """identity * I plus a field whose ij entry vanishes on the walls normal to e_i and to e_j."""
    dim = len(X)
    zero = 0 * X[0]
    A = [[zero for _ in range(3)] for _ in range(3)]
    for i in range(3):
        value = (0.10 + 0.05 * i) * (1 + 0.5 * t)
        for s in X:
            value = value * m.cos(PI * s + 0.3 * i)
        A[i][i] = identity + value
    for i in range(dim):
        for j in range(dim):
            if i != j:
                value = (0.15 + 0.05 * i - 0.02 * j) * m.cos(t + i)
                A[i][j] = value * m.sin(PI * X[i]) * m.sin(PI * X[j])
    return A


def strain(X: Sequence[Any], t: Any, m: Functions) -> list[list[Any]]:
    A = tensor(X, t, m, 0.0)
    return [[0.5 * (A[i][j] + A[j][i]) for j in range(3)] for i in range(3)]


def distortion(X: Sequence[Any], t: Any, m: Functions) -> list[list[Any]]:
    return tensor(X, t, m, 1.0)


def stretch(X: Sequence[Any], t: Any, m: Functions) -> list[list[Any]]:
    """Symmetric and positive definite: a left Cauchy-Green tensor."""
    A = tensor(X, t, m, 1.0)
    return [[0.5 * (A[i][j] + A[j][i]) for j in range(3)] for i in range(3)]


def creep_rate(X: Sequence[Any], t: Any, m: Functions) -> list[list[Any]]:
    """Symmetric and trace-free, with (n . grad) Pi = 0 on the walls."""
    dim, zero = len(X), 0 * X[0]
    waves = [m.cos(PI * s) for s in X]
    first = 0.3 * (1 + t) * waves[0]
    second = -0.2 * m.cos(t) * waves[1]
    A = [[first, zero, zero], [zero, second, zero], [zero, zero, -first - second]]
    for i in range(dim):
        for j in range(i + 1, dim):
            A[i][j] = A[j][i] = (0.25 - 0.1 * i + 0.05 * j) * (1 - 0.5 * t) * waves[dim - 1 - i]
    return A


def body(of: Callable[..., Any], share: float) -> Callable[[Sequence[Any], Any, Functions], Any]:
    """``share`` of a field, more of it near one wall: a density of a body."""

    def field(X: Sequence[Any], t: Any, m: Functions) -> Any:
        value, factor = of(X, t, m), share * (1 + 0.5 * m.cos(PI * X[0]))
        return [[factor * v for v in row] for row in value] if isinstance(value, list) else factor * value

    return field


def swirl(X: Sequence[Any], t: Any, m: Functions) -> list[Any]:
    """Tangential to the unit circle, about the axis in space; no other condition of the walls is met."""
    x, y = X[:2]
    inside = 1 - sum(s * s for s in X)
    turning = 0.4 * (1 + t) * (1 + 0.3 * x)
    v = [inside * 0.3 * m.cos(t + s) * m.sin(2 * s) for s in X]
    return [v[0] - turning * y, v[1] + turning * x, *v[2:]]


EXACT = {
    **{"E": strain, "F": distortion, "H": distortion, "B": stretch},
    **{"J": jacobian, "A": reciprocal, "s": entropy},
    **{"n_one": body(jacobian, 0.3), "B_one": body(stretch, 0.3)},
    **{"n_two": reciprocal, "B_two": stretch},
}


@dataclass(frozen=True)
class Exact:
    """The exact fields at a time, as coefficient functions; in the unit ball where ``curved``.

    Of a Yosida approximation the exact fields are the minimisers y, and z = y + eps phi'(y).
    """

    model: nv.Model
    dim: int
    t: Any
    curved: bool = False

    def _value(self, function: Callable[..., Any]) -> CoefficientFunction:
        value = function(COORDINATES[: self.dim], self.t, SYMBOLIC)
        if not isinstance(value, list):
            return value
        if isinstance(value[0], list):
            return CF(tuple(entry for row in value for entry in row), dims=(3, 3))
        return CF(tuple(value))

    @property
    def rho(self) -> CoefficientFunction:
        """Of bodies that of their amounts."""
        if self.model.bodies:
            values = self.values
            return sum((b.density * values[AMOUNT + b.name] for b in self.model.bodies), CF(0.0))
        return self._value(density)

    @property
    def v(self) -> CoefficientFunction:
        return self._value(swirl if self.curved else velocity)

    @property
    def grad_v(self) -> CoefficientFunction:
        """(grad v)_ij = d_j v_i."""
        return CF(tuple(gradient(self.v, self.dim)), dims=(self.dim, self.dim)).trans

    @property
    def _material(self) -> nv.Material:
        """That of which there is an expression."""
        material = self.model.material
        return material.material if isinstance(material, nv.Yosida) else material

    @property
    def _minimisers(self) -> dict[str, CoefficientFunction]:
        return {v.name: self._value(EXACT[v.name]) for v in self.model.material.variables}

    @property
    def conjugates(self) -> dict[str, CoefficientFunction]:
        """The energy's derivatives, Pa; those of a Yosida approximation at z are phi'(y)."""
        return conjugates(self._material, self._minimisers)

    @property
    def values(self) -> dict[str, CoefficientFunction]:
        y, material = self._minimisers, self.model.material
        if not isinstance(material, nv.Yosida):
            return y
        return {name: y[name] + material.eps * slope for name, slope in self.conjugates.items()}

    @property
    def energy(self) -> CoefficientFunction:
        """Stored energy per volume, J/m3."""
        phi, material = self._material.energy(self._minimisers), self.model.material
        if isinstance(material, nv.Yosida):
            phi = phi + 0.5 * material.eps * sum((square(s) for s in self.conjugates.values()), CF(0.0))
        return phi

    @property
    def stress(self) -> CoefficientFunction:
        """Cauchy stress T, 3x3, Pa."""
        return cauchy_stress(self.model.material, self.values, self.conjugates, self.energy)

    @property
    def Pi(self) -> CoefficientFunction:
        """The creep rate, 3x3, where it is a field of its own."""
        return self._value(creep_rate)

    @property
    def z(self) -> CoefficientFunction:
        """All transported components, as they are stored."""
        return self.model.material.states(self.dim).components(self.values)


def gradient(f: CoefficientFunction, dim: int) -> list[CoefficientFunction]:
    """d_1 f, ..., d_dim f."""
    return [f.Diff(s) for s in COORDINATES[:dim]]


def divergence(A: CoefficientFunction, dim: int) -> CoefficientFunction:
    """(div A)_i = d_j A_ij, of the first dim rows and columns."""
    columns = gradient(A, dim)
    return CF(tuple(sum(columns[j][i, j] for j in range(dim)) for i in range(dim)))

"""Exact fields, the sources that make them solutions, and an independent look at those sources.

The fields are written once, for coefficient functions and for numpy arrays alike.  They meet the
natural conditions of the walls of the unit box: v.n = 0, no tangential traction, hess v:(n x n) = 0.
With f = sin(pi x) and g = 1 - 2S, S the smooth step of degree 7 (g', g'', g''' vanish at 0 and 1),
v_i = c_i(t) f(x_i) prod_{j != i} g(x_j), and shear components of E and F vanish where they must.

Sources are strong residuals of the exact fields with the *discrete* time derivative
(z(t) - z(t - tau))/tau, so that what remains is the error in space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Mesh, cos, sin, x, y, z

from ngvisco import Model, time
from ngvisco.forms.context import Entry, Integrand
from ngvisco.forms.spaces import Fields
from ngvisco.physics.material import cauchy_stress, components_of, conjugates, mandel_stress
from ngvisco.physics.model import Gravity, as_vector
from ngvisco.physics.tensors import embed_gradient, inner, sym

PI = np.pi
COORDINATES = (x, y, z)


@dataclass(frozen=True)
class Functions:
    """The functions that the exact fields are made of, of one kind of argument."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]


SYMBOLIC = Functions(sin, cos)
NUMERIC = Functions(np.sin, np.cos)


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


def jacobian(X: Sequence[Any], t: Any, m: Functions) -> Any:
    value = 0.2 * m.cos(t)
    for s in X:
        value = value * m.cos(PI * s)
    return 1.1 + value


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


EXACT = {"E": strain, "F": distortion, "J": jacobian}


@dataclass(frozen=True)
class Exact:
    """The exact fields at a time, as coefficient functions."""

    model: Model
    dim: int
    t: Any

    def _value(self, function: Callable[..., Any]) -> CoefficientFunction:
        value = function(COORDINATES[: self.dim], self.t, SYMBOLIC)
        if not isinstance(value, list):
            return value
        if isinstance(value[0], list):
            return CF(tuple(entry for row in value for entry in row), dims=(3, 3))
        return CF(tuple(value))

    @property
    def rho(self) -> CoefficientFunction:
        return self._value(density)

    @property
    def v(self) -> CoefficientFunction:
        return self._value(velocity)

    @property
    def grad_v(self) -> CoefficientFunction:
        """(grad v)_ij = d_j v_i."""
        return CF(tuple(gradient(self.v, self.dim)), dims=(self.dim, self.dim)).trans

    @property
    def values(self) -> dict[str, CoefficientFunction]:
        return {v.name: self._value(EXACT[v.name]) for v in self.model.material.variables}

    @property
    def z(self) -> CoefficientFunction:
        """All transported components, as they are stored."""
        return components_of(self.model.material, self.values, self.dim)


def gradient(f: CoefficientFunction, dim: int) -> list[CoefficientFunction]:
    """d_1 f, ..., d_dim f."""
    return [f.Diff(s) for s in COORDINATES[:dim]]


def divergence(A: CoefficientFunction, dim: int) -> CoefficientFunction:
    """(div A)_i = d_j A_ij, of the first dim rows and columns."""
    columns = gradient(A, dim)
    return CF(tuple(sum(columns[j][i, j] for j in range(dim)) for i in range(dim)))


class Sources:
    """Strong residuals of the exact fields, and the term that puts them into the system.

    The momentum form is that of the momentum equation minus v/2 times the continuity equation, and so
    is its source.
    """

    def __init__(self, model: Model, dim: int, tau: float) -> None:
        self.model, self.dim, self.tau = model, dim, tau
        self.new, self.old = Exact(model, dim, time), Exact(model, dim, time - tau)

    @property
    def continuity(self) -> CoefficientFunction:
        """(rho - rho_old)/tau + div(rho v)."""
        new, old = self.new, self.old
        flux = new.rho * new.v
        return (new.rho - old.rho) / self.tau + sum(d[i] for i, d in enumerate(gradient(flux, self.dim)))

    @property
    def kinematics(self) -> CoefficientFunction:
        """(z - z_old)/tau + (v.grad) z - rate(z; L, Pi), components."""
        new, old, model = self.new, self.old, self.model
        values, L = new.values, embed_gradient(new.grad_v, self.dim)
        Pi = 0 * L
        if model.creep is not None:
            zeta = conjugates(model.material, values)
            Pi = model.creep.R * mandel_stress(model.material, values, zeta, self.dim)
        rates = {v.name: v.rate(values, L, Pi) for v in model.material.variables}
        total = (new.z - old.z) / self.tau - components_of(model.material, rates, self.dim)
        for v_j, dz in zip((new.v[j] for j in range(self.dim)), gradient(new.z, self.dim), strict=True):
            total = total + v_j * dz
        return total

    def inertia(self) -> CoefficientFunction:
        """(rho v - rho_old v_old)/tau + div(rho v x v)."""
        new, old, dim = self.new, self.old, self.dim
        flux = new.rho * new.v
        rate = (flux - old.rho * old.v) / self.tau
        products = CF(tuple(flux[i] * new.v[j] for i in range(dim) for j in range(dim)), dims=(dim, dim))
        return rate + divergence(products, dim)

    def elastic(self) -> CoefficientFunction:
        """-div T."""
        return -divergence(cauchy_stress(self.model.material, self.new.values), self.dim)

    def viscous(self) -> CoefficientFunction:
        """-div(D eps(v)) + div div(c(|hess v|^2) hess v)."""
        model, new, dim = self.model, self.new, self.dim
        total = CF(tuple([0.0] * dim))
        if model.viscosity is not None:
            stress = model.viscosity.stress(sym(embed_gradient(new.grad_v, dim)))
            total = total - divergence(stress, dim)
        if model.hyperviscosity is not None:
            hess = [[gradient(d, dim) for d in gradient(new.v[i], dim)] for i in range(dim)]
            s = sum(h * h for component in hess for row in component for h in row)
            c = model.hyperviscosity.coefficient(s)
            force = []
            for i in range(dim):
                terms = [
                    (c * hess[i][j][k]).Diff(COORDINATES[k]).Diff(COORDINATES[j])
                    for j in range(dim)
                    for k in range(dim)
                ]
                force.append(sum(terms[1:], terms[0]))
            total = total + CF(tuple(force))
        return total

    def gravity(self) -> CoefficientFunction:
        """-rho g."""
        total = CF(tuple([0.0] * self.dim))
        for load in self.model.loads:
            assert isinstance(load, Gravity)
            total = total - self.new.rho * as_vector(load.g, self.dim, "Gravity.g")
        return total

    @property
    def momentum(self) -> CoefficientFunction:
        """The strong momentum equation's residual."""
        return self.inertia() + self.elastic() + self.viscous() + self.gravity()

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        force = self.momentum - 0.5 * self.continuity * self.new.v
        return [
            Integrand(-self.continuity * w.rho),
            Integrand(-inner(force, w.v)),
            Integrand(-inner(self.kinematics, w.z)),
        ]

    def entries(self, u: Fields) -> list[Entry]:
        """None: these runs are compared with their exact solutions, not balanced."""
        return []


# --- the same residuals without NGSolve: finite differences of the fields in numpy ---------------

_OFFSETS = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_STEP = 0.01

ArrayFunction = Callable[[np.ndarray], np.ndarray]


def difference(f: ArrayFunction, j: int) -> ArrayFunction:
    """d_j f by a central difference of eighth order; points in the last axis of the argument."""

    def derivative(X: np.ndarray) -> np.ndarray:
        shifts = np.zeros((len(_OFFSETS), *[1] * (X.ndim - 1), X.shape[-1]))
        shifts[..., j] = (_STEP * _OFFSETS).reshape(-1, *[1] * (X.ndim - 1))
        return np.tensordot(_WEIGHTS / _STEP, f(X[None] + shifts), axes=1)

    return derivative


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Material constants by name, for the formulas in numpy."""

    K_e: float
    G_e: float
    epsilon: float = 0.0
    K_v: float = 0.0
    G_v: float = 0.0
    mu: float = 0.0
    p: float = 2.0
    R: float = 0.0
    g: float = 0.0
    """Second component of gravity."""


class FiniteDifferences:
    """Residuals of the strong equations at points, from the exact fields and textbook formulas."""

    def __init__(self, kind: str, c: Coefficients, dim: int, t: float, tau: float) -> None:
        """``kind`` is ``"linear"`` or ``"neo-hookean"``."""
        self.kind, self.c, self.dim, self.t, self.tau = kind, c, dim, t, tau

    def scalar(self, function: Callable[..., Any], t: float) -> ArrayFunction:
        return lambda X: function(tuple(np.moveaxis(X, -1, 0)), t, NUMERIC)

    def vector(self, t: float) -> ArrayFunction:
        return lambda X: np.stack(velocity(tuple(np.moveaxis(X, -1, 0)), t, NUMERIC), axis=-1)

    def matrix(self, function: Callable[..., Any], t: float) -> ArrayFunction:
        def value(X: np.ndarray) -> np.ndarray:
            rows = function(tuple(np.moveaxis(X, -1, 0)), t, NUMERIC)
            return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

        return value

    def L(self, X: np.ndarray) -> np.ndarray:
        result = np.zeros((*X.shape[:-1], 3, 3))
        for j in range(self.dim):
            result[..., : self.dim, j] = difference(self.vector(self.t), j)(X)
        return result

    def divergence(self, f: ArrayFunction, X: np.ndarray) -> np.ndarray:
        """d_j f[..., j]."""
        return sum(difference(f, j)(X)[..., j] for j in range(self.dim))

    def transport(self, f: Callable[[float], ArrayFunction], X: np.ndarray) -> np.ndarray:
        """(f - f_old)/tau + (v . grad) f."""
        v = self.vector(self.t)(X)
        total = (f(self.t)(X) - f(self.t - self.tau)(X)) / self.tau
        for j in range(self.dim):
            v_j = v[..., j].reshape(*v.shape[:-1], *[1] * (total.ndim - X.ndim + 1))
            total = total + v_j * difference(f(self.t), j)(X)
        return total

    def continuity(self, X: np.ndarray) -> np.ndarray:
        rho, v = self.scalar(density, self.t), self.vector(self.t)
        rho_old = self.scalar(density, self.t - self.tau)
        return (rho(X) - rho_old(X)) / self.tau + self.divergence(lambda Y: rho(Y)[..., None] * v(Y), X)

    def stress(self, X: np.ndarray) -> np.ndarray:
        """T of the textbook: S + phi I for E; 2 G J^{-2/3} F F^T + (J phi_J + phi) I for (F, J)."""
        c, identity = self.c, np.eye(3)
        if self.kind == "linear":
            E = self.matrix(strain, self.t)(X)
            trace = np.trace(E, axis1=-2, axis2=-1)[..., None, None]
            deviator = E - trace / 3 * identity
            phi = 0.5 * c.K_e * trace**2 + c.G_e * np.sum(deviator**2, axis=(-2, -1), keepdims=True)
            return c.K_e * trace * identity + 2 * c.G_e * deviator + phi * identity
        F, J = self.matrix(distortion, self.t)(X), self.scalar(jacobian, self.t)(X)[..., None, None]
        F_square = np.sum(F**2, axis=(-2, -1), keepdims=True)
        shift = J - 1 + c.epsilon / c.K_e
        phi = 0.5 * c.K_e * shift**2 + c.G_e * F_square / J ** (2 / 3) - c.epsilon * np.log(J)
        phi_J = c.K_e * shift - 2 / 3 * c.G_e * F_square / J ** (5 / 3) - c.epsilon / J
        return 2 * c.G_e * F @ np.swapaxes(F, -1, -2) / J ** (2 / 3) + (J * phi_J + phi) * identity

    def creep(self, X: np.ndarray) -> np.ndarray:
        """Pi = R dev S for E; R sym dev(F^T S_F), S_F = 2 G J^{-2/3} F, for F."""
        c, identity = self.c, np.eye(3)
        if self.kind == "linear":
            M = 2 * c.G_e * self.matrix(strain, self.t)(X)
        else:
            F, J = self.matrix(distortion, self.t)(X), self.scalar(jacobian, self.t)(X)[..., None, None]
            M = 2 * c.G_e * np.swapaxes(F, -1, -2) @ F / J ** (2 / 3)
        return c.R * (M - np.trace(M, axis1=-2, axis2=-1)[..., None, None] / 3 * identity)

    def kinematics(self, X: np.ndarray) -> dict[str, np.ndarray]:
        """Residuals of the equations of E, or of F and J."""
        L, Pi = self.L(X), self.creep(X)
        if self.kind == "linear":
            E = self.matrix(strain, self.t)(X)
            LT = np.swapaxes(L, -1, -2)
            eps, W = (L + LT) / 2, (L - LT) / 2
            rate = eps + W @ E - E @ W - Pi
            return {"E": self.transport(lambda t: self.matrix(strain, t), X) - rate}
        F, J = self.matrix(distortion, self.t)(X), self.scalar(jacobian, self.t)(X)
        return {
            "F": self.transport(lambda t: self.matrix(distortion, t), X) - (L @ F - F @ Pi),
            "J": self.transport(lambda t: self.scalar(jacobian, t), X) - np.trace(L, axis1=-2, axis2=-1) * J,
        }

    def viscous_stress(self, X: np.ndarray) -> np.ndarray:
        """K_v tr(eps) I + 2 G_v dev eps."""
        L = self.L(X)
        eps = (L + np.swapaxes(L, -1, -2)) / 2
        trace = np.trace(eps, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)
        return self.c.K_v * trace + 2 * self.c.G_v * (eps - trace / 3)

    def hyperstress(self, X: np.ndarray) -> np.ndarray:
        """mu |hess v|^{p-2} hess v, indices i j k."""
        v, d = self.vector(self.t), range(self.dim)
        rows = [np.stack([difference(difference(v, k), j)(X) for k in d], axis=-1) for j in d]
        hess = np.stack(rows, axis=-2)
        size = np.sum(hess**2, axis=(-3, -2, -1), keepdims=True)
        return self.c.mu * size ** ((self.c.p - 2) / 2) * hess

    def momentum(self, X: np.ndarray) -> np.ndarray:
        rho, v, dim = self.scalar(density, self.t), self.vector(self.t), self.dim
        m_old = self.scalar(density, self.t - self.tau)(X)[..., None] * self.vector(self.t - self.tau)(X)
        total = (rho(X)[..., None] * v(X) - m_old) / self.tau

        def flux(Y: np.ndarray) -> np.ndarray:
            w = v(Y)
            carried = rho(Y)[..., None, None] * w[..., :, None] * w[..., None, :]
            return carried - (self.stress(Y) + self.viscous_stress(Y))[..., :dim, :dim]

        total = total + self.divergence(flux, X)
        if self.c.mu:
            for j in range(dim):
                for k in range(dim):
                    second = difference(difference(self.hyperstress, k), j)(X)
                    total = total + second[..., j, k]
        total[..., 1] -= rho(X) * self.c.g
        return total


def at_points(f: CoefficientFunction, mesh: Mesh, X: np.ndarray) -> np.ndarray:
    """A coefficient function at points, shape (points, ...)."""
    return np.array([f(mesh(*point)) for point in X])


# --- rates ---------------------------------------------------------------------------------------


@dataclass
class RateTable:
    """Errors on a sequence of meshes or steps, each half the last."""

    title: str
    sizes: list[float] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=dict)

    def rates(self, name: str) -> list[float]:
        e = np.array(self.errors[name])
        h = np.array(self.sizes)
        return list(np.log(e[:-1] / e[1:]) / np.log(h[:-1] / h[1:]))

    def __str__(self) -> str:
        lines = [self.title]
        for name, errors in self.errors.items():
            rates = ["", *(f"({rate:.2f})" for rate in self.rates(name))]
            lines.append(
                f"  {name:8s}" + "  ".join(f"{e:.3e} {r:>6s}" for e, r in zip(errors, rates, strict=True))
            )
        return "\n".join(lines)

    def add(self, size: float, **errors: float) -> None:
        """A further row."""
        self.sizes.append(size)
        for name, error in errors.items():
            self.errors.setdefault(name, []).append(error)

    def require(self, **least: float) -> None:
        """Assert the rate of the finest pair of every named column; the message is the table."""
        print(self)
        for name, rate in least.items():
            assert self.rates(name)[-1] >= rate, f"rate of {name} < {rate}\n{self}"

"""The residuals of the strong equations without NGSolve: finite differences of the exact fields in numpy.

An independent look at ``sources``: textbook formulas, no form and no derivative in common with it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.forms.context import time
from tests.verification.manufactured import (
    NUMERIC,
    creep_rate,
    density,
    distortion,
    entropy,
    jacobian,
    reciprocal,
    strain,
    velocity,
)
from tests.verification.sources import Sources

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
    rule: str = "linear"
    """Whose |M| of |Pi| is: one of ``FORCES``, of A, n and sigma."""
    A: float = 0.0
    n: float = 1.0
    sigma: float = 0.0
    nu: float = 0.0
    """Of the creep rate's 4-Laplacian; where it is 0, Pi = R M."""
    g: float = 0.0
    """Second component of gravity."""
    delta: float = 0.0
    """Of the density's 4-Laplacian."""
    delta_fields: float = 0.0
    damping: float = 0.0
    """epsilon in epsilon |v|^2 v."""
    c: float = 0.0
    """Heat capacity, in units of which the entropy counts; with it theta_R, Grueneisen's parameter, and
    kappa of a conductivity kappa theta^1.5."""
    theta_R: float = 0.0
    Gamma: float = 0.0
    kappa: float = 0.0


FORCES: dict[str, Callable[[Coefficients, np.ndarray], np.ndarray]] = {
    "linear": lambda c, size: size / c.R,
    "Norton": lambda c, size: (size / c.A) ** (1 / c.n),
    "Eyring": lambda c, size: c.sigma * np.arcsinh(size / c.A),
    "Perzyna": lambda c, size: c.sigma * (1 + (size / (c.R * c.sigma)) ** (1 / c.n)),
}
"""|M|, Pa, of |Pi|, 1/s, by the inverse of each flow rule; sigma of Perzyna's is |M| at yield."""


class FiniteDifferences:
    """Residuals of the strong equations at points, from the exact fields and textbook formulas."""

    def __init__(self, kind: str, c: Coefficients, dim: int, t: float, tau: float) -> None:
        """``kind`` is ``"linear"``, ``"neo-hookean"`` or, the same material, ``"with heat"``."""
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
        return np.sum([difference(f, j)(X)[..., j] for j in range(self.dim)], axis=0)

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
        return (rho(X) - rho_old(X)) / self.tau + self.divergence(
            lambda Y: rho(Y)[..., None] * v(Y) - self.diffusive_flux(Y), X
        )

    def diffusive_flux(self, X: np.ndarray) -> np.ndarray:
        """delta |grad rho|^2 grad rho."""
        rho = self.scalar(density, self.t)
        slope = np.stack([difference(rho, j)(X) for j in range(self.dim)], axis=-1)
        return self.c.delta * np.sum(slope**2, axis=-1, keepdims=True) * slope

    def diffused(self, f: ArrayFunction, X: np.ndarray) -> np.ndarray:
        """delta Laplace f."""
        second = [difference(difference(f, j), j)(X) for j in range(self.dim)]
        return self.c.delta_fields * np.sum(second, axis=0)

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
        T = 2 * c.G_e * F @ np.swapaxes(F, -1, -2) / J ** (2 / 3) + (J * phi_J + phi) * identity
        if self.kind == "with heat":  # p = Gamma c theta/J
            A = self.scalar(reciprocal, self.t)(X)
            T = T - (c.Gamma * c.c * self.temperature(X) * A)[..., None, None] * identity
        return np.asarray(T)

    def temperature(self, X: np.ndarray) -> np.ndarray:
        """theta_R J^-Gamma exp(S/c), S = s J per reference volume."""
        A, s = self.scalar(reciprocal, self.t)(X), self.scalar(entropy, self.t)(X)
        return np.asarray(self.c.theta_R * A**self.c.Gamma * np.exp(s / A))

    def heating(self, X: np.ndarray) -> np.ndarray:
        """sigma_v : grad v + mu |hess v|^p + R |M|^2 + epsilon |v|^4 + div(kappa theta^1.5 grad theta)."""
        c, L, M = self.c, self.L(X), self.mandel(X)
        total = np.sum(self.viscous_stress(X) * L, axis=(-2, -1)) + c.R * np.sum(M * M, axis=(-2, -1))
        if c.mu:
            S = self.hyperstress(X)
            total = total + np.sum(S * S, axis=(-3, -2, -1)) ** (c.p / (2 * c.p - 2)) * c.mu ** (
                1 / (1 - c.p)
            )
        total = total + c.damping * np.sum(self.vector(self.t)(X) ** 2, axis=-1) ** 2

        def flux(Y: np.ndarray) -> np.ndarray:
            slope = np.stack([difference(self.temperature, j)(Y) for j in range(self.dim)], axis=-1)
            return c.kappa * self.temperature(Y)[..., None] ** 1.5 * slope

        return np.asarray(total + self.divergence(flux, X))

    def creep(self, X: np.ndarray) -> np.ndarray:
        """Pi = R M, or the exact field."""
        return self.matrix(creep_rate, self.t)(X) if self.c.nu else self.c.R * self.mandel(X)

    def flow_rule(self, X: np.ndarray) -> np.ndarray:
        """|M|(|Pi|) Pi/|Pi| - nu div(|grad Pi|^2 grad Pi) - M, |Pi| > 0."""
        Pi = self.matrix(creep_rate, self.t)

        def flux(Y: np.ndarray) -> np.ndarray:
            slope = np.stack([difference(Pi, j)(Y) for j in range(self.dim)], axis=-1)
            return self.c.nu * np.sum(slope**2, axis=(-3, -2, -1), keepdims=True) * slope

        rate = Pi(X)
        size = np.linalg.norm(rate, axis=(-2, -1), keepdims=True)
        force = FORCES[self.c.rule](self.c, size) / size * rate
        return np.asarray(force - self.divergence(flux, X) - self.mandel(X))

    def mandel(self, X: np.ndarray) -> np.ndarray:
        """M = dev S for E; sym dev(F^T S_F), S_F = 2 G J^{-2/3} F, for F."""
        c, identity = self.c, np.eye(3)
        if self.kind == "linear":
            M = 2 * c.G_e * self.matrix(strain, self.t)(X)
        else:
            F, J = self.matrix(distortion, self.t)(X), self.scalar(jacobian, self.t)(X)[..., None, None]
            M = 2 * c.G_e * np.swapaxes(F, -1, -2) @ F / J ** (2 / 3)
        return np.asarray(M - np.trace(M, axis1=-2, axis2=-1)[..., None, None] / 3 * identity)

    def kinematics(self, X: np.ndarray) -> dict[str, np.ndarray]:
        """Residuals of the equations of E, or of F and J, and with heat of A and s."""
        L, Pi = self.L(X), self.creep(X)
        if self.kind == "linear":
            E = self.matrix(strain, self.t)(X)
            LT = np.swapaxes(L, -1, -2)
            eps, W = (L + LT) / 2, (L - LT) / 2
            rate = eps + W @ E - E @ W - Pi
            rate = rate + self.diffused(self.matrix(strain, self.t), X)
            return {"E": self.transport(lambda t: self.matrix(strain, t), X) - rate}
        F, J = self.matrix(distortion, self.t)(X), self.scalar(jacobian, self.t)(X)
        rate_F = L @ F - F @ Pi + self.diffused(self.matrix(distortion, self.t), X)
        rate_J = np.trace(L, axis1=-2, axis2=-1) * J + self.diffused(self.scalar(jacobian, self.t), X)
        found = {
            "F": self.transport(lambda t: self.matrix(distortion, t), X) - rate_F,
            "J": self.transport(lambda t: self.scalar(jacobian, t), X) - rate_J,
        }
        if self.kind == "with heat":
            tr_L = np.trace(L, axis1=-2, axis2=-1)
            found["A"] = self.transport(lambda t: self.scalar(reciprocal, t), X)
            found["A"] += tr_L * self.scalar(reciprocal, self.t)(X)
            found["s"] = self.transport(lambda t: self.scalar(entropy, t), X)
            found["s"] += tr_L * self.scalar(entropy, self.t)(X)
            found["s"] -= self.heating(X) / (self.c.c * self.temperature(X))
        return found

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
        speed_square = np.sum(v(X) ** 2, axis=-1, keepdims=True)
        total = total + self.c.damping * speed_square * v(X)
        compensating = self.L(X)[..., :dim, :dim] @ self.diffusive_flux(X)[..., None]
        total = total + compensating[..., 0]
        return total


def at_points(f: CoefficientFunction, mesh: Mesh, X: np.ndarray) -> np.ndarray:
    """A coefficient function at points, shape (points, ...)."""
    return np.array([f(mesh(*point)) for point in X])


def mismatch(c: Coefficients, sources: Sources, kind: str, t: float, mesh: Mesh) -> dict[str, float]:
    """Largest difference of each equation's source at random points, relative to its largest value."""
    dim = sources.dim
    X = np.random.default_rng(7).uniform(0.1, 0.9, (8, dim))
    time.Set(t)
    independent = FiniteDifferences(kind, c, dim, t, sources.tau)
    expected = {
        "continuity": independent.continuity(X),
        "momentum": independent.momentum(X),
        **independent.kinematics(X),
    }
    rates = sources.model.material.states(dim).tensors(lambda: sources.kinematics)
    given = {"continuity": sources.continuity, "momentum": sources.momentum, **rates}
    if sources.creep is not None:
        expected["Pi"], given["Pi"] = independent.flow_rule(X), sources.creep
    result = {}
    for name, values in expected.items():
        found = at_points(given[name], mesh, X).reshape(values.shape)
        result[name] = float(abs(found - values).max() / abs(values).max())
    return result

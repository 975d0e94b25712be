"""Residuals of the strong equations without NGSolve, by finite differences of the exact fields in numpy.

The residuals check ``manufactured.Sources`` by textbook formulas, and share no form and no derivative with
it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.forms.context import time
from tests.verification.manufactured import EXACT, Field, Sources

_OFFSETS = np.array([-4, -3, -2, -1, 1, 2, 3, 4])
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_STEP = 0.01

ArrayFunction = Callable[[np.ndarray], np.ndarray]


def difference(f: ArrayFunction, j: int) -> ArrayFunction:
    """The derivative d_j f by a central difference of eighth order; the last axis of X has the coordinates
    of a point."""

    def derivative(X: np.ndarray) -> np.ndarray:
        shifts = np.zeros((len(_OFFSETS), *[1] * (X.ndim - 1), X.shape[-1]))
        shifts[..., j] = (_STEP * _OFFSETS).reshape(-1, *[1] * (X.ndim - 1))
        return np.tensordot(_WEIGHTS / _STEP, f(X[None] + shifts), axes=1)

    return derivative


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """Material constants by name, for the formulas in numpy.

    A, n and sigma are constants of ``FORCES``. nu is the factor of the creep rate's 4-Laplacian (Pi = R M if
    it is 0), g the second component of gravity, delta the factor of the density's 4-Laplacian, damping is
    epsilon in epsilon |v|^2 v, and kappa is the factor in the conductivity kappa theta^1.5.  The entropy is
    in units of c.
    """

    K_e: float
    G_e: float
    epsilon: float = 0.0
    K_v: float = 0.0
    G_v: float = 0.0
    mu: float = 0.0
    p: float = 2.0
    R: float = 0.0
    rule: str = "linear"
    A: float = 0.0
    n: float = 1.0
    sigma: float = 0.0
    nu: float = 0.0
    g: float = 0.0
    delta: float = 0.0
    delta_fields: float = 0.0
    damping: float = 0.0
    c: float = 0.0
    theta_R: float = 0.0
    Gamma: float = 0.0
    kappa: float = 0.0


FORCES: dict[str, Callable[[Coefficients, np.ndarray], np.ndarray]] = {
    "linear": lambda c, size: size / c.R,
    "Norton": lambda c, size: (size / c.A) ** (1 / c.n),
    "Eyring": lambda c, size: c.sigma * np.arcsinh(size / c.A),
    "Perzyna": lambda c, size: c.sigma * (1 + (size / (c.R * c.sigma)) ** (1 / c.n)),
}
"""|M|, Pa, as a function of |Pi|, 1/s, the inverse of each flow rule; Perzyna's sigma is |M| at yield."""


def field(of: Field, t: float) -> ArrayFunction:
    """An exact field as a function of points, (..., dim), with the field's own indices last."""

    def value(X: np.ndarray) -> np.ndarray:
        found = np.array(of(tuple(np.moveaxis(X, -1, 0)), t, np))
        rank = found.ndim - X.ndim + 1
        return np.moveaxis(found, range(rank), range(-rank, 0))

    return value


def _trace(A: np.ndarray) -> np.ndarray:
    return np.trace(A, axis1=-2, axis2=-1)[..., None, None]


class FiniteDifferences:
    """Residuals of the strong equations at points, by the exact fields and textbook formulas."""

    def __init__(self, kind: str, c: Coefficients, dim: int, t: float, tau: float) -> None:
        """``kind`` is ``"linear"``, ``"neo-hookean"``, or ``"with heat"``: neo-Hookean with heat."""
        self.kind, self.c, self.dim, self.tau = kind, c, dim, tau
        self.now, self.old = ({name: field(of, s) for name, of in EXACT.items()} for s in (t, t - tau))

    def grad(self, f: ArrayFunction) -> ArrayFunction:
        """The gradient d_j f, with j the last index."""
        return lambda X: np.stack([difference(f, j)(X) for j in range(self.dim)], axis=-1)

    def div(self, f: ArrayFunction) -> ArrayFunction:
        """The divergence d_j f[..., j]."""
        return lambda X: np.sum([difference(f, j)(X)[..., j] for j in range(self.dim)], axis=0)

    def flux(self, f: ArrayFunction, factor: float, p: float = 4.0) -> ArrayFunction:
        """The flux factor |grad f|^{p-2} grad f."""

        def value(X: np.ndarray) -> np.ndarray:
            slope = self.grad(f)(X)
            size = np.sum(slope**2, axis=tuple(range(X.ndim - 1, slope.ndim)), keepdims=True)
            return np.asarray(factor * size ** ((p - 2) / 2) * slope)

        return value

    def L(self, X: np.ndarray) -> np.ndarray:
        result = np.zeros((*X.shape[:-1], 3, 3))
        result[..., : self.dim, : self.dim] = self.grad(self.now["v"])(X)
        return result

    def transport(self, name: str, X: np.ndarray) -> np.ndarray:
        """The discrete material derivative (f - f_old)/tau + (v . grad) f."""
        f, v = self.now[name], self.now["v"](X)
        slope = self.grad(f)(X)
        along = np.expand_dims(v, tuple(range(X.ndim - 1, slope.ndim - 1)))
        return np.asarray((f(X) - self.old[name](X)) / self.tau + np.sum(along * slope, axis=-1))

    def continuity(self, X: np.ndarray) -> np.ndarray:
        rho, v = self.now["rho"], self.now["v"]
        rate = (rho(X) - self.old["rho"](X)) / self.tau
        return np.asarray(rate + self.div(lambda Y: rho(Y)[..., None] * v(Y) - self.diffusive_flux(Y))(X))

    def diffusive_flux(self, X: np.ndarray) -> np.ndarray:
        """The flux delta |grad rho|^2 grad rho."""
        return self.flux(self.now["rho"], self.c.delta)(X)

    def stress(self, X: np.ndarray) -> np.ndarray:
        """The textbook's stress T: S + phi I for E; 2 G J^{-2/3} F F^T + (J phi_J + phi) I for (F, J)."""
        c, identity = self.c, np.eye(3)
        if self.kind == "linear":
            E = self.now["E"](X)
            trace = _trace(E)
            deviator = E - trace / 3 * identity
            phi = 0.5 * c.K_e * trace**2 + c.G_e * np.sum(deviator**2, axis=(-2, -1), keepdims=True)
            return np.asarray(c.K_e * trace * identity + 2 * c.G_e * deviator + phi * identity)
        F, J = self.now["F"](X), self.now["J"](X)[..., None, None]
        F_square = np.sum(F**2, axis=(-2, -1), keepdims=True)
        shift = J - 1 + c.epsilon / c.K_e
        phi = 0.5 * c.K_e * shift**2 + c.G_e * F_square / J ** (2 / 3) - c.epsilon * np.log(J)
        phi_J = c.K_e * shift - 2 / 3 * c.G_e * F_square / J ** (5 / 3) - c.epsilon / J
        T = 2 * c.G_e * F @ np.swapaxes(F, -1, -2) / J ** (2 / 3) + (J * phi_J + phi) * identity
        if self.kind == "with heat":  # p = Gamma c theta/J
            T = T - (c.Gamma * c.c * self.temperature(X) * self.now["A"](X))[..., None, None] * identity
        return np.asarray(T)

    def temperature(self, X: np.ndarray) -> np.ndarray:
        """The temperature theta_R J^-Gamma exp(S/c), with S = s J per reference volume."""
        A = self.now["A"](X)
        return np.asarray(self.c.theta_R * A**self.c.Gamma * np.exp(self.now["s"](X) / A))

    def heating(self, X: np.ndarray) -> np.ndarray:
        """sigma_v : grad v + mu |hess v|^p + R |M|^2 + epsilon |v|^4 + div(kappa theta^1.5 grad theta)."""
        c, L, M = self.c, self.L(X), self.mandel(X)
        total = np.sum(self.viscous_stress(X) * L, axis=(-2, -1)) + c.R * np.sum(M * M, axis=(-2, -1))
        if c.mu:
            size = np.sum(self.hyperstress(X) ** 2, axis=(-3, -2, -1))
            total = total + size ** (c.p / (2 * c.p - 2)) * c.mu ** (1 / (1 - c.p))
        total = total + c.damping * np.sum(self.now["v"](X) ** 2, axis=-1) ** 2
        theta = self.temperature
        conducted = self.div(lambda Y: c.kappa * theta(Y)[..., None] ** 1.5 * self.grad(theta)(Y))
        return np.asarray(total + conducted(X))

    def flow_rule(self, X: np.ndarray) -> np.ndarray:
        """The residual |M|(|Pi|) Pi/|Pi| - nu div(|grad Pi|^2 grad Pi) - M, for |Pi| > 0."""
        Pi = self.now["Pi"]
        size = np.linalg.norm(Pi(X), axis=(-2, -1), keepdims=True)
        force = FORCES[self.c.rule](self.c, size) / size * Pi(X)
        return np.asarray(force - self.div(self.flux(Pi, self.c.nu))(X) - self.mandel(X))

    def mandel(self, X: np.ndarray) -> np.ndarray:
        """The Mandel stress M: dev S for E; sym dev(F^T S_F), S_F = 2 G J^{-2/3} F, for F."""
        if self.kind == "linear":
            M = 2 * self.c.G_e * self.now["E"](X)
        else:
            F, J = self.now["F"](X), self.now["J"](X)[..., None, None]
            M = 2 * self.c.G_e * np.swapaxes(F, -1, -2) @ F / J ** (2 / 3)
        return np.asarray(M - _trace(M) / 3 * np.eye(3))

    def kinematics(self, X: np.ndarray) -> dict[str, np.ndarray]:
        """Residuals of the equations of E, or of F and J, and with heat also of A and s."""
        L, c, now = self.L(X), self.c, {name: f(X) for name, f in self.now.items()}
        Pi, tr_L = now["Pi"] if c.nu else c.R * self.mandel(X), np.trace(L, axis1=-2, axis2=-1)
        if self.kind == "linear":
            eps, W, E = (L + np.swapaxes(L, -1, -2)) / 2, (L - np.swapaxes(L, -1, -2)) / 2, now["E"]
            rates = {"E": eps + W @ E - E @ W - Pi}
        else:
            rates = {"F": L @ now["F"] - now["F"] @ Pi, "J": tr_L * now["J"]}
        if self.kind == "with heat":
            heated = self.heating(X) / (c.c * self.temperature(X))
            rates |= {"A": -tr_L * now["A"], "s": heated - tr_L * now["s"]}
        return {
            name: self.transport(name, X) - rate - c.delta_fields * self.div(self.grad(self.now[name]))(X)
            for name, rate in rates.items()
        }

    def viscous_stress(self, X: np.ndarray) -> np.ndarray:
        """The viscous stress K_v tr(eps) I + 2 G_v dev eps."""
        L = self.L(X)
        eps = (L + np.swapaxes(L, -1, -2)) / 2
        spherical = _trace(eps) * np.eye(3)
        return np.asarray(self.c.K_v * spherical + 2 * self.c.G_v * (eps - spherical / 3))

    def hyperstress(self, X: np.ndarray) -> np.ndarray:
        """The hyperstress mu |hess v|^{p-2} hess v, with indices i j k."""
        return self.flux(self.grad(self.now["v"]), self.c.mu, self.c.p)(X)

    def momentum(self, X: np.ndarray) -> np.ndarray:
        rho, v, dim = self.now["rho"], self.now["v"], self.dim
        old = self.old["rho"](X)[..., None] * self.old["v"](X)

        def flux(Y: np.ndarray) -> np.ndarray:
            w = v(Y)
            carried = rho(Y)[..., None, None] * w[..., :, None] * w[..., None, :]
            return np.asarray(carried - (self.stress(Y) + self.viscous_stress(Y))[..., :dim, :dim])

        total = (rho(X)[..., None] * v(X) - old) / self.tau + self.div(flux)(X)
        if self.c.mu:
            total = total + self.div(self.div(self.hyperstress))(X)
        total[..., 1] -= rho(X) * self.c.g
        total = total + self.c.damping * np.sum(v(X) ** 2, axis=-1, keepdims=True) * v(X)
        compensating = self.L(X)[..., :dim, :dim] @ self.diffusive_flux(X)[..., None]
        return np.asarray(total + compensating[..., 0])


def mismatch(c: Coefficients, sources: Sources, kind: str, t: float, mesh: Mesh) -> dict[str, float]:
    """Largest difference of each equation's source at random points, relative to its largest value."""
    dim = sources.dim
    X = np.random.default_rng(7).uniform(0.1, 0.9, (8, dim))
    time.Set(t)
    exact = FiniteDifferences(kind, c, dim, t, sources.tau)
    expected = {"continuity": exact.continuity(X), "momentum": exact.momentum(X), **exact.kinematics(X)}
    given: dict[str, CoefficientFunction] = {
        "continuity": sources.continuity,
        "momentum": sources.momentum,
        **sources.model.material.states(dim).tensors(lambda: sources.kinematics),
    }
    if sources.creep is not None:
        expected["Pi"], given["Pi"] = exact.flow_rule(X), sources.creep
    result = {}
    for name, values in expected.items():
        found = np.array([given[name](mesh(*point)) for point in X]).reshape(values.shape)
        result[name] = float(abs(found - values).max() / abs(values).max())
    return result

"""Bodies at one point in equilibrium of pressure, and of temperature where they have heat.

Bodies with the amounts n_i share the volume J and, with heat, the entropy S, in such a way that their energy
is least. With y_i = J_i or (J_i, S_i),

    W(n, c) = min over y_i with sum n_i y_i = c of  sum n_i psi_i(y_i),      c = 1, or (1, s):

All psi_i'(y_i) equal one multiplier m = -p or (-p, theta).  W is jointly convex, as the minimum of a sum of
perspectives.  By the envelope theorem dW/dn_i = psi_i - m . y_i and dW/dc = m.  With Q = sum n_i psi_i''^-1
we have Q dm = dc - sum y_i dn_i. The second derivative of W is therefore a_k . Q^-1 a_l, where a is -y_i for
n_i and a unit vector for a component of c.

Bodies with heat have psi_i = U_i(J) + u_i(S, J) (``Thermal``) and share the entropy s per actual volume;
dW/ds is their common temperature.  From S_i = c_i (ln(theta/theta_R,i) + g_i(J_i)) follows, at known volumes,

    ln theta = (s + sum n_i c_i (ln theta_R,i - g_i(J_i)))/sum n_i c_i.

If all bodies have the same thermal pressure as a function of (J, theta) and the same U_i'(J), all J_i are 1/N
and W has an expression.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from ngvisco.physics.materials.thermal import Entropy, Thermal

_ITERATIONS = 100
_CONVERGED = 1e-7
"""The iteration ends when a Newton increment, relative to J_i and psi_S/psi_SS, is below this number; the
error is the increment's square."""
_LEAST = 0.2
"""The least factor by which a step multiplies J_i."""

_FLAT = 1e-3
"""The least J_i of a body whose energy is finite at J = 0, and which other bodies may compress."""

Energies = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, ...]]
"""Function of y, (points, bodies, size), and of the points' numbers; returns psi, (points, bodies), psi' and
psi''."""


def equilibrium(
    energies: Energies, n: np.ndarray, total: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """W, its slope and second derivative by n_i and, with heat, by s; and y. W is NaN at points without an
    equilibrium.

    Newton's method finds y_i and m from ``start``, (points, bodies, size), at points where ``start`` is
    finite; n is (points, bodies), and ``total``, (points, size), is c.
    """
    y, shape = start.copy(), (*start.shape, start.shape[2])
    psi, slope, m = np.full(n.shape, np.nan), np.full(y.shape, np.nan), np.full(total.shape, np.nan)
    second, weight = np.full(shape, np.nan), np.full(shape, np.nan)
    done, active = np.zeros(len(n), dtype=bool), np.flatnonzero(np.isfinite(y).all(axis=(1, 2)))
    with np.errstate(all="ignore"):
        for iteration in range(_ITERATIONS):
            if not len(active):
                break
            psi[active], slope[active], second[active] = energies(y[active], active)
            if not iteration:
                m[active] = _sum(n[active], slope[active]) / n[active].sum(axis=1)[:, None]
            weight[active] = _compliance(y[active], slope[active] - m[active, None], second[active])
            active = active[~done[active]]
            at, amounts, inverse = y[active], n[active], weight[active]
            defect = m[active, None] - slope[active]
            missing = total[active] - _sum(amounts, at + _times(inverse, defect))
            dm = _times(_inverse(_sum(np.maximum(amounts, 0.0), inverse)), missing)
            step, sizes = _times(inverse, defect + dm[:, None]), at.copy()
            curvatures = np.diagonal(second[active], axis1=2, axis2=3)
            sizes[..., 1:] = (slope[active] / curvatures)[..., 1:]  # psi_S = theta is like exp(S/c)
            lowest = np.maximum(_LEAST * at[..., 0], _FLAT) - at[..., 0]
            length = np.where(step[..., 0] < lowest, lowest / step[..., 0], 1.0).min(axis=1)
            length = np.minimum(length, (sizes / abs(step))[..., 1:].min(axis=(1, 2), initial=1.0))
            y[active] = at + length[:, None, None] * step
            m[active] += length[:, None] * dm
            done[active] = (abs(step) <= _CONVERGED * sizes).all(axis=(1, 2)) & (length == 1)
            active = active[np.isfinite(y[active]).all(axis=(1, 2)) & np.isfinite(m[active]).all(axis=1)]
        Q = _sum(n, weight)
        good = done & (Q[:, 0, 0] > 0) & (np.linalg.det(Q) > 0)
        of_shared = np.broadcast_to(np.eye(y.shape[2])[1:], (len(n), y.shape[2] - 1, y.shape[2]))
        a = np.concatenate([-y, of_shared], axis=1)
        hessian = np.einsum("pki,pij,plj->pkl", a, np.where(good, _inverse(Q).T, np.nan).T, a)
        slopes = np.concatenate([psi - (m[:, None] * y).sum(axis=2), m[:, 1:]], axis=1)
    W = np.where(good, (n * psi).sum(axis=1), np.nan)
    return W, np.where(good[:, None], slopes, np.nan), hessian, y


def _compliance(y: np.ndarray, excess: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The inverses psi''^-1; a volume at its lower bound, where psi_J > m, has zeros."""
    compliance = _inverse(second)
    held = (y[..., 0] <= _FLAT) & (excess[..., 0] > 0)
    compliance[held, 0], compliance[held, :, 0] = 0.0, 0.0
    compliance[held, 1:, 1:] = 1 / second[held, 1:, 1:]
    return compliance


def _inverse(A: np.ndarray) -> np.ndarray:
    """Inverses of symmetric 1x1 or 2x2 matrices, (..., size, size)."""
    if A.shape[-1] == 1:
        return 1 / A
    return A[..., ::-1, ::-1] * np.array([[1, -1], [-1, 1]]) / np.linalg.det(A)[..., None, None]


def _sum(n: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The sums of n_i values_i over the bodies; ``values`` are (points, bodies, ...)."""
    return np.einsum("pb,pb...->p...", n, values)


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.einsum("...ij,...j->...i", A, x)


_SAME = 1e-9
"""Relative difference below which two thermal pressures count as one function."""


@dataclass(frozen=True)
class MixedHeat:
    """Thermal energies of bodies at one temperature."""

    parts: Mapping[str, Thermal]
    """Materials by the bodies' names, all with the same unit of entropy."""

    @property
    def entropy(self) -> Entropy:
        """The carried entropy, a variable."""
        return next(iter(self.parts.values())).entropy

    @cached_property
    def has_one_pressure(self) -> bool:
        """Whether all bodies have the same thermal pressure as a function of J and theta."""
        J, theta = np.meshgrid([0.5, 1.0, 2.0], [1.0, 300.0])
        first, *pressures = (part.pressure(theta, J) for part in self.parts.values())
        return all(abs(pressure - first).max() <= _SAME * abs(first).max() for pressure in pressures)

    @property
    def reference_temperature(self) -> float | None:
        """The theta_R, K, that all bodies have; None if they differ."""
        temperatures = {part.theta_R for part in self.parts.values()}
        return temperatures.pop() if len(temperatures) == 1 else None

    def capacity(self, n: Mapping[str, Any]) -> Any:
        """The heat capacity sum n_i c_i of all bodies, J/(m^3 K)."""
        return reduce(add, (part.c * n[name] for name, part in self.parts.items()))

    def total(self, n: Mapping[str, Any], log_theta: Any, J: Any) -> Any:
        """The carried entropy where all bodies have the volume J and the temperature exp(``log_theta``)."""
        parts = (n[name] * part.entropy_of(log_theta, J) for name, part in self.parts.items())
        return 1 / self.entropy.unit * reduce(add, parts)

    def entropies(self, n: Mapping[str, Any], s: Any, J: Any) -> dict[str, Any]:
        """S_i by the bodies' names, in the unit of s = sum n_i S_i, where all bodies have the volume J."""
        unit = self.entropy.unit
        log_theta = unit / self.capacity(n) * (s - self.total(n, 0.0, J))
        return {name: 1 / unit * part.entropy_of(log_theta, J) for name, part in self.parts.items()}

    def energy(self, body: str, S: Any, J: Any) -> Any:
        """The thermal energy u_i(S, J) of a body, Pa."""
        return J * self.parts[body].of_heat({"A": 1 / J, "s": S / J})

"""Bodies at one point in equilibrium of pressure, and of temperature where they have heat.

Bodies with the amounts n_i share the volume so that its energy is least,

    V(n) = min over J_i with sum n_i J_i = 1 of  sum n_i U_i(J_i)  =  max over p of  sum n_i h_i(p) - p,

h_i(p) = min over J of U_i + p J: U_i'(J_i) = -p for all, one scalar equation in p.  V is convex as a largest
of linear functions.  By the envelope theorem dV/dn_i = U_i + p J_i, and from dp = sum J_i dn_i/sum n_j/U_j''
its second derivative is J_i J_j/sum n_m/U_m''.

With heat the free energies F_i(J, theta) take the place of U_i, and the entropy s is shared too:

    W(n, s) = max over p, theta of  theta s - p + sum n_i G_i(p, theta),   G_i = min over J of F_i + p J,

two equations, sum n_i J_i = 1 and sum n_i S_i = s.  dW/dn_i = G_i, dW/ds = theta, the second derivative is
a_k . Q^-1 a_l with a_i = (J_i, -S_i), a_s = (0, 1), and Q = -sum n_i G_i'' by (p, theta).
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

_ITERATIONS = 100
_CONVERGED = 1e-7
"""Relative increment of all J_i at which one more Newton step, whose error is its square, is the last."""
_LEAST = 0.2
"""What a step leaves of J_i, at least."""

_FLAT = 1e-3
"""The least J_i: a body whose energy is finite at J = 0 gives way to the pressure of another no further."""

Volumetric = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""U, U' and U'' of values J at points of these numbers."""


class FreeEnergy(Protocol):
    """The part that heat has in a body's free energy, F = U(J) + ... (``Thermal``)."""

    @property
    def c(self) -> float: ...

    def free(self, theta: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, ...]: ...


def equilibrium(
    volumetric: Sequence[Volumetric],
    n: np.ndarray,
    heat: Sequence[FreeEnergy] = (),
    s: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V, its slope and second derivative by amounts (points, bodies); NaN where there is none.

    With ``heat`` of every body W, and by the entropy s, J/(m^3 K), last.  Newton's method for J_i, p and
    ln theta, in which S_i is linear; without heat theta stays one.
    """
    points, bodies = n.shape
    s = np.zeros(points) if s is None else s
    c, is_cold = np.array([each.c for each in heat] or np.zeros(bodies)), not heat
    total, capacity = n.sum(axis=1), n @ c + is_cold
    p, log_theta = np.full(points, np.nan), np.zeros(points)
    done = np.zeros(points, dtype=bool)
    # F, F_J, F_JJ, S and dS/dJ of the bodies
    found = np.full((5, points, bodies), np.nan)
    found[3:] = 0.0 if is_cold else np.nan
    with np.errstate(all="ignore"):
        J = np.repeat(1 / total[:, None], bodies, axis=1)
        active = np.flatnonzero((total > 0) & (capacity > 0) & np.isfinite(n).all(axis=1) & np.isfinite(s))
        if heat:  # of 1 K, linear in its logarithm
            at_one = np.stack([each.free(np.ones(points), J[:, 0])[3] for each in heat], axis=1)
            log_theta = (s - (n * at_one).sum(axis=1)) / capacity
        for iteration in range(_ITERATIONS):
            if not len(active):
                break
            at, theta = J[active], np.exp(log_theta[active])
            for i, one in enumerate(volumetric):
                found[:3, active, i] = one(at[:, i], active)
            for i, warm in enumerate(heat):
                of_heat = np.stack(warm.free(theta, at[:, i]))
                found[:3, active, i] += of_heat[:3]
                found[3:, active, i] = of_heat[3:]
            if not iteration:
                p[active] = -(n[active] * found[1, active]).sum(axis=1) / total[active]
            active = active[~done[active]]
            at, amounts, theta = J[active], n[active], np.exp(log_theta[active])
            _, first, second, S, dS = found[:, active]
            rest = first + p[active][:, None]
            weight = ((at > _FLAT) | (rest <= 0)) / second
            kept = np.maximum(amounts, 0.0)
            soft, volume = (kept * weight).sum(axis=1), (amounts * (at - weight * rest)).sum(axis=1) - 1
            dp, dl = volume / soft, 0.0 * soft
            if heat:
                b = theta[:, None] * dS
                mixed = -(kept * weight * b).sum(axis=1)
                warm_up = (kept * (theta[:, None] * c + weight * b * b)).sum(axis=1)
                entropy = theta * s[active] - (amounts * (theta[:, None] * S - weight * b * rest)).sum(axis=1)
                determinant = soft * warm_up - mixed**2
                dp = (warm_up * volume - mixed * entropy) / determinant
                dl = (soft * entropy - mixed * volume) / determinant
                rest -= b * dl[:, None]
            step = -weight * (rest + dp[:, None])
            farthest = np.maximum(_LEAST * at, _FLAT) - at
            length = np.where(step < farthest, farthest / step, 1.0).min(axis=1)
            length = np.minimum(length, 1 / np.maximum(abs(dl), 1.0))
            J[active] = at + length[:, None] * step
            p[active] += length * dp
            log_theta[active] += length * dl
            small = (abs(step) <= _CONVERGED * at).all(axis=1) & (abs(dl) <= _CONVERGED)
            done[active] = small & (length == 1)
            active = active[np.isfinite(J[active]).all(axis=1) & np.isfinite(log_theta[active])]
        theta = np.exp(log_theta)
        F, first, second, S, dS = found
        weight = ((J > _FLAT) | (first + p[:, None] <= 0)) / second
        # the entries of Q
        soft, mixed = (n * weight).sum(axis=1), -(n * weight * dS).sum(axis=1)
        warm_up = (n * (c / theta[:, None] + weight * dS * dS)).sum(axis=1) + is_cold
        determinant = soft * warm_up - mixed**2
        good = done & (determinant > 0) & (soft > 0)
        value, slope, a = (n * F).sum(axis=1) + theta * s, F + p[:, None] * J, np.stack([J, -S])
        if heat:
            slope = np.concatenate([slope, theta[:, None]], axis=1)
            a = np.concatenate([a, np.broadcast_to([[[0.0]], [[1.0]]], (2, points, 1))], axis=2)
        inverse = np.array([[warm_up, -mixed], [-mixed, soft]]) / np.where(good, determinant, np.nan)
    hessian = np.einsum("apk,abp,bpl->pkl", a, inverse, a)
    return np.where(good, value, np.nan), np.where(good[:, None], slope, np.nan), hessian

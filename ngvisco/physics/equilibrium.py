"""Bodies at one point in equilibrium of pressure.

Bodies with the amounts n_i share the volume so that its energy is least,

    V(n) = min over J_i with sum n_i J_i = 1 of  sum n_i U_i(J_i)  =  max over p of  sum n_i h_i(p) - p,

h_i(p) = min over J of U_i + p J: U_i'(J_i) = -p for all, one scalar equation in p.  V is convex as a largest
of linear functions.  By the envelope theorem dV/dn_i = U_i + p J_i, and from dp = sum J_i dn_i/sum n_j/U_j''
its second derivative is J_i J_j/sum n_m/U_m''.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

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


def equilibrium(volumetric: Sequence[Volumetric], n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V, its slope and its second derivative by amounts (points, bodies); NaN where there is none."""
    points, bodies = n.shape
    with np.errstate(all="ignore"):
        J = np.repeat(1 / n.sum(axis=1, keepdims=True), bodies, axis=1)
        p, done, U = (
            np.full(points, np.nan),
            np.zeros(points, dtype=bool),
            np.full((3, points, bodies), np.nan),
        )
        active = np.flatnonzero((n.sum(axis=1) > 0) & np.isfinite(n).all(axis=1))
        for iteration in range(_ITERATIONS):
            if not len(active):
                break
            at, amounts = J[active], n[active]
            found = [one(at[:, i], active) for i, one in enumerate(volumetric)]
            now = np.stack([np.stack(one) for one in found], axis=2)
            U[:, active] = now
            if not iteration:
                p[active] = -(amounts * now[1]).sum(axis=1) / amounts.sum(axis=1)
            finished = done[active]
            active, at, amounts, now = (a[~finished] for a in (active, at, amounts, np.moveaxis(now, 1, 0)))
            rest = now[:, 1] + p[active][:, None]
            free = (at > _FLAT) | (rest <= 0)
            weight = free / now[:, 2]
            stiffness = (np.maximum(amounts, 0.0) * weight).sum(axis=1)
            change = ((amounts * (at - weight * rest)).sum(axis=1) - 1) / stiffness
            step = -weight * (rest + change[:, None])
            farthest = np.maximum(_LEAST * at, _FLAT) - at
            length = np.where(step < farthest, farthest / step, 1.0).min(axis=1)
            J[active] = at + length[:, None] * step
            p[active] += length * change
            done[active] = (abs(step) <= _CONVERGED * at).all(axis=1) & (length == 1)
            active = active[np.isfinite(J[active]).all(axis=1)]
        compliance = (n * ((J > _FLAT) | (U[1] + p[:, None] <= 0)) / U[2]).sum(axis=1)
        good = done & (compliance > 0)
        value = np.where(good, (n * U[0]).sum(axis=1), np.nan)
        slope = np.where(good[:, None], U[0] + p[:, None] * J, np.nan)
        hessian = J[:, :, None] * J[:, None, :] / np.where(good, compliance, np.nan)[:, None, None]
    return value, slope, hessian

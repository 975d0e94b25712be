"""Derivatives of rates and elastic force at the points of a coarse rule.

For an increment X = (grad dv, dPi) the fields follow at every point, neither convected nor carried through
facets, as

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep)/dz,

and with the elastic force zeta : rate(z; X) that makes the point's stiffness
C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX), not symmetric where there is stress or
creep.
"""

from __future__ import annotations

import numpy as np

from ngvisco.solver.split.operators import Conjugation, Operators
from ngvisco.solver.split.transport import Transport


class PointTangent:
    """Values and derivatives at the points of the coarse rule, at the present state."""

    def __init__(self, transport: Transport, operators: Operators) -> None:
        self.t, self.op = transport, operators
        self.conjugation = Conjugation(transport.step, operators.points)

    def update(self) -> None:
        """Form K's resolvent, d rate/dX and the force's derivative at the present state."""
        t, op, rates = self.t, self.op, self.t.rates
        tau, g = t.context.tau.Get(), rates.gradients
        self.z, self.zeta, self.v = op.z(t.z), op.z(t.zeta), op.v(t.v)
        self.L = op.velocity_gradient(t.v)
        slopes = self._second_derivative()  # (points, n, n)
        columns = rates.columns(self.z)  # (points, n, X)
        K = np.einsum("xnm,xp->pnm", rates.linear[:g], self.L, optimize=True)
        stress_slope = np.einsum("xnm,np->pxm", rates.linear, self.zeta, optimize=True)
        # d(zeta : rate)/dX in z: what the elastic force and the Mandel stress take from dz
        force = stress_slope + np.einsum("pnx,pnm->pxm", columns, slopes, optimize=True)
        # -(w . grad z) : zeta with its share of the facets is  phi'(z) : dz div w  to leading order
        for i in range(t.step.mesh.dim):
            force[:, i * (t.step.mesh.dim + 1)] += self.zeta.T
        if t.mobility is not None:
            by_Pi = columns[:, :, g:]
            Pi = t.mobility(np.einsum("np,pnx->xp", self.zeta, by_Pi, optimize=True), self.zeta)
            K += np.einsum("xnm,xp->pnm", rates.linear[g:], Pi, optimize=True)
            K -= t.mobility.of_mandel * by_Pi @ force[:, g:]
            if t.mobility.of_conjugates is not None:
                K += by_Pi @ (t.mobility.of_conjugates @ slopes)
        self.resolvent = np.linalg.inv(np.eye(t.n)[None] - tau * K)
        self.force, self.columns = force, columns
        self.dz = op.gradients(op.dz, t.z)

    def stiffness(self) -> np.ndarray:
        """C of the module's docstring, (points, X, X)."""
        return self.t.context.tau.Get() * self.force @ (self.resolvent @ self.columns)

    def _second_derivative(self) -> np.ndarray:
        """phi'' by one-sided differences of phi', (points, n, n)."""
        n, step = self.t.n, 1e-6
        result = np.empty((self.op.points.count, n, n))
        slope, shifted = self.conjugation(self.z), self.z.copy()
        for m in range(n):
            size = step * (1 + abs(self.z[m]).max())
            shifted[m] += size
            result[:, :, m] = ((self.conjugation(shifted) - slope) / size).T
            shifted[m] = self.z[m]
        return result

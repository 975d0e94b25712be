"""Derivatives of rates and elastic force at the points of a coarse rule.

For an increment X = (grad dv, dPi) the fields follow at every point, neither convected nor carried through
facets, as

    dz = tau (1 - tau K)^{-1} (d rate/dX) X,    K = d(rate + creep + terms of z)/dz,

and with the elastic force zeta : rate(z; X) that makes the point's stiffness
C = tau (zeta : T + (d rate/dX)^T phi'') (1 - tau K)^{-1} (d rate/dX), not symmetric where there is stress or
creep.
"""

from __future__ import annotations

import numpy as np

from ngvisco.physics.increments import TINY
from ngvisco.reduced.evaluation import CellTerms, with_values
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.reduced.slope import PointwiseSlope


class PointTangent:
    """Values and derivatives at the points of the coarse rule, at an evaluation."""

    def __init__(self, residual: ReducedResidual, operators: Operators) -> None:
        self.residual, self.op, self.components = residual, operators, residual.step.layout.states.size
        self.terms = CellTerms(residual.step, operators, residual.rates)
        self.others = residual.claims.of_fields()
        self.slope = PointwiseSlope(residual.step, operators.points)

    def update(self, at: Evaluation) -> None:
        """Form K's resolvent, d rate/dX and the force's derivative."""
        step, rates = self.residual.step, self.residual.rates.tensors
        self.tau, g = step.context.tau.Get(), rates.gradients
        self.values = u = self.terms.fields(at.coefficients)
        self.z, self.zeta = u.z.value, u.zeta.value
        self.L = u.grad_v.value.reshape(g, self.op.points.count)
        slopes = self._second_derivative()  # (points, n, n)
        columns = rates.columns(self.z)  # (points, n, X)
        K = np.einsum("xnm,xp->pnm", rates.linear[:g], self.L, optimize=True)
        stress_slope = np.einsum("xnm,np->pxm", rates.linear, self.zeta, optimize=True)
        # d(zeta : rate)/dX in z: what the elastic force and the Mandel stress take from dz
        force = stress_slope + np.einsum("pnx,pnm->pxm", columns, slopes, optimize=True)
        # -(w . grad z) : zeta with its share of the facets is  phi'(z) : dz div w  to leading order
        for i in range(step.mesh.dim):
            force[:, i * (step.mesh.dim + 1)] += self.zeta.T
        rule = self.residual.rates.rule
        if rule is not None and rule.is_local:
            of_mandel, of_conjugates, of_z = self.residual.rates.creep_slopes(u)
            Pi = self.residual.rates.creep_components(u)
            K += np.einsum("xnm,xp->pnm", rates.linear[g:], Pi, optimize=True)
            if rule.reads_conjugate or rule.reads_pressure:
                of_z = of_z + of_conjugates @ slopes
            K += columns[:, :, g:] @ (of_z - of_mandel @ force[:, g:])
            self.creep_rate, self.creep_slope = Pi, of_mandel
        for m in range(self.components if self.others else 0):
            changed = self.z.astype(complex)
            changed[m] += 1j * TINY
            slots = self.terms.slots(self.others, with_values(u, z=changed))
            K[:, :, m] -= slots["z"].imag.T / TINY
        self.rate_slope = K
        self.resolvent = np.linalg.inv(np.eye(self.components)[None] - self.tau * K)
        self.force, self.columns = force, columns
        self.dz = u.grad_z.value

    def stiffness(self) -> np.ndarray:
        """C of the module's docstring, (points, X, X)."""
        return self.tau * self.force @ (self.resolvent @ self.columns)

    def _second_derivative(self) -> np.ndarray:
        """phi'' by one-sided differences of phi', (points, n, n)."""
        n, step = self.components, 1e-6
        result = np.empty((self.op.points.count, n, n))
        slope, shifted = self.slope(self.z), self.z.copy()
        for m in range(n):
            size = step * (1 + abs(self.z[m]).max(initial=0.0))
            shifted[m] += size
            result[:, :, m] = ((self.slope(shifted) - slope) / size).T
            shifted[m] = self.z[m]
        return result

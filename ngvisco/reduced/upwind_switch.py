"""What an increment of v does where the flow through a facet is about to turn round.

There n^- = (1 - sigma(v . n))/2 changes at once, and with it the upwind trace and the elastic force, by
[z] : [zeta] across the width of sigma, which may be more than what the facet's inertia opposes; elsewhere
the change is of the order of the jumps and is left out.

With B_h used twice (FORMULATION.md, Section 4) what upwinding takes from stored energy is given back to v:
[z] : [zeta]/2 > 0 times |v . n| drives the flow through a facet, a friction of the wrong sign.  Within the
width of sigma it grows with v . n faster than inertia opposes, the problem folds, and Newton's method, whose
matrix is indefinite there, goes to and fro about the middle one of three solutions.  So where v . n still
changes by much the derivative is taken smaller, as the Hessian of a function that is not convex: increments
then lead out of the jump.  Near a solution it is Newton's.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra.sparse import together
from ngvisco.forms.upwinding import Upwinding, mean_share
from ngvisco.physics.arrays import Array, derivatives
from ngvisco.reduced.residual import Evaluation, ReducedResidual

_TURNS = 1e-6
"""n^- (1 - n^-) below which n^- is 0 or 1: |v . n| is 500 times the width of sigma there, and the slope of
n^- 1e-8 of its largest."""
_MOVED = 0.3
"""Change of v . n from one iterate to the next, in units of |v . n|_eta, above which a facet is far from its
solution; with 1 a load that is released takes a tenth more iterations."""


class UpwindSwitchJacobian:
    """The derivative by v of the elastic force and of the fields' rows, on the facets that count."""

    def __init__(self, residual: ReducedResidual, share: float) -> None:
        """``share`` of a cell's inertia rho h/tau, in the force by v . n, from which a facet counts."""
        self.residual, self.op, self.mass = residual, residual.side_op, residual.trace_mass
        self.share = share
        self._shapes = abs(self.op.z.blocks).max(axis=(0, 1), initial=0.0)  # of each function there
        self._area = self.mass.summed(self.op.points.weights)
        dim = residual.step.mesh.dim
        self._own_share = 1 / (dim * (dim + 1))
        """Of rho h for each area: a cell's volume is h area/dim, and it has dim + 1 sides."""

    def update(self, at: Evaluation) -> None:
        """Linearise at an evaluation."""
        op, weights, upwinding = self.op, self.op.points.weights, at.facets.upwinding
        z, zeta = at.coefficients["z"], at.coefficients["zeta"]

        through, inflow = upwinding.through.value, upwinding.inflow.value
        slope = np.zeros(through.shape)  # of n^- by v . n
        (turning,) = np.nonzero(inflow * (1 - inflow) > _TURNS)
        if turning.size:
            a, eta = Array(through[turning]), at.facets.context.eta
            (slope[turning],) = derivatives(Upwinding(a, Array(op.inner[turning]), eta).inflow, [a])
        jump = at.facets.z_jump.value
        # the jump of z is what both sides together are away from its trace
        summed = self.mass.summed
        z_jump = summed(weights * np.linalg.norm(jump, axis=0))
        inertia = self.residual.step.context.rate(summed(weights * abs(at.facets.rho.value) * op.h))
        # of the force, slope * z_jump * the jump of zeta, the last is formed only where the others are large
        force = abs(slope) * z_jump
        possible = force * self._largest(zeta) > self.share * inertia
        (near,) = np.nonzero(summed(possible))
        self.exists = near.size > 0
        if not self.exists:
            return
        force = force[near] * np.linalg.norm(self._from_mean(zeta, near), axis=0)
        force = summed(weights[near] * force, near) / self._area[near]
        where = near[force > self.share * inertia[near]]
        self.exists = where.size > 0
        if not self.exists:
            return
        self._slope, self._weights, self._normals = slope[where], weights[where], op.points.normals[:, where]
        self._v, self._z, hat = op.v.matrix[where], op.z.matrix[where], op.hat.matrix[where]
        self._v_t, self._z_t = self._v.T.tocsr(), self._z.T.tocsr()
        # of both sides, and of both ranks' at a shared facet
        unknowns = self.mass.unknowns[np.unique(self.mass.facet[where])].ravel()
        self._from_trace = (hat @ self.mass.inverse[:, unknowns]).tocsr()
        self._to_trace = (hat[:, unknowns].T @ sp.diags(self._weights)).tocsr()
        self._traces = self.mass.exchange.part(unknowns)
        self._values, self._zeta = together(self._z, z), together(self._z, zeta)
        self._jump, self._inflow = jump[:, where], inflow[where]
        self._carried = upwinding.carried.value[where]
        self._normal_velocity = upwinding.normal_velocity.value[where]
        self._conserved = self.residual.step.layout.states.conserved
        self._limit(at, self._own_share * inertia[where], where)
        self._carried_slope = self._inflow + through[where] * self._slope

    def _limit(self, at: Evaluation, largest: np.ndarray, where: np.ndarray) -> None:
        """Let no facet that is far from its solution be driven by more than ``largest``, its own inertia.

        Both are derivatives of a force by v . n, at the points ``where``.
        """
        # z_hat - z = n^- [z] where n^- is constant: the slope of n^- (z_hat - z), and of z_hat, by n^-
        by_inflow = np.where(self._conserved[:, None], 1 / np.maximum(self._inflow, _TURNS), 2.0)
        driving = self._slope * (by_inflow * self._jump * self._zeta).sum(axis=0)
        driven = self.mass.summed(self._weights * driving, where)
        if at.moved is not None:
            far = at.moved[where] > _MOVED * at.facets.upwinding.modulus.value[where]
            driven = np.where(self.mass.summed(far.astype(float), where) > 0, driven, 0.0)
        self._slope *= largest / np.maximum(driven, largest)

    def _from_mean(self, zeta: np.ndarray, where: np.ndarray) -> np.ndarray:
        """How far zeta is from the means of both sides, on the boundary from itself, (n, points there).

        ``where`` are all the sides' points of some facets.
        """
        values = self.op.z.at(where, zeta)
        shares = self.op.points.weights[where] * mean_share(self.op.inner[where])
        return values - self.mass.fitted(values, shares, where)

    def _largest(self, zeta: np.ndarray) -> float:
        """A bound of |zeta - its mean| on facets, from coefficients."""
        z = self.op.z
        sizes = abs(zeta).reshape(len(zeta), z.cells, z.local) @ self._shapes
        return 2 * float(np.linalg.norm(sizes, axis=0).max(initial=0.0))

    def __call__(self, dv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows of v (dim, .) and of z (n, .), the latter with the sign that they have in the residual."""
        through = (self._normals * together(self._v, dv)).sum(axis=0)
        inflow = self._slope * through
        loads = self._traces.sum(together(self._to_trace, inflow * self._values))
        trace = -together(self._from_trace, loads)
        carried = inflow * self._jump + self._inflow * trace
        fields = self._carried_slope * through * self._jump + self._carried * trace
        of_flux = self._conserved  # which is v . n times the trace
        carried[of_flux] = trace[of_flux]
        fields[of_flux] = through * self._jump[of_flux] + self._normal_velocity * trace[of_flux]
        density = -(carried * self._zeta).sum(axis=0)
        force = together(self._v_t, self._weights * density * self._normals)
        return force, together(self._z_t, self._weights * fields)

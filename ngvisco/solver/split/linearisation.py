"""The derivative of the split solver's residual in a direction of its unknowns: the whole of Newton's matrix.

``FlowOperator``, which every increment is solved with, takes a coarser rule, a fixed number of sweeps and
of the upwinding only what turns round; here nothing is left out.  What is an explicit function of
(v, a, rho, z) changes with these: traces, conjugates, creep, the hyperviscosity's local unknowns.  The rows
are those of ``Transport``, ``Momentum`` and ``MatrixHyperviscosity``, term by term.
"""

from __future__ import annotations

import numpy as np

from ngvisco.physics.model import CentralGravity, Gravity
from ngvisco.solver.split.claims import DENSITY
from ngvisco.solver.split.facet_changes import FacetChanges
from ngvisco.solver.split.hyper import MatrixHyperviscosity
from ngvisco.solver.split.hyper_derivative import HyperDerivative
from ngvisco.solver.split.momentum import Momentum
from ngvisco.solver.split.operators import apply
from ngvisco.solver.split.preconditioner import Residual
from ngvisco.solver.split.subsystem import Subsystem
from ngvisco.solver.split.unknowns import Unknowns


class Linearisation:
    """The derivative at the state of the last ``update``."""

    def __init__(self, momentum: Momentum, hyper: MatrixHyperviscosity | None, unknowns: Unknowns) -> None:
        self.m, self.t, self.op, self.u = momentum, momentum.transport, momentum.op, unknowns
        self.facets = FacetChanges(self.t.facets)
        self.hyper = None if hyper is None else HyperDerivative(hyper, exact=True)
        step = momentum.step
        self._density = None
        if self.t.density is not None:
            terms = [t for t in step.terms if type(t) in DENSITY]
            self._density = Subsystem(step, ["v", *unknowns.density], terms)

    def update(self) -> None:
        """Linearise at the present state, whose residual has just been evaluated."""
        t, op = self.t, self.op
        self._curvature = t.conjugation.derivative(t.z_q)
        self._rho = op.z(t.rho)
        self.facets.update(t.z)
        if self.hyper is not None:
            self.hyper.update()
        self._flow_rows = None if self.m.by_forms is None else self.m.by_forms.jacobian()
        self._flux, self._Pi = self.m.mass_flux(self._rho, t.v_q, op), t.creep()
        if self._density is not None:
            self._density_rows = self._density.jacobian()[t.v.size :]

    def __call__(self, d: np.ndarray) -> Residual:
        """Rows of the direction ``d``, packed as the unknowns are."""
        t, op, u = self.t, self.op, self.u
        dv, drho, dz = (d[u.slices[n]].reshape(x.shape) for n, x in (("v", t.v), ("rho", t.rho), ("z", t.z)))
        self.facets.set(dv, dz)
        self._v, self._L = op.v(dv), op.velocity_gradient(dv)
        self._z, self._dz = op.z(dz), op.gradients(op.dz, dz)
        zeta = t.inverse_mass(op.z.test(self._curvature(self._z)))
        self._zeta = op.z(zeta)
        density = self._of_density(d, dv, drho)
        flow = np.zeros(self.m.rows) if self._flow_rows is None else self._flow_rows @ d[u.flow_slice]
        if t.Pi is not None:  # its equation takes the Mandel stress of z and zeta
            flow[-t.Pi.size :] += t.creep_values.test(self._against_creep()).ravel()
        of_v = flow[: dv.size].reshape(dv.shape)
        of_v += self._of_momentum(op.z(drho), np.stack([D(drho) for D in op.dz]))
        of_v += self.facets.elastic_force(t.zeta, zeta)
        normals = None
        if self.hyper is not None:
            x = np.concatenate([dv, d[u.normal_slice].reshape(len(dv), -1)], axis=1)
            rows = self.hyper(x)
            of_v += rows[:, : dv.shape[1]]
            normals = rows[:, dv.shape[1] :]
        return Residual(flow, normals, density, self._of_fields(d, dz))

    def _of_density(self, d: np.ndarray, dv: np.ndarray, drho: np.ndarray) -> np.ndarray:
        t, op = self.t, self.op
        if self._density is not None:
            return self._density_rows @ np.concatenate([dv.ravel(), d[self.u.density_slice]])
        rows = t.mass @ t.context.rate(drho) + self.facets.density(drho)
        change = op.z(drho)
        for j, D in enumerate(op.dz):
            rows -= D.test(change * t.v_q[j] + self._rho * self._v[j])
        return rows

    def _of_fields(self, d: np.ndarray, dz: np.ndarray) -> np.ndarray:
        t, op, rates = self.t, self.op, self.t.rates
        r = -t.context.rate(self._z)
        X, change, Pi = t.L_q, self._L, self._Pi
        if Pi is not None:
            X, change = np.concatenate([X, Pi]), np.concatenate([change, self._creep(d)])
        rates.rate(t.z_q, change, r)
        rates.rate(self._z, X, r, constant=False)
        for j in range(len(t.v_q)):
            r -= self._dz[:, j] * t.v_q[j] + t.dz_q[:, j] * self._v[j]
        rows = self.facets.fields() - op.z.test(r)
        return rows if t.diffusion is None else rows + apply(t.diffusion, dz)

    def _creep(self, d: np.ndarray) -> np.ndarray:
        t = self.t
        if t.Pi is not None:
            return t.creep_values(d[self.u.slices["Pi"]].reshape(t.Pi.shape))
        assert t.mobility is not None
        return t.mobility(self._against_creep(), self._zeta)

    def _against_creep(self) -> np.ndarray:
        """Of d(zeta : rate)/dPi, the negative Mandel stress, (components of Pi, points)."""
        t, rates = self.t, self.t.rates
        M = np.zeros((len(rates.constant) - rates.gradients, self.op.points.count))
        rates.stress(t.z_q, self._zeta, M, first=rates.gradients)
        rates.stress(self._z, t.zeta_q, M, first=rates.gradients, constant=False)
        return M

    def _of_momentum(self, drho: np.ndarray, dgrad_rho: np.ndarray) -> np.ndarray:
        """Rows of v of what acts at the cells' points, (dim, .)."""
        m, t, op = self.m, self.t, self.op
        d, v, L, dv, dL, rho = m.dim, t.v_q, t.L_q, self._v, self._L, self._rho
        value = t.context.rate(0.5 * drho * v + (rho - 0.5 * (rho - m.rho_old_q)) * dv)
        flux, change = self._flux, self._of_mass_flux(drho, dgrad_rho)
        gradient = np.zeros((d * d, op.points.count))
        for i in range(d):
            for j in range(d):
                value[i] += 0.5 * (dL[i * d + j] * flux[j] + L[i * d + j] * change[j])
                gradient[i * d + j] -= 0.5 * (dv[i] * flux[j] + v[i] * change[j])
        for j in range(d):
            value[j] -= np.einsum("np,np->p", self._zeta, t.dz_q[:, j])
            value[j] -= np.einsum("np,np->p", t.zeta_q, self._dz[:, j])
        t.rates.stress(t.z_q, self._zeta, gradient)
        t.rates.stress(self._z, t.zeta_q, gradient, constant=False)
        if m.stokes is not None:
            gradient += m.stokes @ dL
        for load, values in m.loads:
            if isinstance(load, (Gravity, CentralGravity)):
                value -= drho * values.vec.FV().NumPy().reshape(d, -1)
        rows = op.v.test(value)
        for j, D in enumerate(op.dv):
            rows += D.test(gradient[j::d])
        return rows

    def _of_mass_flux(self, drho: np.ndarray, dgrad_rho: np.ndarray) -> np.ndarray:
        """Of K(rho) rho v + delta |grad rho|^{r-2} grad rho, (dim, points)."""
        t, rho, v = self.t, self._rho, self.t.v_q
        law = t.step.model.regularisation
        if law is None:
            return drho * v + rho * self._v
        K = law.cut_off_values(rho)
        change = (K + law.cut_off_slope(rho) * rho) * drho * v + K * rho * self._v
        if law.delta_density > 0:
            gradient = np.stack([D(t.rho) for D in self.op.dz])
            square, mixed = ((gradient * g).sum(axis=0) for g in (gradient, dgrad_rho))
            change += law.diffusivity(square) * dgrad_rho
            change += 2 * law.diffusivity_slope(square) * mixed * gradient
        return change

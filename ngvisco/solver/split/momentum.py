"""Rows of the momentum equation: at the cells' points, and by forms what acts on facets and walls."""

from __future__ import annotations

import numpy as np
from ngsolve import CF

from ngvisco.forms.system import Step
from ngvisco.physics.model import CentralGravity, Gravity, as_vector
from ngvisco.physics.tensors import embed_gradient, sym
from ngvisco.solver.split.claims import flow_terms
from ngvisco.solver.split.operators import Operators
from ngvisco.solver.split.subsystem import Subsystem
from ngvisco.solver.split.transport import Transport
from ngvisco.solver.split.unknowns import Unknowns


class Momentum:
    """R(u; w) for tests of the flow's unknowns, without the hyperviscosity, given the fields."""

    def __init__(self, step: Step, transport: Transport, unknowns: Unknowns) -> None:
        self.step, self.transport, self.op = step, transport, transport.op
        self.dim, self.context = step.mesh.dim, step.context
        self.stokes = self._viscosity_matrix()
        others = flow_terms(step)
        self.by_forms = Subsystem(step, unknowns.flow, others) if others else None
        self.rows = unknowns.flow_slice.stop
        self.loads = [(load, self.op.points.function(self.dim)) for load in step.model.loads]

    def _viscosity_matrix(self) -> np.ndarray | None:
        """D as a matrix for the entries of grad v, (dim^2, dim^2), Pa s."""
        law, dim = self.step.model.viscosity, self.dim
        if law is None:
            return None
        points = self.op.points
        out = points.function(9)
        columns = []
        for unit in np.eye(dim * dim):
            L = embed_gradient(CF(tuple(unit), dims=(dim, dim)), dim)
            out.Interpolate(law.stress(sym(L)).Reshape((9,)))
            stress = out.vec.FV().NumPy().reshape(9, -1)[:, 0].reshape(3, 3)
            columns.append(stress[:dim, :dim].ravel())
        return np.array(columns).T

    def start(self) -> None:
        """What is known through a step: old momentum and density, and the averaged loads, at the points."""
        self.momentum_old_q = self.op.points.read(self.step.momentum_old, self.dim)
        self.rho_old_q = self.op.z(self.transport.rho_old)
        for load, values in self.loads:
            vector = load.g if isinstance(load, (Gravity, CentralGravity)) else load.force
            values.Interpolate(self.context.average(as_vector(vector, self.dim, "load")))

    def mass_flux(self, rho: np.ndarray, v: np.ndarray, op: Operators) -> np.ndarray:
        """K(rho) rho v + delta |grad rho|^{r-2} grad rho at the points of ``op``."""
        law = self.step.model.regularisation
        flux = rho * v
        if law is None:
            return flux
        if law.rho_max is not None:
            flux *= law.cut_off_values(rho)
        if law.delta_density > 0:
            gradient = np.stack([D(self.transport.rho) for D in op.dz])
            flux += law.diffusivity((gradient * gradient).sum(axis=0)) * gradient
        return flux

    def residual(self) -> np.ndarray:
        """The rows of the flow's unknowns, block after block."""
        t, op = self.transport, self.op
        d, v, L = self.dim, t.v_q, t.L_q
        rho = op.z(t.rho)
        value = self.context.rate((rho * v - self.momentum_old_q) - 0.5 * (rho - self.rho_old_q) * v)
        flux = self.mass_flux(rho, v, op)
        gradient = np.zeros((d * d, op.points.count))
        for i in range(d):
            for j in range(d):
                value[i] += 0.5 * L[i * d + j] * flux[j]
                gradient[i * d + j] -= 0.5 * v[i] * flux[j]
        for j in range(d):
            value[j] -= np.einsum("np,np->p", t.zeta_q, t.dz_q[:, j])
        t.rates.stress(t.z_q, t.zeta_q, gradient)
        if self.stokes is not None:
            gradient += self.stokes @ L
        for load, values in self.loads:
            f = values.vec.FV().NumPy().reshape(d, -1)
            value -= rho * f if isinstance(load, (Gravity, CentralGravity)) else f
        result = np.zeros(self.rows) if self.by_forms is None else self.by_forms.residual()
        rows = result[: t.v.size].reshape(d, -1)
        rows += t.facets.elastic_force(t.zeta)
        rows += op.v.test(value)
        for j, D in enumerate(op.dv):
            rows += D.test(gradient[j::d])
        return result

"""The transported fields' equations for a given velocity: residuals, upwind traces, conjugates.

For a given v the kinematic equations are linear but for creep.  What crosses facets is formed at the
sides' points by ``Facets``, rates and creep at the cells' points by ``RateTensors``.  The upwind traces, the
conjugates zeta and the creep rate R M are functions of (v, rho, z) here: they are evaluated, never
iterated.  So is the trace of the delta-regularised z, whose equation is linear with constant coefficients.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import grad

from ngvisco.forms.rate_tensors import Mobility, RateTensors
from ngvisco.forms.regularisation import penalty_weight
from ngvisco.forms.system import Step
from ngvisco.physics.material import component_count
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.claims import DENSITY
from ngvisco.solver.split.facets import Facets
from ngvisco.solver.split.operators import Conjugation, Operators, ScalarForm, apply, mass_matrix
from ngvisco.solver.split.subsystem import Subsystem
from ngvisco.solver.split.unknowns import Unknowns, density_by_forms


class Transport:
    """Residuals of the continuity and kinematic equations, traces, conjugates."""

    def __init__(self, step: Step, operators: Operators, unknowns: Unknowns) -> None:
        self.step, self.op, self.context = step, operators, step.context
        self.n = n = component_count(step.model.material, step.mesh.dim)
        material, dim, creep = step.model.material, step.mesh.dim, step.model.creep
        self.rates = RateTensors.of(material, dim, creep)
        self.mobility: Mobility | None = None
        """Of local creep; None without creep or where Pi is a field."""
        if creep is not None and creep.R > 0 and creep.is_local:
            self.mobility = Mobility.of(material, dim, creep)
        self.conjugation = Conjugation(step, operators.points)
        ranges = step.layout.ranges
        state, old = step.state.vec.FV().NumPy(), step.state_old.vec.FV().NumPy()
        self.rho, self.rho_old = state[ranges["rho"]], old[ranges["rho"]]
        self.rho_hat = state[ranges["rho_hat"]]
        self.v = state[ranges["v"]].reshape(step.mesh.dim, -1)
        self.z, self.z_old = state[ranges["z"]].reshape(n, -1), old[ranges["z"]].reshape(n, -1)
        self.z_hat = state[ranges["z_hat"]].reshape(n, -1)
        self.zeta = state[ranges["zeta"]].reshape(n, -1)
        self.mass = mass_matrix(operators.z.matrix, operators.weights)
        self.inverse_mass = BlockInverse(self.mass)
        self.inverse_mass.update(self.mass)
        self.facets = Facets(step, operators)
        self.density: Subsystem | None = None
        if density_by_forms(step):
            terms = [t for t in step.terms if type(t) in DENSITY]
            self.density = Subsystem(step, unknowns.density, terms)
        self.diffusion = self._diffusion()
        self.Pi: np.ndarray | None = None
        if "Pi" in ranges:
            self.creep_values = operators.local(operators.points.values(step.layout.scalar_creep_space()))
            p = len(self.rates.constant) - self.rates.gradients
            self.Pi = state[ranges["Pi"]].reshape(p, -1)

    def _diffusion(self) -> sp.csr_matrix | None:
        """delta (-Laplace) of one component with its trace eliminated; see ``FieldDiffusion``."""
        law = self.step.model.regularisation
        if law is None or law.delta_fields == 0:
            return None
        step, c = self.step, self.context
        cell, facet, measure = self.op.scalar, step.layout.scalar_facet_space(), step.quadrature.facets
        delta = law.delta_fields
        weight = delta * penalty_weight(law, step.now) / c.h

        def cells(u: Any, t: Any) -> Any:
            return -delta * (grad(u) * c.normal * t + grad(t) * c.normal * u) + weight * u * t

        own = ScalarForm(cell, cell, cells, measure).matrix
        W = sp.diags(self.op.weights)
        stiffness = delta * sum(D.matrix.T @ W @ D.matrix for D in self.op.dz)
        to_facet = ScalarForm(
            cell, facet, lambda u, t: delta * (grad(u) * c.normal) * t - weight * u * t, measure
        ).matrix
        hats = ScalarForm(facet, facet, lambda u, t: weight * u * t, measure).matrix
        inverse = BlockInverse(hats)
        inverse.update(hats)
        self.delta_hats = inverse
        """Inverse of the facets' matrix of ``FieldDiffusion``, one component."""
        self.to_delta_trace = -(inverse.matrix() @ to_facet)
        return (stiffness + own - to_facet.T @ inverse.matrix() @ to_facet).tocsr()

    def set_velocity(self) -> None:
        """Evaluate what depends on v alone."""
        self.facets.set_velocity(self.v, with_density=self.density is None)
        self.v_q = self.op.v(self.v)
        self.L_q = self.op.velocity_gradient(self.v)

    def set_traces(self) -> None:
        """The upwind values of z and rho on facets."""
        self.facets.set_fields(self.z, self.z_hat)
        if self.density is None:
            self.facets.set_density(self.rho, self.rho_hat)
        if self.diffusion is not None:
            ranges = self.step.layout.ranges
            hats = self.step.state.vec.FV().NumPy()[ranges["z_delta_hat"]].reshape(self.n, -1)
            hats[:] = apply(self.to_delta_trace, self.z)

    def set_conjugates(self) -> None:
        """z and phi'(z) at the points, and zeta, the projection of the latter."""
        op = self.op
        self.z_q = op.z(self.z)
        self.dz_q = op.gradients(op.dz, self.z)
        self.zeta[:] = self.inverse_mass(op.z.test(self.conjugation(self.z_q)))
        self.zeta_q = op.z(self.zeta)

    def creep(self) -> np.ndarray | None:
        """Pi at the points in components, (p, points)."""
        if self.Pi is not None:
            return self.creep_values(self.Pi)
        if self.mobility is None:
            return None
        rates = self.rates
        M = np.zeros((len(rates.constant) - rates.gradients, self.op.points.count))
        rates.stress(self.z_q, self.zeta_q, M, first=rates.gradients)
        return self.mobility(M, self.zeta_q)

    def residual(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the density's unknowns and of z, the latter (n, cells' unknowns)."""
        op, rate = self.op, self.context.rate
        r = op.z(rate(self.z_old - self.z))
        Pi = self.creep()
        self.rates.rate(self.z_q, self.L_q if Pi is None else np.concatenate([self.L_q, Pi]), r)
        for j, v_j in enumerate(self.v_q):
            r -= self.dz_q[:, j] * v_j
        rows = self.facets.fields()
        rows -= op.z.test(r)
        if self.diffusion is not None:
            rows += apply(self.diffusion, self.z)
        if self.density is not None:
            return self.density.residual(), rows
        rho = self.mass @ rate(self.rho - self.rho_old)
        rho_q = op.z(self.rho)
        for D, v_j in zip(op.dz, self.v_q, strict=True):
            rho -= D.test(rho_q * v_j)
        return rho + self.facets.density(), rows

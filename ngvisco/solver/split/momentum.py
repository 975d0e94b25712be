"""Rows of the momentum equation: at the cells' points, and by forms what acts on facets and walls."""

from __future__ import annotations

import numpy as np
from ngsolve import CF, BilinearForm, CoefficientFunction, Discontinuous, FacetFESpace, LinearForm

from ngvisco.forms.creep import CreepRate
from ngvisco.forms.points import csr
from ngvisco.forms.regularisation import VelocityDamping
from ngvisco.forms.system import Step
from ngvisco.forms.wall_terms import Impenetrability, TangentialStress
from ngvisco.physics.model import CentralGravity, Gravity, as_vector
from ngvisco.physics.tensors import embed_gradient, inner, sym
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.operators import Operators, apply, pruned
from ngvisco.solver.split.subsystem import Subsystem
from ngvisco.solver.split.transport import Transport
from ngvisco.solver.split.unknowns import Unknowns

BY_FORMS = (Impenetrability, TangentialStress, VelocityDamping, CreepRate)


class Momentum:
    """R(u; w) for tests of the flow's unknowns, without the hyperviscosity, given the fields."""

    def __init__(self, step: Step, transport: Transport, unknowns: Unknowns) -> None:
        self.step, self.transport, self.op = step, transport, transport.op
        self.dim, self.context = step.mesh.dim, step.context
        self.v_old = step.state_old.vec.FV().NumPy()[step.layout.ranges["v"]].reshape(self.dim, -1)
        self.stokes = self._viscosity_matrix()
        c, u = self.context, step.now
        self.elastic_facets = FacetForce(step, -c.inflow(u.v) * inner(u.z_hat - u.z, u.zeta))
        others = [term for term in step.terms if isinstance(term, BY_FORMS)]
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
        """What is known through a step: the old momentum and the averaged loads at the points."""
        op = self.op
        self.v_old_q = apply(op.v, self.v_old)
        self.rho_old_q = op.z @ self.transport.rho_old
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
            gradient = np.stack([D @ self.transport.rho for D in op.dz])
            flux += law.diffusivity((gradient * gradient).sum(axis=0)) * gradient
        return flux

    def residual(self) -> np.ndarray:
        """The rows of the flow's unknowns, block after block."""
        t, op, tau = self.transport, self.op, self.context.tau.Get()
        d, v, L = self.dim, t.v_q, t.L_q
        rho = op.z @ t.rho
        value = ((rho * v - self.rho_old_q * self.v_old_q) - 0.5 * (rho - self.rho_old_q) * v) / tau
        flux = self.mass_flux(rho, v, op)
        gradient = np.zeros((d * d, op.points.count))
        for i in range(d):
            for j in range(d):
                value[i] += 0.5 * L[i * d + j] * flux[j]
                gradient[i * d + j] -= 0.5 * v[i] * flux[j]
        value -= np.einsum("np,njp->jp", t.zeta_q, t.dz_q)
        t.rates.stress(t.z_q, t.zeta_q, gradient)
        if self.stokes is not None:
            gradient += self.stokes @ L
        for load, values in self.loads:
            f = values.vec.FV().NumPy().reshape(d, -1)
            value -= rho * f if isinstance(load, (Gravity, CentralGravity)) else f
        result = np.zeros(self.rows) if self.by_forms is None else self.by_forms.residual()
        rows = result[: self.v_old.size].reshape(d, -1)
        rows += self.elastic_facets()
        for i in range(d):
            rows[i] += op.v_t @ value[i]
            for j in range(d):
                rows[i] += op.dv_t[j] @ gradient[i * d + j]
        return result


class FacetForce:
    """sum_K int_{dK} f w . n for tests w of v.

    On straight facets w . n is a polynomial there, and it is enough to test f with the polynomials of each
    side: one scalar test in place of all components of v.
    """

    def __init__(self, step: Step, density: CoefficientFunction) -> None:
        space, facets = step.layout.blocks["v"], step.quadrature.facets
        n, self.dim = step.context.normal, step.mesh.dim
        self.curved = step.mesh.GetCurveOrder() > 1
        if self.curved:
            self.form = LinearForm(space)
            self.form += (density * (space.TestFunction() * n)).Compile() * facets
            return
        sides = Discontinuous(FacetFESpace(step.mesh, order=step.discretisation.k))
        t = sides.TestFunction()
        self.form = LinearForm(sides)
        self.form += density.Compile() * t * facets
        mass = BilinearForm(sides)
        mass += sides.TrialFunction() * t * facets
        velocity = step.layout.scalar_velocity_space()
        trace = BilinearForm(trialspace=velocity, testspace=sides)
        trace += velocity.TrialFunction() * t * facets
        matrix = csr(mass.Assemble().mat)
        inverse = BlockInverse(matrix)
        inverse.update(matrix)
        self.tests = pruned((inverse.matrix() @ csr(trace.Assemble().mat)).tocsr()).T.tocsr()
        # the normal is constant on a side: its component in the first of the side's functions
        per_side = sides.ndof // (step.mesh.ne * (self.dim + 1))
        self.normals = np.empty((self.dim, sides.ndof))
        measure = LinearForm(sides)
        measure += t * facets
        areas = measure.Assemble().vec.FV().NumPy()[::per_side]
        for i in range(self.dim):
            normal = LinearForm(sides)
            normal += n[i] * t * facets
            self.normals[i] = np.repeat(normal.Assemble().vec.FV().NumPy()[::per_side] / areas, per_side)

    def __call__(self) -> np.ndarray:
        """Rows of v, (dim, unknowns of a component)."""
        self.form.Assemble()
        loads = self.form.vec.FV().NumPy()
        if self.curved:
            return loads.reshape(self.dim, -1)
        return (self.tests @ (self.normals * loads).T).T

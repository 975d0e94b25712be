"""The regularising terms of the discrete scheme, see ``ngvisco.physics.regularisation``.

Diffusion of the density is a hybrid interior penalty with its own trace u_hat, which is free on walls: the
natural condition n . grad u = 0 of BC-disc.  For a flux c grad u,

    int c grad u . grad w - sum_K int_{dK} c d_n u (w - w_hat)
      + sum_K int_{dK} s/h c_pen (u - u_hat)(w - w_hat),

with s = penalty (m + 1)^2.  The test w_hat makes the flux single-valued: w = w_hat = 1 conserves mass.
``FieldDiffusion`` is the diffusion of the fields.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add

from ngsolve import CF, CoefficientFunction, IfPos

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Term
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.physics.material import Material
from ngvisco.physics.model import Model
from ngvisco.physics.regularisation import Curvature, Regularisation, curvature_of
from ngvisco.physics.tensors import constant, inner, masked, square


@dataclass(frozen=True)
class FieldDiffusion(PointTerm):
    """Diffusion delta Laplace z in the kinematic equations, dissipative for every convex energy (paper:
    Euler-small-viscoelastodyn+2disc, Euler-large-viscoelastodyn+2disc, +3disc, -H, -H+).

    The paper tests by phi'(z), and phi''(z) grad z : grad z >= 0 (Euler-small-calc-Delta).  Here the test is
    zeta, whose gradient is not phi''(z) grad z.  The slope q of z therefore follows from the conjugates,

        sum_K int_K phi''(z) q : Y - grad zeta : Y - sum_K int_{dK} (zeta_hat - zeta) : (Y n) = 0,

    and enters with the adjoint of this lifted gradient,

        delta sum_K int_K q : grad G + delta sum_K int_{dK} (s/h b - q n) : G + s/h C (zeta - zeta_hat) : G.

    zeta_hat is the mean of both sides' conjugates with the weights s/h, where s = penalty (m + 1)^2. b is the
    jump (q_1 n_1 + q_2 n_2) divided by the sum of the weights.  On walls zeta_hat = zeta, that is n . grad z
    = 0 (BC-disc).  C is the inverse of phi'' at rest.  For smooth z, q = grad z; for any z, G = zeta gives

        delta int phi''(z) q : q + delta sum_K int_{dK} s/h C (zeta - zeta_hat) : (zeta - zeta_hat) >= 0.

    In directions in which the energy is linear (``Curvature.linear``) phi'' vanishes and zeta is constant. In
    these directions q is the slope of z, by the form above, and has no power.  Parameters do not diffuse. For
    parameters q is the slope of z, too, because this slope contributes to the slope of zeta.
    """

    law: Regularisation
    material: Material
    dim: int
    kernel = "diffusion"
    plane_only = "about an axis the Laplacian of a tensor has further terms; or take delta_fields = 0"

    @cached_property
    def curvature(self) -> Curvature:
        """The part of the material's phi'' that does not depend on the state."""
        return curvature_of(self.material, self.dim)

    @cached_property
    def of_itself(self) -> CoefficientFunction | None:
        """Projection onto the directions in which the energy is linear and onto the parameters. For these
        components q is the slope of z. None without such components."""
        matrix = self.curvature.of_itself
        return constant(matrix) if matrix.any() else None

    def _of_strains(self, value: CoefficientFunction) -> CoefficientFunction:
        """Components, or their gradients, with the parameters' components set to zero."""
        strains = self.curvature.strains
        return value if strains.all() else masked(value, strains)

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        self.law.require_gradients("delta_fields", setting.m)
        m, size = setting.m, setting.states.size
        return (
            Unknown("z_slope", "cells", m, size * setting.dim),
            Unknown("zeta_delta_hat", "facets", m, size, trace_of="zeta"),
            Unknown("z_slope_hat", "facets", m, size),
        )

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        slopes = self._of_strains(u.grad_zeta)
        if self.of_itself is not None:
            slopes = slopes + self.of_itself * u.grad_z
        spread = self.law.delta_fields * inner(self._of_strains(u.z_slope), w.grad_z)
        return [spread, -inner(slopes, w.z_slope), *self._curved(u, w.z_slope)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        across, jump = self._across(u), self._jump(u)
        fluxes = self._through_facets(u, across, jump, w.z)
        return [*self.lifting(u, w, jump), inner(across, w.z_slope_hat), *fluxes]

    def _through_facets(
        self, u: Fields, across: CoefficientFunction, jump: CoefficientFunction, G: CoefficientFunction
    ) -> list[CoefficientFunction]:
        delta, C = self.law.delta_fields, constant(self.curvature.compliance)
        return [delta * inner(self._of_strains(across), G), -delta * self._weight(u) * inner(C * jump, G)]

    def of_one_component(self, u: Fields, w: Fields) -> list[Integrand]:
        """The part of the form with constant matrices, without the factors delta and C. The matrices are
        equal for all components.

        Rows tested by zeta are the penalty in the equations of z. The equation of the slope q is given
        without its part phi'' q.
        """
        weight, jump, across = self._weight(u), u.zeta_delta_hat - u.zeta, self._across(u)
        facets = [*self.lifting(u, w, jump), inner(across, w.z_slope_hat), -weight * inner(jump, w.zeta)]
        return [Integrand(-inner(u.grad_zeta, w.z_slope)), *(Integrand(facets=part) for part in facets)]

    def lifting(self, u: Fields, w: Fields, jump: CoefficientFunction) -> list[CoefficientFunction]:
        """Integrands on facets: the equation of the trace zeta_hat, a mean of both sides' values, and the
        lifting of the ``jump`` zeta_hat - zeta in the equation of the slope."""
        return [self._weight(u) * inner(jump, w.zeta_delta_hat), -inner(jump, w.z_slope * u.context.normal)]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """The form at G = zeta, written as a square if all variables are strains."""
        delta = self.law.delta_fields
        if not self.curvature.strains.all():
            return {DELTA_FIELDS: delta * inner(self._of_strains(u.z_slope), u.grad_zeta)}
        return {DELTA_FIELDS: delta * reduce(add, u.context.energy.curved(u, u.z_slope, u.z_slope))}

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        jump = self._jump(u)
        if not self.curvature.strains.all():
            return {DELTA_FIELDS: reduce(add, self._through_facets(u, self._across(u), jump, u.zeta))}
        curved = self.curvature.compliance - self.curvature.compliance @ self.curvature.linear
        return {DELTA_FIELDS: self.law.delta_fields * self._weight(u) * inner(constant(curved) * jump, jump)}

    def _curved(self, u: Fields, test: CoefficientFunction) -> list[CoefficientFunction]:
        """Summands of phi''(z) q : Y, and of q : Y for parameters and directions in which phi is linear."""
        summands = u.context.energy.curved(u, u.z_slope, self._of_strains(test))
        if self.of_itself is not None:
            summands.append(inner(self.of_itself * u.z_slope, test))
        return summands

    def _across(self, u: Fields) -> CoefficientFunction:
        """Difference of the weighted mean of both sides' slopes and the slope's normal part."""
        return self._weight(u) * u.z_slope_hat - u.z_slope * u.context.normal

    def _jump(self, u: Fields) -> CoefficientFunction:
        """Jump zeta_hat - zeta; for parameters it is the jump of z, and in linear directions the jump of z is
        added."""
        jump = u.zeta_delta_hat - self._of_strains(u.zeta)
        return jump if self.of_itself is None else jump - self.of_itself * u.z

    def _weight(self, u: Fields) -> CoefficientFunction:
        return self.law.penalty_weight(u.layout.discretisation.m) / u.context.h


DELTA_FIELDS = "dissipation_delta_fields"
"""Ledger column of the dissipation by diffusion of fields; only its integral has a sign."""


@dataclass(frozen=True)
class DensityDiffusion(PointTerm):
    """Diffusion div(delta |grad rho|^{r-2} grad rho) in the continuity equation (paper: Euler-small-
    viscoelastodyn+0disc): incomplete penalty, c_pen = c(|grad rho|^2 + |rho - rho_hat|^2/h^2 + floor^2).

    ``Convection`` has the compensating term of the momentum equation in a skew form without power.  Diffusion
    keeps mass to rounding.  The ledger's ``density_diffusion`` is the rate at which diffusion reduces
    int 1/2 rho^2.
    """

    law: Regularisation
    kernel = "density"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        self.law.require_gradients("delta_density", setting.m)
        return (Unknown("rho_delta_hat", "facets", setting.m, trace_of="rho"),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self.law.diffusivity(square(u.grad_rho)) * inner(u.grad_rho, w.grad_rho)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        jump, test = u.rho - u.rho_delta_hat, w.rho - w.rho_delta_hat
        flux = self.law.diffusivity(square(u.grad_rho)) * (u.grad_rho * u.context.normal)
        return [-flux * test, self._penalty(u, jump) * jump * test]

    def _penalty(self, u: Fields, jump: CoefficientFunction) -> CoefficientFunction:
        h, floor = u.context.h, self.law.gradient_floor
        size = square(u.grad_rho) + jump * jump / (h * h) + floor**2
        return self.law.penalty_weight(u.layout.discretisation.m) / h * self.law.diffusivity(size)

    def entries(self, u: Fields) -> list[Entry]:
        c = self.law.diffusivity(square(u.grad_rho))
        jump = u.rho - u.rho_delta_hat
        flux = c * (u.grad_rho * u.context.normal)
        facets = (self._penalty(u, jump) * jump - flux) * jump
        return [Entry("density_diffusion", "monitor", Integrand(c * square(u.grad_rho), facets))]


@dataclass(frozen=True)
class VelocityDamping(PointTerm):
    """Damping epsilon |v|^{p-2} v in the momentum equation (paper: Euler-small-viscoelastodyn+1disc; printed
    as delta |v|^p in two of the discrete balances)."""

    law: Regularisation

    @property
    def impulse(self) -> str:
        """Name of the impulse: the suffix of the dissipation's column."""
        return "epsilon"

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self.law.friction(square(u.v)) * inner(u.v, w.v)]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        return {"dissipation_epsilon": self.law.friction(square(u.v)) * square(u.v)}


@dataclass(frozen=True)
class CutOffVolume(PointTerm):
    """Volume in which the cut-off K(rho) acts, rho > rho_max; ``Continuity`` and ``Convection`` apply K."""

    law: Regularisation

    def entries(self, u: Fields) -> list[Entry]:
        assert self.law.rho_max is not None
        acting = IfPos(u.rho - self.law.rho_max, CF(1.0), CF(0.0))
        return [Entry("cutoff_volume", "monitor", Integrand(acting))]


def regularising_terms(model: Model, dim: int) -> list[Term]:
    """The terms of a model's regularisation that are not part of another term."""
    terms: list[Term] = []
    law = model.regularisation
    if law is None:
        return terms
    if law.delta_density > 0:
        terms.append(DensityDiffusion(law))
    if law.delta_fields > 0:
        terms.append(FieldDiffusion(law, model.material, dim))
    if law.epsilon > 0:
        terms.append(VelocityDamping(law))
    if law.rho_max is not None:
        terms.append(CutOffVolume(law))
    return terms

"""The regularising terms of the discrete scheme, see ``ngvisco.physics.regularisation``.

Diffusion of the density is a hybrid interior penalty with a trace of its own (u_hat below, free on walls,
which is the natural condition n . grad u = 0 of BC-disc).  For a flux c grad u,

    int c grad u . grad w - sum_K int_{dK} c d_n u (w - w_hat)
      + sum_K int_{dK} s/h c_pen (u - u_hat)(w - w_hat),

s = penalty (m + 1)^2.  The test w_hat makes the flux single-valued, so that w = w_hat = 1 conserves mass.
That of the fields is in ``ngvisco.forms.terms.field_diffusion``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction, IfPos

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Setting, Term, Unknown
from ngvisco.forms.terms.field_diffusion import FieldDiffusion
from ngvisco.physics.model import Model
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.tensors import inner, square


@dataclass(frozen=True)
class DensityDiffusion(PointTerm):
    """div(delta |grad rho|^{r-2} grad rho) in the continuity equation (paper: Euler-small-
    viscoelastodyn+0disc): incomplete penalty, c_pen = c(|grad rho|^2 + |rho - rho_hat|^2/h^2 + floor^2).

    Its compensating term in the momentum equation is in ``Convection``, in a skew form, so that it has no
    power; keeps mass to rounding.  The ledger's ``density_diffusion`` is what it takes from int 1/2 rho^2.
    """

    law: Regularisation

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
    """epsilon |v|^{p-2} v in the momentum equation (paper: Euler-small-viscoelastodyn+1disc; printed as
    delta |v|^p in two of the discrete balances)."""

    law: Regularisation

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self.law.friction(square(u.v)) * inner(u.v, w.v)]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        return {"dissipation_epsilon": self.law.friction(square(u.v)) * square(u.v)}


@dataclass(frozen=True)
class CutOffVolume(PointTerm):
    """Where the cut-off K(rho) acts, i.e. rho > rho_max; K itself is in ``Continuity`` and ``Convection``."""

    law: Regularisation

    def entries(self, u: Fields) -> list[Entry]:
        assert self.law.rho_max is not None
        acting = IfPos(u.rho - self.law.rho_max, CF(1.0), CF(0.0))
        return [Entry("cutoff_volume", "monitor", Integrand(acting))]


def regularising_terms(model: Model, dim: int) -> list[Term]:
    """The terms of a model's regularisation that are not part of another one."""
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

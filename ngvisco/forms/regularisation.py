"""The regularising terms of the discrete scheme, see ``ngvisco.physics.regularisation``.

Diffusion is a hybrid interior penalty with a trace of its own (u_hat below, free on walls, which is the
natural condition n . grad u = 0 of BC-disc).  For a flux c grad u,

    int c grad u . grad w - sum_K int_{dK} c d_n u (w - w_hat)
      + sum_K int_{dK} s/h c_pen (u - u_hat)(w - w_hat),

s = penalty (m + 1)^2.  The test w_hat makes the flux single-valued, so that w = w_hat = 1 conserves mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction, IfPos

from ngvisco.errors import ParameterError
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Term
from ngvisco.forms.unknowns import Setting, Unknown
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.tensors import inner, masked, square


@dataclass(frozen=True)
class DensityDiffusion(PointTerm):
    """div(delta |grad rho|^{r-2} grad rho) in the continuity equation (paper: Euler-small-
    viscoelastodyn+0disc): incomplete penalty, c_pen = c(|grad rho|^2 + |rho - rho_hat|^2/h^2 + floor^2).

    Its compensating term in the momentum equation is in ``Convection``, in a skew form, so that it has no
    power; keeps mass to rounding.  The ledger's ``density_diffusion`` is what it takes from int 1/2 rho^2.
    """

    law: Regularisation

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        _require_gradients("delta_density", self.law.delta_density, setting)
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
        return penalty_weight(self.law, u) / h * self.law.diffusivity(size)

    def entries(self, u: Fields) -> list[Entry]:
        c = self.law.diffusivity(square(u.grad_rho))
        jump = u.rho - u.rho_delta_hat
        flux = c * (u.grad_rho * u.context.normal)
        facets = (self._penalty(u, jump) * jump - flux) * jump
        return [Entry("density_diffusion", "monitor", Integrand(c * square(u.grad_rho), facets))]


@dataclass(frozen=True)
class FieldDiffusion(PointTerm):
    """delta Laplace z in the kinematic equations (paper: Euler-small-viscoelastodyn+2disc, Euler-large-
    viscoelastodyn+2disc, +3disc, -H, -H+), symmetric interior penalty.

    Parameters do not diffuse: their rows have nothing of it, their trace in it is as that of strains.
    Tested by zeta it has the power that the ledger reports; for a quadratic energy zeta is a multiple of
    z and the power is delta |grad z|^2 with its penalty, a square.
    """

    law: Regularisation

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        _require_gradients("delta_fields", self.law.delta_fields, setting)
        return (Unknown("z_delta_hat", "facets", setting.m, setting.states.size, trace_of="z"),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self.law.delta_fields * inner(u.grad_z, _of_strains(u, w.grad_z))]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._through_facets(u, _of_strains(u, w.z) - w.z_delta_hat, _of_strains(u, w.grad_z))

    def _through_facets(
        self, u: Fields, test: CoefficientFunction, grad_G: CoefficientFunction
    ) -> list[CoefficientFunction]:
        n, delta, jump = u.context.normal, self.law.delta_fields, u.z - u.z_delta_hat
        weight = penalty_weight(self.law, u) / u.context.h
        return [
            -delta * inner(u.grad_z * n, test),
            -delta * inner(grad_G * n, jump),
            delta * weight * inner(jump, test),
        ]

    def entries(self, u: Fields) -> list[Entry]:
        """The form at G = zeta; the facet test may be any, since the flux is single-valued."""
        zeta, grad_zeta = _of_strains(u, u.zeta), _of_strains(u, u.grad_zeta)
        first, *others = self._through_facets(u, zeta, grad_zeta)
        for part in others:
            first = first + part
        cells = self.law.delta_fields * inner(u.grad_z, grad_zeta)
        return [Entry("dissipation_delta_fields", "dissipation", Integrand(cells, first))]


def _of_strains(u: Fields, value: CoefficientFunction) -> CoefficientFunction:
    """Components, or their gradients, with zero for those of parameters; where z is a scalar it is one of a
    strain."""
    strains = u.layout.states.strains
    if strains.all() or not u.z.dims:
        return value
    return masked(value, strains)


@dataclass(frozen=True)
class VelocityDamping(PointTerm):
    """epsilon |v|^{p-2} v in the momentum equation (paper: Euler-small-viscoelastodyn+1disc; printed as
    delta |v|^p in two of the discrete balances)."""

    law: Regularisation

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self.law.friction(square(u.v)) * inner(u.v, w.v)]

    def entries(self, u: Fields) -> list[Entry]:
        power = self.law.friction(square(u.v)) * square(u.v)
        return [Entry("dissipation_epsilon", "dissipation", Integrand(power))]


@dataclass(frozen=True)
class CutOffVolume(PointTerm):
    """Where the cut-off K(rho) acts, i.e. rho > rho_max; K itself is in ``Continuity`` and ``Convection``."""

    law: Regularisation

    def entries(self, u: Fields) -> list[Entry]:
        assert self.law.rho_max is not None
        acting = IfPos(u.rho - self.law.rho_max, CF(1.0), CF(0.0))
        return [Entry("cutoff_volume", "monitor", Integrand(acting))]


def _require_gradients(name: str, delta: float, setting: Setting) -> None:
    if setting.m == 0:
        raise ParameterError(f"Regularisation.{name}", delta, "0 with m = 0, which has no gradients")


def regularising_terms(law: Regularisation | None) -> list[Term]:
    """The terms of a model's regularisation that are not part of another one."""
    terms: list[Term] = []
    if law is None:
        return terms
    if law.delta_density > 0:
        terms.append(DensityDiffusion(law))
    if law.delta_fields > 0:
        terms.append(FieldDiffusion(law))
    if law.epsilon > 0:
        terms.append(VelocityDamping(law))
    if law.rho_max is not None:
        terms.append(CutOffVolume(law))
    return terms


def penalty_weight(law: Regularisation, u: Fields) -> float:
    """s = penalty (m + 1)^2, for polynomials of degree m."""
    return law.penalty * (u.layout.discretisation.m + 1) ** 2

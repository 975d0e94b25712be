"""Equations of density and momentum: conservative continuity, skew-symmetric inertia, viscosity, loads.

Adding -1/2 v.w times the continuity equation to the paper's momentum equation gives, with the mass
flux m = rho v,

    int (rho v - m_old)/tau . w - 1/2 (rho - rho_old)/tau v . w
      + 1/2 m . [(L^T w) - (grad w)^T v] + ... = 0,

with the old momentum m_old.  For m_old = rho_old v_old, w = v gives exactly the change of kinetic energy plus
1/2 int rho_old |v - v_old|^2, the remainder of the paper's convexity inequality
(Euler-ED-basic-convexity-calculus).  For any m_old, w = v gives E'(U)[U - u_old], with the convex kinetic
energy E(rho, m) = max_w <m, w> - 1/2 int rho |w|^2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import CHANGE, SKEW, CellMean, Entry, Integrand, PointTerm, point_terms
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.forms.upwinding import FacetMean, mean_share, side, speed
from ngvisco.physics.loads import Load, force_of
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import if_positive, inner, square, sym
from ngvisco.physics.variables import Values


@dataclass(frozen=True)
class Continuity(PointTerm):
    """Continuity, int (rho - rho_old)/tau q - rho v . grad q + sum_K int_{dK} j q = 0
    (paper: Euler-small-viscoelastodyn+0disc; its delta-term is ``DensityDiffusion``).

    With the mean rho_hat of both sides' densities, j = (v . n) rho_hat + |v . n| (rho - rho_hat) is v . n
    times the upstream density.  The flux is the same on both sides of a facet, and zero on walls that nothing
    crosses: q = 1 conserves mass to rounding (paper: Euler-small-est-1+).

    A cut-off replaces rho in the fluxes by f(rho) = K(rho) rho, which falls where rho > rho_max. An upwind
    flux would then go on filling full cells.  Instead the flux is that of Engquist and Osher (Math.  Comp.
    36, 1981): the rising part f^+ of f is taken upstream, the falling part f^- downstream. With n^- = 1 on
    the side that the flow enters and 0 on the other side, j = (v . n) rho_hat and

        sum_K int_{dK} [(1 - n^-) (rho_hat - f^+(rho)) - n^- f^-(rho)] q_hat = 0,

    which is the upwind flux below the density at which f is largest.  No mass enters a cell of constant
    density rho_max + width, and its density never exceeds this value (paper: Euler-small-est3+++).
    """

    regularisation: Regularisation | None = None
    kernel, group = "density", ""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        order = setting.m
        rho = Unknown("rho", "cells", order, evolves=True)
        return rho, Unknown("rho_hat", "facets", order, trace_of="rho")

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        carried = carried_density(u, self.regularisation)
        return [c.rate(u.rho - c.old.rho) * w.rho, -carried * (u.v * w.grad_rho)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c, law = u.context, self.regularisation
        if law is None or law.rho_max is None:
            return [mass_flux(u) * w.rho, mean_share(c.inner) * (u.rho_hat - u.rho) * w.rho_hat]
        inflow = self._inflow(u)
        trace = (1.0 - inflow) * (u.rho_hat - law.rising(u.rho)) - inflow * law.falling(u.rho)
        return [c.crossed * (u.v * c.normal) * u.rho_hat * w.rho, trace * w.rho_hat]

    def _inflow(self, u: Fields) -> CoefficientFunction:
        """Inflow indicator: 1 on a facet's side that the flow enters, 0 on the other, 1/2 at rest."""
        flux = u.v * u.context.normal
        if MeanFlux.name in u.layout.unknowns:
            flux = side(u) * u.parts[MeanFlux.name]
        zero = 0.0 * flux
        return u.context.inner * if_positive(flux, zero, if_positive(-flux, zero + 1.0, zero + 0.5))


class MeanFlux(FacetMean):
    """Equation of the mean of v . n over a facet, m/s, with the sign of the facet's first side.

    With this flux, one number per facet, the whole facet has one upwind side. If the side changed along the
    facet, the trace would be a mean of both cells, and the outflow of a cell would be taken from its
    neighbour too.
    """

    name = "mean_flux"

    def value(self, u: Fields) -> CoefficientFunction:
        return side(u) * (u.v * u.context.normal)


@dataclass(frozen=True)
class Inertia(PointTerm):
    """Inertia (rho v - m_old)/tau . w - 1/2 (rho - rho_old)/tau v . w."""

    linearised, is_mass, weighs = False, True, True

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("v", "velocity", setting.k, setting.dim, evolves=True),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        change = (u.rho * u.v - c.momentum_old) - 0.5 * (u.rho - c.old.rho) * u.v
        return [c.rate(inner(change, w.v))]

    def compensation(self, u: Fields, w: Fields) -> CoefficientFunction:
        """The skew form's summand -1/2 (rho - rho_old)/tau v . w."""
        return u.context.rate(-0.5 * (u.rho - u.context.old.rho) * inner(u.v, w.v))

    def impulses(self, u: Fields, w: Fields) -> dict[str, list[Integrand]]:
        (whole,), skew = self.cells(u, w), self.compensation(u, w)
        return {CHANGE: [Integrand(whole - skew)], SKEW: [Integrand(skew)]}

    def energy(self, u: Fields) -> Entry:
        """Kinetic energy 1/2 rho |v|^2."""
        return Entry("kinetic", "energy", Integrand(0.5 * u.rho * square(u.v)))

    def slope(self, b: Fields, d: Fields) -> Integrand:
        """Derivative -1/2 |v_b|^2 rho_d of the kinetic energy at a fixed momentum functional."""
        return Integrand(-0.5 * d.rho * square(b.v))

    def distance(self, a: Fields, b: Fields) -> Entry:
        """Bregman distance 1/2 rho_a |v_a - v_b|^2, dissipated by an implicit Euler step from ``a``."""
        return Entry("inertial", "numerical", Integrand(0.5 * a.rho * square(a.v - b.v)))


@dataclass(frozen=True)
class Convection(PointTerm):
    """Convection 1/2 m . [(L^T w) - (grad w)^T v] with m = rho v, which has no power (paper:
    calculus-for-kinetic).

    With regularisation, m = K(rho) rho v + delta |grad rho|^{r-2} grad rho. The paper has a compensating term
    - delta |grad rho|^{r-2} (grad v) grad rho, which takes this shape when -1/2 v.w times the continuity
    equation is added. The compensating term has no power either.
    """

    regularisation: Regularisation | None = None
    group = SKEW

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        flux = carried_density(u, self.regularisation) * u.v
        if self.regularisation is not None and self.regularisation.delta_density > 0:
            flux = flux + self.regularisation.diffusivity(square(u.grad_rho)) * u.grad_rho
        return [0.5 * inner(u.grad_v * flux, w.v), -0.5 * inner(w.grad_v * flux, u.v)]


class CellVelocity(CellMean):
    """Equation of the mean of v over a cell, m/s."""

    name = "cell_velocity"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "cells", 0, setting.dim, is_mean=True),)

    def value(self, u: Fields) -> CoefficientFunction:
        return u.v


class UnbalancedMomentum(CellMean):
    """Equation of the cell mean of the continuity equation's residual, tested by v, N/m^3:

        int (rho - rho_old)/tau v - rho (v . grad) v + int_{dK} j v,    j the flux of mass through a facet.

    The residual is not zero, since v times a constant is not in the test space P_m.
    """

    name = "unbalanced_momentum"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "cells", 0, setting.dim, is_mean=True),)

    def value(self, u: Fields) -> CoefficientFunction:
        c = u.context
        return c.rate(u.rho - c.old.rho) * u.v - u.rho * (u.grad_v * u.v)

    def value_on_sides(self, u: Fields) -> CoefficientFunction:
        return mass_flux(u) * u.v


class MomentumBalance(PointTerm):
    """Balance 1/2 R(v . w_K) - 1/2 R(v_K . w), where R(q) is the continuity equation tested by q, and v_K a
    cell mean.

    Tested by a constant w, the skew form of ``Inertia`` and ``Convection`` is the rate of the momentum minus
    1/2 R(v . w). R(v . w) is not zero: rho in P_m satisfies the equation for tests in P_m only.  The present
    term is also skew, and therefore has no power. For a constant w it is 1/2 R(v . w) - 1/2 R(v_K . w), where
    the second part is zero.  The balances of kinetic energy and of momentum then both hold for a
    discontinuous rho and a continuous v.  R(q) = 0 for the exact solution: the term is consistent.
    """

    linearised, weighs, group = False, True, SKEW

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c, v_K = u.context, u.parts[CellVelocity.name]
        return [
            0.5 * inner(u.parts[UnbalancedMomentum.name], w.v),
            -0.5 * c.rate(u.rho - c.old.rho) * inner(v_K, w.v),
            0.5 * u.rho * inner(w.grad_v * u.v, v_K),
        ]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-0.5 * mass_flux(u) * inner(u.parts[CellVelocity.name], w.v)]


def mass_flux(u: Fields) -> CoefficientFunction:
    """Upwind mass flux through a facet, (v . n) rho_hat + |v . n| (rho - rho_hat), kg/(m^2 s).

    The terms' ``entering_mass`` is subtracted.
    """
    c = u.context
    flux = c.crossed * (u.v * c.normal) * u.rho_hat + speed(u) * (u.rho - u.rho_hat)
    entering = (term.entering_mass(u) for term in point_terms(c.terms))
    return sum((-mass for mass in entering if mass is not None), flux)


def carried_density(u: Fields, regularisation: Regularisation | None) -> CoefficientFunction:
    """The density K(rho) rho in fluxes, which is rho without a cut-off."""
    return u.rho if regularisation is None else regularisation.carried(u.rho)


@dataclass(frozen=True)
class Stokes(PointTerm):
    """Viscosity int D(eps(v)) : eps(w) (paper: dissipation-pot)."""

    viscosity: Viscosity
    group = ""

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.viscosity.stress(sym(u.L), self._values(u)), w.L)]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        eps, z = sym(u.L), self._values(u)
        return {
            "dissipation_stokes_bulk": self.viscosity.bulk_dissipation(eps, z),
            "dissipation_stokes_shear": self.viscosity.shear_dissipation(eps, z),
        }

    def _values(self, u: Fields) -> Values:
        law = self.viscosity
        return u.context.rates.read_values(law, u) if law.reads else u.z_tensors


@dataclass(frozen=True)
class Loading(PointTerm):
    """Load -int f . w with f = rho g for gravity, averaged over the step (paper: g^k_{delta tau})."""

    load: Load
    dim: int
    linearised, weighs = False, True

    @property
    def impulse(self) -> str:
        """The name of the load."""
        return self.load.name

    @cached_property
    def vector(self) -> CoefficientFunction:
        """Acceleration g, m/s^2, or the body force, N/m^3."""
        return force_of(self.load, self.dim)

    def force(self, u: Fields) -> CoefficientFunction:
        """Force density f, N/m^3."""
        average = u.context.average(self.vector)
        return u.rho * average if self.load.is_weight else average

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-inner(self.force(u), w.v)]

    def entries(self, u: Fields) -> list[Entry]:
        return [Entry(f"power_{self.load.name}", "power", Integrand(inner(self.force(u), u.v)))]

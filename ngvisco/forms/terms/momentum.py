"""Density and momentum: conservative continuity, skew-symmetric inertia, viscosity, loads.

Adding -1/2 v.w times the continuity equation to the paper's momentum equation gives, with the mass
flux m = rho v,

    int (rho v - m_old)/tau . w - 1/2 (rho - rho_old)/tau v . w
      + 1/2 m . [(L^T w) - (grad w)^T v] + ... = 0,

m_old the old momentum.  With m_old = rho_old v_old, w = v returns exactly the change of kinetic energy plus
1/2 int rho_old |v - v_old|^2, the remainder of the paper's convexity inequality
(Euler-ED-basic-convexity-calculus); in general E'(U)[U - u_old] of the kinetic energy
E(rho, m) = max_w <m, w> - 1/2 int rho |w|^2, which is convex.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Setting, Unknown
from ngvisco.physics.loads import CentralGravity, Gravity, Load, force_of
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import inner, square, sym
from ngvisco.physics.variables import Values


@dataclass(frozen=True)
class Continuity(PointTerm):
    """int (rho - rho_old)/tau q - rho v . grad q + sum_K int_{dK} (v . n) rho_hat q = 0
    (paper: Euler-small-viscoelastodyn+0disc; its delta-term is ``DensityDiffusion``).

    rho_hat is the upwind trace, sum_K int_{dK} (1 - n^-) (rho_hat - rho) q_hat = 0 with the weights of the
    step (``ngvisco.forms.upwinding``), a convex combination of both sides' densities.  The flux through a
    facet is single-valued and zero on walls that nothing crosses: q = 1 conserves mass to rounding (paper:
    Euler-small-est-1+).

    With a cut-off, rho is f(rho) = K(rho) rho in the fluxes, which falls where rho > rho_max: an upwind flux
    would go on filling full cells.  The trace is then that of Engquist and Osher (Math. Comp. 36, 1981), the
    rising part f^+ of f upstream and the falling part f^- downstream,

        sum_K int_{dK} [(1 - n^-) (rho_hat - f^+(rho)) - n^- f^-(rho)] q_hat = 0,

    the same as above below the density of the largest f.  A cell of constant density rho_max + width gets
    nothing, and its density never passes that (paper: Euler-small-est3+++).
    """

    regularisation: Regularisation | None = None

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
            trace = c.upwinding.trace(u, "rho")
        else:
            share, inflow = c.upwinding.share, c.upwinding.inflow
            trace = share * (u.rho_hat - law.rising(u.rho)) - inflow * law.falling(u.rho)
        return [c.crossed * (u.v * c.normal) * u.rho_hat * w.rho, trace * w.rho_hat]


@dataclass(frozen=True)
class Inertia(PointTerm):
    """(rho v - m_old)/tau . w - 1/2 (rho - rho_old)/tau v . w."""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("v", "velocity", setting.k, setting.dim, evolves=True),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        change = (u.rho * u.v - c.momentum_old) - 0.5 * (u.rho - c.old.rho) * u.v
        return [c.rate(inner(change, w.v))]

    def energy(self, u: Fields) -> Entry:
        """1/2 rho |v|^2."""
        return Entry("kinetic", "energy", Integrand(0.5 * u.rho * square(u.v)))

    def slope(self, b: Fields, d: Fields) -> Integrand:
        """-1/2 |v_b|^2 rho_d, under a momentum functional that is kept."""
        return Integrand(-0.5 * d.rho * square(b.v))

    def distance(self, a: Fields, b: Fields) -> Entry:
        """1/2 rho_a |v_a - v_b|^2; with a the old state what an implicit Euler step dissipates."""
        return Entry("inertial", "numerical", Integrand(0.5 * a.rho * square(a.v - b.v)))


@dataclass(frozen=True)
class Convection(PointTerm):
    """1/2 m . [(L^T w) - (grad w)^T v] with m = rho v: powerless (paper: calculus-for-kinetic).

    With regularisation m = K(rho) rho v + delta |grad rho|^{r-2} grad rho: the paper's compensating term
    - delta |grad rho|^{r-2} (grad v) grad rho takes this shape when -1/2 v.w times the continuity equation
    is added, and is powerless too.
    """

    regularisation: Regularisation | None = None

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        flux = carried_density(u, self.regularisation) * u.v
        if self.regularisation is not None and self.regularisation.delta_density > 0:
            flux = flux + self.regularisation.diffusivity(square(u.grad_rho)) * u.grad_rho
        return [0.5 * inner(u.grad_v * flux, w.v), -0.5 * inner(w.grad_v * flux, u.v)]


def carried_density(u: Fields, regularisation: Regularisation | None) -> CoefficientFunction:
    """K(rho) rho; rho itself without a cut-off."""
    return u.rho if regularisation is None else regularisation.carried(u.rho)


@dataclass(frozen=True)
class Stokes(PointTerm):
    """int D(eps(v)) : eps(w) (paper: dissipation-pot)."""

    viscosity: Viscosity

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
    """-int f . w with f = rho g for gravity, averaged over the step (paper: g^k_{delta tau})."""

    load: Load
    dim: int

    @cached_property
    def vector(self) -> CoefficientFunction:
        """g (m/s^2), or the body force (N/m^3)."""
        return force_of(self.load, self.dim)

    def force(self, u: Fields) -> CoefficientFunction:
        """f, N/m^3."""
        average = u.context.average(self.vector)
        return u.rho * average if isinstance(self.load, (Gravity, CentralGravity)) else average

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-inner(self.force(u), w.v)]

    def entries(self, u: Fields) -> list[Entry]:
        power = Integrand(inner(self.force(u), u.v))
        return [Entry(f"power_{self.load.name}", "power", power)]

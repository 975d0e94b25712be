"""Transport of the material's variables and the elastic force, one bilinear operator used twice; creep.

    B_h(w; z, G) = sum_K int_K (rate(grad w; z) - (w . grad) z) : G
                 - sum_K int_{dK} (w . n) (z_hat - z) : G

with the mean z_hat of both sides' values; on a wall z_hat = z (``ngvisco.forms.upwinding``).  For a density,
whose rate is -(div w) z + production, the operator is

    B_h(w; z, G) = sum_K int_K z : (w . grad) G + production(grad w; z) : G
                 - sum_K int_{dK} (w . n) z_hat : G,

with (w . n) = 0 on walls that nothing crosses.  The flux through a facet is single-valued. Therefore G = 1
keeps int z to rounding if there is no production, and constant conjugates make no force at a jump.

The kinematic equations use B_h(v; z, G). The momentum equation uses the adjoint B_h(w; z, zeta), with the
projected conjugates zeta.  At w = v, G = zeta the two cancel identically, facets included: the elastic power
of the momentum equation *is* the rate of the stored energy (paper: ED-Euler-large-stress-calculus).  For
smooth fields B_h(w; z, zeta) = int T : grad w with T of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Conjugate, TabulatedRates
from ngvisco.forms.term import ELASTIC, Entry, Integrand, Integrands, PointTerm, tested
from ngvisco.forms.terms.tangents import TangentForce
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.forms.upwinding import FacetMean, OfFacet, beyond_trace, jump_power, speed
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.materials.wrapped import WithQuadratic
from ngvisco.physics.model import CreepMechanism, Model
from ngvisco.physics.tensors import inner, masked, square, trace_free_tensors

UPWINDING = "dissipation_upwinding"
"""Ledger column of the dissipation by upwinding."""


def transport_in_cells(along: Fields, u: Fields, G: Fields, name: Conjugate) -> list[CoefficientFunction]:
    """Integrands of B_h(w; z, G) in cells; w is the velocity of ``along``, G the part ``name`` of ``G``."""
    rates, by_flux = u.context.rates.power(u, along, G, name), u.layout.states.by_flux
    if not by_flux.any():
        return [-inner(u.grad_z * along.v, G.parts[name]), *rates]
    grad_G = G.grad_z if name == "z" else G.grad_zeta
    advected = -inner(masked(u.grad_z, ~by_flux) * along.v, G.parts[name])
    return [advected, inner(grad_G * along.v, masked(u.z, by_flux)), *rates]


def degree_of_transport(k: int, m: int, rates: TabulatedRates) -> int | None:
    """Polynomial degree of B_h(w; z, G) in cells; None if rates are not products of z and grad w."""
    is_bilinear = rates.weighed is None and not rates.constants.nonlinear_variables
    return k - 1 + 2 * m if is_bilinear else None


def transport_through_facets(along: Fields, u: Fields, G: Fields, name: Conjugate) -> CoefficientFunction:
    """Integrand of B_h(w; z, G) on the boundaries of cells, both sides of a facet."""
    c, by_flux = u.context, u.layout.states.by_flux
    flow = c.crossed * (along.v * c.normal)
    if by_flux.any():
        return -(flow * inner(masked(u.z_hat, by_flux) - masked(beyond_trace(u), ~by_flux), G.parts[name]))
    return flow * (jump_power(u) if G is u and name == "zeta" else inner(beyond_trace(u), G.parts[name]))


@dataclass(frozen=True)
class Kinematics(PointTerm):
    """int (z - z_old)/tau : G - B_h(v; z, G) - int rate(z; 0, Pi) : G = 0  (paper: Euler-small-
    viscoelastodyn+2disc, Euler-large-viscoelastodyn+2disc, +3disc, viscoelastodyn-H, -H+).

    G is the test function of z in the discontinuous P_m.  Creep does not change J, since tr Pi = 0.
    With creep and nu = 0 the rate Pi at a point is a function of the Mandel stress M of the projected
    conjugates, so that G = zeta gives the dissipation M : Pi >= 0; see ``CreepRate`` for nu > 0.  Creep of
    nonlinear rules, and of F, is integrated by the nodal rule, one point per coefficient of z: a finer rule
    would over-constrain |M| for yield near its rate-independent limit.
    """

    model: Model
    linearised, group = False, ""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("z", "cells", setting.m, setting.states.size, evolves=True, scale=1.0),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        parts = [-part for part in transport_in_cells(u, u, w, "z")]
        if c.rates.mechanisms and not c.rates.creep_is_collocated:
            parts += self._creep(u, w)
        return [c.rate(inner(u.z - c.old.z, w.z)), *parts]

    def degree(self, k: int, m: int, rates: TabulatedRates) -> int | None:
        of_transport = degree_of_transport(k, m, rates)
        if of_transport is None or not rates.mechanisms or rates.creep_is_collocated:
            return of_transport
        is_linear = all(f.rule.is_linear and f.body is None for f in rates.mechanisms)
        return max(of_transport, 4 * m) if is_linear else None  # M ~ z : zeta, Pi ~ M

    def collocated(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._creep(u, w) if u.context.rates.creep_is_collocated else []

    def _creep(self, u: Fields, w: Fields) -> list[CoefficientFunction]:
        rates = u.context.rates
        return [-part for part in rates.creep_power(u, rates.creep(u), w, "z")]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-transport_through_facets(u, u, w, "z")]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """The dissipation of creep, if the creep rate is not an unknown."""
        rates = u.context.rates
        is_here = rates.mechanisms and rates.is_local and not rates.creep_is_collocated
        return _dissipation(u) if is_here else {}

    def dissipated_collocated(self, u: Fields) -> dict[str, CoefficientFunction]:
        return _dissipation(u) if u.context.rates.creep_is_collocated else {}

    def energy(self, u: Fields) -> Entry:
        """The stored energy phi(z)."""
        return Entry("stored", "energy", Integrand(u.context.energy.density(u)))

    def slope(self, b: Fields, d: Fields) -> Integrand:
        """Derivative of the stored energy, phi'(z_b):z_d."""
        return Integrand(inner(b.context.energy.slope(b), d.z))

    def distance(self, a: Fields, b: Fields) -> Entry:
        """Bregman distance phi(z_a) - phi(z_b) - phi'(z_b):(z_a - z_b)."""
        energy = b.context.energy
        bregman = energy.density(a) - energy.density(b) - inner(energy.slope(b), a.z - b.z)
        return Entry("bregman", "numerical", Integrand(bregman))


class Trace(FacetMean):
    """Equation of the trace, the mean of both sides: sum_K int_{dK} share (z_hat - z) : G_hat = 0."""

    name, mean_of = "z_hat", "z"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", setting.m, setting.states.size, trace_of="z"),)

    def value(self, u: Fields) -> CoefficientFunction:
        return u.z


@dataclass(frozen=True)
class Upwinding(PointTerm):
    """Upwinding sum_K int_{dK} |v . n| (z - z_hat) : G, which equals 1/2 int |v . n| [z] : [G] over the
    facets.

    With the mean trace in B_h the transport is upwind.  Tested by zeta, the term dissipates
    1/2 int |v . n| [z] : [zeta]. With the power of ``TangentForce`` this is int 1/2 |v . n| [z] :
    [zeta] - (v . n) N.
    """

    tangents: TangentForce | None = None
    linearised, group = False, ""

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [speed(u) * inner(beyond_trace(u), w.z)]

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        mean = JumpHeat.name in u.layout.unknowns  # both sides get the same share, by the mean of the power
        loss = u.parts[JumpHeat.name] if mean else lost_by_jumps(u)
        if self.tangents is not None:
            loss = loss + (u.v * u.context.normal) * self.tangents.excess(u)
        return {UPWINDING: loss}

    def entries(self, u: Fields) -> list[Entry]:
        """Columns of the dissipation, >= 0 up to the error of the conjugates' projection."""
        return [replace(entry, has_sign=False) for entry in super().entries(u)]


def lost_by_jumps(u: Fields) -> CoefficientFunction:
    """Power of upwinding on a side, W/m^2; only the sum of both sides is >= 0."""
    return speed(u) * jump_power(u)


class JumpHeat(OfFacet):
    """Equation of the mean of upwinding's power over a facet, W/m^2. The cells on both sides share the heat
    of a jump by this mean."""

    name = "jump_heat"

    def value(self, u: Fields) -> CoefficientFunction:
        return lost_by_jumps(u)


@dataclass(frozen=True)
class Conjugates(PointTerm):
    """Equation of zeta, the cellwise L2 projection of the conjugates: int (zeta - phi'(z)) : X = 0."""

    model: Model
    kernel, group = "conjugates", ""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("zeta", "cells", setting.m, setting.states.size),)

    def projections(self, u: Fields) -> list[tuple[str, Integrands]]:
        return [("zeta", tested(u.context.energy.slope(u)))]

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(u.zeta, w.zeta), *(-part for part in u.context.energy.tested_slope(u, w))]

    def entries(self, u: Fields) -> list[Entry]:
        """Monitor of the quadratic regularisation's share of the stored energy; the term has no power."""
        material = self.model.material
        if isinstance(material, WithQuadratic):
            return [Entry("stored_quadratic", "monitor", Integrand(material.added_energy(u.z_tensors)))]
        return []


class ElasticForce(PointTerm):
    """Elastic force B_h(w; z, zeta) in the momentum equation: int T : grad w for smooth fields
    (paper: Cauchy-stress-polyconvex in Euler-large-viscoelastodyn+1disc).

    The term has no ledger entry: at w = v it is the rate of the stored energy.
    """

    linearised, group = False, ELASTIC

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return transport_in_cells(w, u, u, "zeta")

    def degree(self, k: int, m: int, rates: TabulatedRates) -> int | None:
        return degree_of_transport(k, m, rates)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [transport_through_facets(w, u, u, "zeta")]


@dataclass(frozen=True)
class CreepRate(PointTerm):
    """Equation of the creep rate Pi, a field, for creep with a gradient term.

        psi'(Pi) - div(nu |grad Pi|^{q-2} grad Pi) = M,   (n . grad) Pi = 0 on walls
        (paper: ED-Euler-large3, Euler-large-viscoelastodyn+4disc, with + M as the energy balance needs),
        int psi'(Pi) : P + nu |grad Pi|^{q-2} grad Pi : grad P - M : P = 0, M from projected conjugates.

    psi'(Pi) = G_m Pi in the paper; any flow rule with a potential of Pi gives its own psi.  Pi is continuous,
    symmetric and trace-free, in components of an orthonormal basis of R^{3x3}_dev (plane strain in 2D).
    P = Pi gives the creep power that the kinematic equations, tested by zeta, take from the stored energy.
    """

    rule: FlowRule
    plane_only = "about an axis the gradient of the rate has further terms (Pi_rr - Pi_33)/r; or take nu = 0"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("Pi", "continuous", max(1, setting.m), trace_free_tensors(setting.dim).size),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        gradient = self.rule.gradient_coefficient(square(u.grad_Pi))
        z = u.context.rates.read_values(self.rule, u, u.context.rates.mechanisms[0])
        space = trace_free_tensors(u.dim)
        force, driving = self.rule.force(u.Pi, z), u.context.rates.mandel(u)
        return [
            inner(space.components(force), w.parts["Pi"]),
            gradient * inner(u.grad_Pi, w.grad_Pi),
            -inner(space.components(driving), w.parts["Pi"]),
        ]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        size = square(u.grad_Pi)
        return {**_dissipation(u), "dissipation_creep_gradient": self.rule.gradient_coefficient(size) * size}


def _dissipation(u: Fields) -> dict[str, CoefficientFunction]:
    """Dissipation of creep by ledger names, one a branch of a network."""
    return {f"dissipation_creep{suffix}": power for suffix, power in u.context.rates.dissipation(u).items()}


@dataclass(frozen=True)
class PlasticStraining(PointTerm):
    """Growth - int A dk/dt q in the equation of the plastic content K = A k, q its test.

    The rate is dk/dt = sqrt(2/3) |Pi|; for a body, with K_i = n_i k, the term is - int n_i dk/dt q.
    q = zeta_K = phi_h'(k) gives the power that hardening stores, which ``dissipation_creep`` excludes.
    """

    mechanism: CreepMechanism

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [] if u.context.rates.creep_is_collocated else self._rows(u, w)

    def collocated(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w) if u.context.rates.creep_is_collocated else []

    def _rows(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        rates = u.context.rates
        Pi = rates.creep(u)[rates.mechanisms.index(self.mechanism)]
        G = w.z_tensors[self.mechanism.plastic_content.name]
        return [-rates.hardening_rate(self.mechanism, Pi, u) * G]

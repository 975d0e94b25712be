"""Transport of the material's variables and the elastic force: one bilinear operator used twice.

    B_h(w; z, G) = sum_K int_K (rate(grad w; z) - (w . grad) z) : G
                 - sum_K int_{dK} (w . n) n^- (z_hat - z) : G

with n^- = (1 - sigma(v . n))/2 of the step's velocity v and the upwind trace z_hat.  The kinematic
equations use B_h(v; z, G), the momentum equation the adjoint B_h(w; z, zeta), zeta the projected
conjugates.  At w = v, G = zeta the two cancel identically, facets included: the elastic power of the
momentum equation *is* the rate of the stored energy (paper: ED-Euler-large-stress-calculus).
For smooth fields B_h(w; z, zeta) = int T : grad w with T of the paper.
"""

from __future__ import annotations

from ngsolve import CoefficientFunction

from ngvisco.forms.context import Context, Entry, Integrand, negative
from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.spaces import Fields
from ngvisco.physics.material import local_creep_rate, mandel_stress, rate_power
from ngvisco.physics.materials.regularised import WithQuadratic
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, square
from ngvisco.physics.variables import Values


class Transport:
    """B_h and the equations built on it, for one model."""

    def __init__(self, model: Model, context: Context) -> None:
        self.model, self.context = model, context
        self.material = model.material
        self.dim = context.mesh.dim
        self.energy = context.energy or StoredEnergy(model.material, self.dim)

    def operator(
        self,
        direction: Fields,
        z: Fields,
        G: CoefficientFunction,
        G_tensors: Values,
        v: Fields,
    ) -> list[Integrand]:
        """B_h(w; z, G) with w = ``direction``, G by components and by tensors, n^- from ``v``."""
        c, w = self.context, direction.v
        zero = 0 * direction.L
        convection = Integrand(-inner(z.grad_z * w, G))
        rates = [
            Integrand(inner(variable.rate(z.z_tensors, direction.L, zero), G_tensors[variable.name]))
            for variable in self.material.variables
        ]
        upwind = Integrand(facets=-(w * c.normal) * c.inflow(v.v) * inner(z.z_hat - z.z, G))
        return [convection, *rates, upwind]

    def mandel(self, u: Fields) -> CoefficientFunction:
        """Mandel stress of the projected conjugates, 3x3, Pa."""
        return mandel_stress(self.material, u.z_tensors, u.zeta_tensors, self.dim)

    def creep_rate(self, u: Fields) -> CoefficientFunction | None:
        """Pi, 3x3, 1/s: local, R M or by another law, or the field of its own; None without creep."""
        creep = self.model.creep
        if creep is None or creep.R == 0:
            return None
        if not creep.is_local:
            return u.Pi
        return local_creep_rate(self.material, creep, u.z_tensors, u.zeta_tensors, self.dim)


class Kinematics(Transport):
    """int (z - z_old)/tau : G - B_h(v; z, G) - int rate(z; 0, Pi) : G = 0  (paper: Euler-small-
    viscoelastodyn+2disc, Euler-large-viscoelastodyn+2disc, +3disc, viscoelastodyn-H, -H+).

    G is the test function of z in the discontinuous P_m.  Keeps: J untouched by creep, tr Pi = 0.
    With creep and nu = 0 the rate Pi = R M is pointwise, M the Mandel stress of the projected
    conjugates, so that G = zeta gives the dissipation R |M|^2 = G_m |Pi|^2; see ``CreepRate`` for nu > 0.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        c, G, G_tensors = self.context, w.z, w.z_tensors
        storage = Integrand(c.rate(inner(u.z - c.old.z, G)))
        transport = self.operator(u, u, G, G_tensors, u)
        return [storage, *negative(transport), *negative(self._creep(u, G_tensors))]

    def _creep(self, u: Fields, G_tensors: Values) -> list[Integrand]:
        """int rate(z; 0, Pi) : G; the affine parts of a rate vanish at L = 0."""
        Pi = self.creep_rate(u)
        if Pi is None:
            return []
        return [
            Integrand(inner(variable.rate(u.z_tensors, 0 * Pi, Pi), G_tensors[variable.name]))
            for variable in self.material.variables
            if variable.creeps
        ]

    def entries(self, u: Fields) -> list[Entry]:
        """Creep's dissipation, where it has no equation of its own."""
        entries = []
        Pi = self.creep_rate(u)
        if self.model.creep is not None and self.model.creep.is_local and Pi is not None:
            if self.model.creep.law == "mandel":
                power = self.model.creep.R * square(self.mandel(u))
            else:
                power = -rate_power(self.material, u.z_tensors, u.zeta_tensors, 0 * Pi, Pi)
            creep = Integrand(power)
            entries.append(Entry("dissipation_creep", "dissipation", creep))
        return entries

    def distance(self, a: Fields, b: Fields) -> Entry:
        """phi(z_a) - phi(z_b) - phi'(z_b):(z_a - z_b)."""
        bregman = self.energy.density(a) - self.energy.density(b) - inner(self.energy.slope(b), a.z - b.z)
        return Entry("bregman", "numerical", Integrand(bregman))


class UpwindTrace(Transport):
    """sum_K int_{dK} (1 - n^-)(z_hat - z) : G_hat = 0: the trace is the upwind value n^+ z_1 + n^- z_2.

    The weight 1 - n^- is in (0, 1) whatever v . n (and 1 on walls), so that the trace is a convex
    combination.  With the weight (v . n)^+ smoothed as (v . n)(1 + sigma)/2 it is not: that weight
    is negative for small v . n < 0, and z_hat ~ [z] eta/(v . n) where the flow turns round.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        weight = 1 - self.context.inflow(u.v)
        return [Integrand(facets=weight * inner(u.z_hat - u.z, w.z_hat))]

    def entries(self, u: Fields) -> list[Entry]:
        return []


class Conjugates(Transport):
    """int (zeta - phi'(z)) : X = 0: zeta is the cellwise L2 projection of the conjugates."""

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        slope = self.energy.tested_slope(u, w)
        return [Integrand(inner(u.zeta, w.zeta)), *(Integrand(-part) for part in slope)]

    def entries(self, u: Fields) -> list[Entry]:
        """No power; the share of a quadratic regularisation in the stored energy, for information."""
        if isinstance(self.material, WithQuadratic):
            added = Integrand(self.material.added_energy(u.z_tensors))
            return [Entry("stored_quadratic", "monitor", added)]
        return []


class ElasticForce(Transport):
    """+ B_h(w; z, zeta) in the momentum equation: int T : grad w for smooth fields
    (paper: Cauchy-stress-polyconvex in Euler-large-viscoelastodyn+1disc).

    No entry of its own: at w = v it is the rate of the stored energy.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        return self.operator(w, u, u.zeta, u.zeta_tensors, u)

    def entries(self, u: Fields) -> list[Entry]:
        return []

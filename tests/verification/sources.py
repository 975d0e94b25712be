"""Sources that make the exact fields solutions: strong residuals, put into the system as a further term.

With the *discrete* time derivative (z(t) - z(t - tau))/tau what remains is the error in space; with a
tau of the sources that is far shorter than the run's, the error in time is in it too.
"""

from unittest.mock import patch

from ngsolve import CF, CoefficientFunction, specialcf

from ngvisco.forms.context import inner_facets, time
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand
from ngvisco.physics.loads import Gravity, as_vector
from ngvisco.physics.material import Material, mandel_stress
from ngvisco.physics.materials.thermal import entropy_in, temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Flow, Model
from ngvisco.physics.tensors import embed_gradient, inner, sym, tr
from tests.verification.manufactured import COORDINATES, Exact, divergence, gradient


class Sources:
    """Strong residuals of the exact fields, and the term that puts them into the system.

    The momentum form is that of the momentum equation minus v/2 times the continuity equation, and so
    is its source.
    """

    def __init__(self, model: Model, dim: int, tau: float, curved: bool = False) -> None:
        self.model, self.dim, self.tau = model, dim, tau
        self.new, self.old = Exact(model, dim, time, curved), Exact(model, dim, time - tau, curved)

    @property
    def continuity(self) -> CoefficientFunction:
        """(rho - rho_old)/tau + div(rho v - delta |grad rho|^{r-2} grad rho)."""
        new, old = self.new, self.old
        flux = new.rho * new.v
        if self.diffusive_flux is not None:
            flux = flux - self.diffusive_flux
        return (new.rho - old.rho) / self.tau + sum(d[i] for i, d in enumerate(gradient(flux, self.dim)))

    @property
    def diffusive_flux(self) -> CoefficientFunction | None:
        """delta |grad rho|^{r-2} grad rho, None without it."""
        law = self.model.regularisation
        if law is None or not law.delta_density:
            return None
        slope = CF(tuple(gradient(self.new.rho, self.dim)))
        return law.diffusivity(slope * slope) * slope

    @property
    def kinematics(self) -> CoefficientFunction:
        """(z - z_old)/tau + (v.grad) z - rate(z; L, Pi) - delta Laplace z, components; of the entropy less
        what heats it."""
        new, old, model = self.new, self.old, self.model
        values, L = new.values, embed_gradient(new.grad_v, self.dim)
        material = model.material
        creep = {name: self._creep_rate(flow) for flow in model.flows for name in flow.names}
        rates = {v.name: material.rate(v, values, L, creep.get(v.name, 0 * L)) for v in material.variables}
        for v in material.variables:
            if v.by_flux:
                rates[v.name] = rates[v.name] - tr(L) * values[v.name]
        if (entropy := entropy_in(material)) is not None:
            heat = self.heating(self._creep_rate(model.flows[0]) if model.flows else 0 * L)
            rates[entropy.name] = rates[entropy.name] + heat / new.conjugates[entropy.name]
        total = (new.z - old.z) / self.tau - model.material.states(self.dim).components(rates)
        for v_j, dz in zip((new.v[j] for j in range(self.dim)), gradient(new.z, self.dim), strict=True):
            total = total + v_j * dz
        if self._delta_fields:
            for s, dz in zip(COORDINATES, gradient(new.z, self.dim), strict=False):
                total = total - self._delta_fields * dz.Diff(s)
        return total

    def heating(self, Pi: CoefficientFunction) -> CoefficientFunction:
        """xi + div(kappa grad theta), W/m^3, xi of all that dissipates but the delta-terms."""
        model, new, dim = self.model, self.new, self.dim
        total = CF(0.0)
        if model.viscosity is not None:
            total = total + inner(self._viscous_stress, embed_gradient(new.grad_v, dim))
        if model.hyperviscosity is not None:
            total = (
                total + model.hyperviscosity.coefficient(self._hess_square, new.values) * self._hess_square
            )
        if model.creep is not None:
            total = total + inner(self._mandel, Pi)
        if model.regularisation is not None and model.regularisation.epsilon:
            speed = new.v * new.v
            total = total + model.regularisation.friction(speed) * speed
        theta = temperature(model.material, new.conjugates)
        if model.heat is not None and theta is not None:
            flux = model.heat.flux(theta, CF(tuple(gradient(theta, dim))), dim)
            total = total + sum((d[i] for i, d in enumerate(gradient(flux, dim))), CF(0.0))
        return total

    @property
    def _hess(self) -> list[list[CoefficientFunction]]:
        """d_j grad v_i, of i and j."""
        return [[gradient(d, self.dim) for d in gradient(self.new.v[i], self.dim)] for i in range(self.dim)]

    @property
    def _hess_square(self) -> CoefficientFunction:
        """|hess v|^2."""
        return sum(h * h for component in self._hess for row in component for h in row)

    def _creep_rate(self, flow: Flow) -> CoefficientFunction:
        """Pi, of a body by the Mandel stress per its own volume."""
        if not flow.rule.is_local:
            return self.new.Pi
        values, conjugates = self.new.values, self.new.conjugates
        mandel = mandel_stress(self.model.material, values, conjugates, self.dim, flow.names)
        return flow.rule.rate((1 / flow.share(values)) * mandel, None, values)

    @property
    def _mandel(self) -> CoefficientFunction:
        return mandel_stress(self.model.material, self.new.values, self.new.conjugates, self.dim)

    @property
    def creep(self) -> CoefficientFunction | None:
        """psi'(Pi) - div(nu |grad Pi|^{q-2} grad Pi) - M, 3x3; None where Pi is no field of its own."""
        creep = self.model.creep
        if creep is None or creep.is_local:
            return None
        slopes = gradient(self.new.Pi, self.dim)
        coefficient = creep.gradient_coefficient(
            sum((inner(d, d) for d in slopes[1:]), inner(slopes[0], slopes[0]))
        )
        total = creep.force(self.new.Pi, self.new.values) - self._mandel
        for s, d in zip(COORDINATES, slopes, strict=False):
            total = total - (coefficient * d).Diff(s)
        return total

    @property
    def _delta_fields(self) -> float:
        law = self.model.regularisation
        return 0.0 if law is None else law.delta_fields

    def inertia(self) -> CoefficientFunction:
        """(rho v - rho_old v_old)/tau + div(rho v x v)."""
        new, old, dim = self.new, self.old, self.dim
        flux = new.rho * new.v
        rate = (flux - old.rho * old.v) / self.tau
        products = CF(tuple(flux[i] * new.v[j] for i in range(dim) for j in range(dim)), dims=(dim, dim))
        return rate + divergence(products, dim)

    def elastic(self) -> CoefficientFunction:
        """-div T."""
        return -divergence(self.new.stress, self.dim)

    def viscous(self) -> CoefficientFunction:
        """-div(D eps(v)) + div div(c(|hess v|^2) hess v)."""
        model, new, dim = self.model, self.new, self.dim
        total = CF(tuple([0.0] * dim))
        if model.viscosity is not None:
            total = total - divergence(self._viscous_stress, dim)
        if model.hyperviscosity is not None:
            hess, c = self._hess, model.hyperviscosity.coefficient(self._hess_square, new.values)
            force = []
            for i in range(dim):
                terms = [
                    (c * hess[i][j][k]).Diff(COORDINATES[k]).Diff(COORDINATES[j])
                    for j in range(dim)
                    for k in range(dim)
                ]
                force.append(sum(terms[1:], terms[0]))
            total = total + CF(tuple(force))
        return total

    @property
    def _viscous_stress(self) -> CoefficientFunction:
        assert self.model.viscosity is not None
        rate = sym(embed_gradient(self.new.grad_v, self.dim))
        return self.model.viscosity.stress(rate, self.new.values)

    def gravity(self) -> CoefficientFunction:
        """-rho g."""
        total = CF(tuple([0.0] * self.dim))
        for load in self.model.loads:
            assert isinstance(load, Gravity)
            total = total - self.new.rho * as_vector(load.g, self.dim, "Gravity.g")
        return total

    def regularising(self) -> CoefficientFunction:
        """epsilon |v|^{p-2} v + delta |grad rho|^{r-2} (grad v) grad rho."""
        law, new, dim = self.model.regularisation, self.new, self.dim
        total = CF(tuple([0.0] * dim))
        if law is not None and law.epsilon:
            total = total + law.friction(new.v * new.v) * new.v
        if self.diffusive_flux is not None:
            total = total + new.grad_v * self.diffusive_flux
        return total

    @property
    def momentum(self) -> CoefficientFunction:
        """The strong momentum equation's residual."""
        return self.inertia() + self.elastic() + self.viscous() + self.gravity() + self.regularising()

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        force = self.momentum - 0.5 * self.continuity * self.new.v
        creep = self.creep
        return [
            *([] if self.model.bodies else [Integrand(-self.continuity * w.rho)]),
            Integrand(-inner(force, w.v)),
            Integrand(-inner(self.kinematics, w.z)),
            *([] if creep is None else [Integrand(-inner(creep, w.Pi))]),
            *self._through_walls(u, w),
        ]

    def _through_walls(self, u: Fields, w: Fields) -> list[Integrand]:
        """The delta-terms' fluxes through walls, which the exact fields do not meet as zero; nor do they
        the traction on curved ones."""
        law = self.model.regularisation
        parts: list[Integrand] = []
        on_wall, n = 1.0 - inner_facets(u.layout.mesh), specialcf.normal(self.dim)
        if self.new.curved:
            stress = self.new.stress + self._viscous_stress
            traction = [sum(stress[i, j] * n[j] for j in range(self.dim)) for i in range(self.dim)]
            parts.append(Integrand(facets=-on_wall * inner(CF(tuple(traction)), w.v)))
        if law is None:
            return parts
        if self.diffusive_flux is not None:
            flux = on_wall * (self.diffusive_flux * n)
            parts.append(Integrand(facets=-flux * w.rho_delta_hat))
            parts.append(Integrand(facets=0.5 * flux * inner(self.new.v, w.v)))
        if law.delta_fields:
            slopes = gradient(self.new.z, self.dim)
            across = slopes[0] * n[0]
            for i in range(1, self.dim):
                across = across + slopes[i] * n[i]
            parts.append(Integrand(facets=-law.delta_fields * on_wall * inner(across, w.z)))
        return parts

    def entries(self, u: Fields) -> list[Entry]:
        """None: these runs are compared with their exact solutions, not balanced."""
        return []


class TakingPartWholly(Sources):
    """For negative controls: a trace of a body is stretched as a body is."""

    @property
    def kinematics(self) -> CoefficientFunction:
        with patch.object(Mixture, "taking_part", Material.taking_part):
            return super().kinematics

"""Diffusion of a variable of the material, and its exchange through walls."""

from collections.abc import Sequence

from ngsolve import CF, CoefficientFunction

from ngvisco.forms.boundary.boundaries import check_boundary_names, facet_indicator
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Term
from ngvisco.forms.terms.fluxes import Flux, component
from ngvisco.physics.diffusion import Diffusion, WallExchange
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner


class Spreading(Flux):
    """Diffusion -div(M grad mu) in the equation of c, mu = zeta_c; dissipates M |grad mu|^2 + penalty."""

    def __init__(self, law: Diffusion) -> None:
        self.law, self.name = law, law.variable

    def potential(self, u: Fields) -> CoefficientFunction:
        return u.zeta_tensors[self.name]

    def flux(self, u: Fields) -> CoefficientFunction:
        return self.law.mobility * component(u, self.name, u.grad_zeta)

    def size(self, u: Fields) -> CoefficientFunction:
        return self.law.mobility

    def chi(self, u: Fields, w: Fields) -> CoefficientFunction:
        return w.z_tensors[self.name]

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.flux(u), component(w, self.name, w.grad_z))]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        slope = component(u, self.name, u.grad_zeta)
        return {f"dissipation_diffusion_{self.name}": inner(self.flux(u), slope)}

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        return {f"dissipation_diffusion_{self.name}": -(self.into(u) * self.potential(u))}

    def entries(self, u: Fields) -> list[Entry]:
        """The dissipation, and the amount of the variable as a monitor."""
        total = Entry(f"amount_{self.name}", "monitor", Integrand(u.z_tensors[self.name]))
        return [*super().entries(u), total]


class ThroughWall(PointTerm):
    """Inflow -int_Gamma h q through one wall, h = flux + coefficient (potential - mu)."""

    couples = "facet"

    def __init__(self, walls: Walls, variable: str, name: str, exchange: WallExchange) -> None:
        self.name, self.variable = name, variable
        given = (exchange.potential, exchange.coefficient, exchange.flux)
        self._given = [CF(0.0 if value is None else value) for value in given]
        self._indicator = facet_indicator(walls.mesh, [name])

    def _inwards(self, u: Fields) -> CoefficientFunction:
        """Inflow h on the wall, zero elsewhere."""
        indicator, *values = map(u.context.given, (self._indicator, *self._given))
        potential, coefficient, flux = values
        return indicator * (flux + coefficient * (potential - u.zeta_tensors[self.variable]))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self._inwards(u) * w.z_tensors[self.variable])]

    def entries(self, u: Fields) -> list[Entry]:
        """Power and amount of the matter that diffuses in through the wall."""
        name, inwards = f"{self.variable}_{self.name}", self._inwards(u)
        power = Integrand(facets=inwards * u.zeta_tensors[self.variable])
        exchanged = Entry(f"exchange_{name}", "monitor", Integrand(facets=inwards))
        return [Entry(f"power_exchange_{name}", "power", power), exchanged]


def diffusion_terms(model: Model, walls: Walls) -> list[Term]:
    """The terms of a model's diffusion.

    Raises ParameterError for a wall that the mesh lacks.
    """
    law = model.diffusion
    if law is None:
        return []
    check_boundary_names(walls.mesh, law.walls, "Diffusion.walls")
    at_walls = (ThroughWall(walls, law.variable, name, at) for name, at in law.walls.items())
    return [*Spreading(law).terms, *at_walls]

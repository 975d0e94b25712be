"""Diffusion of a variable of the material, and its exchange through walls."""

from collections.abc import Sequence

from ngsolve import CoefficientFunction

from ngvisco.forms.boundary.boundaries import check_boundary_names
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Term
from ngvisco.forms.terms.fluxes import Flux, WallFlux, component
from ngvisco.physics.diffusion import Diffusion, WallExchange
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner


class Spreading(Flux):
    """Diffusion -div(M grad mu) in the equation of c, with mu = zeta_c; it dissipates M |grad mu|^2 +
    penalty."""

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
        self._inwards = WallFlux(walls.mesh, name, exchange.potential, exchange.coefficient, exchange.flux)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self._inwards.at(u, u.zeta_tensors[self.variable]) * w.z_tensors[self.variable])]

    def entries(self, u: Fields) -> list[Entry]:
        """Power and amount of the matter that diffuses in through the wall."""
        name, potential = f"{self.variable}_{self.name}", u.zeta_tensors[self.variable]
        inwards = self._inwards.at(u, potential)
        power = Integrand(facets=inwards * potential)
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

"""Heat: what is dissipated, supplied and conducted, in the equation of the entropy.

The entropy s, a number of its unit u (``ngvisco.physics.materials.thermal``), is a variable of the material
that is transported by its flux; zeta_s = u theta is its projected conjugate, theta the temperature.  With xi
what all mechanisms dissipate, chi = q/zeta_s, q the test of s,

    int (s - s_old)/tau q - B_h(v; s, q) = int xi chi - a(theta, chi) + int_Gamma h chi.

q = zeta_s gives int xi + int_Gamma h, whatever mesh, step and order: all that is dissipated arrives as heat,
and the total energy changes by the power of loads and walls alone.  q = 1 gives the production of entropy,
int xi/theta - a(theta, 1/theta), and what comes with the heat through walls.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import (
    PLACES,
    PRODUCTION,
    Entry,
    Integrand,
    PointTerm,
    Term,
    Where,
    dissipations,
)
from ngvisco.forms.terms.fluxes import Flux, component
from ngvisco.physics.heat import HeatLaw, WallHeat
from ngvisco.physics.materials.thermal import Entropy, entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, square


class _OfEntropy(PointTerm):
    """A term in the equation of the entropy."""

    def __init__(self, law: HeatLaw, entropy: Entropy) -> None:
        self.law, self.entropy = law, entropy

    def zeta(self, u: Fields) -> CoefficientFunction:
        """The conjugate of the number s, Pa."""
        return u.zeta_tensors[self.entropy.name]

    def theta(self, u: Fields) -> CoefficientFunction:
        """The temperature, K."""
        return (1 / self.entropy.unit) * self.zeta(u)

    def chi(self, u: Fields, w: Fields) -> CoefficientFunction:
        """q/zeta_s."""
        return w.z_tensors[self.entropy.name] / self.zeta(u)

    def grad_theta(self, u: Fields) -> CoefficientFunction:
        """K/m."""
        return (1 / self.entropy.unit) * component(u, self.entropy.name, u.grad_zeta)


class Heating(_OfEntropy):
    """-int xi q/zeta_s: all that is dissipated, and sources."""

    def __init__(self, law: HeatLaw, entropy: Entropy, walls: Walls) -> None:
        super().__init__(law, entropy)
        self._sources = [(body, CF(source)) for body, source in law.sources]
        heats = ((name, wall.heat) for name, wall in walls.conditions.items() if wall.heat is not None)
        self._to_walls = {name: 1 - heat.friction_share for name, heat in heats if heat.friction_share < 1}
        """The share of the friction heat that goes into each wall."""

    def _supplied(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Sources of heat in cells beside what is dissipated, W/m^3, by the ledger's columns."""
        found = {}
        if self._sources:
            given = u.context.given
            parts = (self.law.share(body, u.z_tensors) * given(source) for body, source in self._sources)
            found["power_heat_source"] = reduce(add, parts)
        if self.law.numerical_heating:  # what a backward Euler step dissipates, J/m^3
            c, old = u.context, u.context.old
            dv = u.v - (1 / old.rho) * c.momentum_old
            bregman = c.rates.stored(old) - c.rates.stored(u) - inner(u.zeta, old.z - u.z)
            found["power_heat_numerical"] = c.rate(0.5 * old.rho * square(dv) + bregman)
        return found

    def _taken_by_walls(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Heat of friction that stays in walls, W/m^2, by the ledger's columns."""
        found = {}
        dissipated = dissipations(u, self, "facets") if self._to_walls else {}
        for name, share in self._to_walls.items():
            if (friction := dissipated.get(f"dissipation_friction_{name}")) is None:
                expected = "1 on a wall without friction, as NavierFriction or Traction(friction=...) have"
                raise ParameterError(f"walls[{name!r}].heat.friction_share", 1 - share, expected)
            found[f"power_heat_friction_{name}"] = -share * friction
        return found

    def _rows(
        self, u: Fields, w: Fields, where: Where, others: Mapping[str, CoefficientFunction]
    ) -> Sequence[CoefficientFunction]:
        """Rows of the entropy for dissipation and other heat at these places."""
        heat = [*dissipations(u, self, where).values(), *others.values()]
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "cells", self._supplied(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "facets", self._taken_by_walls(u))

    def nodes(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "nodes", {})

    def entries(self, u: Fields) -> list[Entry]:
        """The heat as powers, since it is a part of the energy; entropy, and what produces and brings it."""
        places, theta = [dissipations(u, self, place) for place in PLACES], self.theta(u)
        names = dict.fromkeys(name for heat in places for name in heat)
        self._require_all(set(names), u)
        powers, produced = [], []
        if names:
            total = [reduce(add, heat.values()) if heat else None for heat in places]
            powers.append(Entry("power_heat_dissipated", "power", Integrand(*total)))
        for name in names:
            parts = [heat[name] / theta if name in heat else None for heat in places]
            column = PRODUCTION + name.removeprefix("dissipation_")
            produced.append(Entry(column, "production", Integrand(*parts)))
        for place, others in (("cells", self._supplied(u)), ("facets", self._taken_by_walls(u))):
            for name, heat in others.items():
                column = name.replace("power_heat_", "entropy_supply_")
                if name == "power_heat_numerical":
                    column = PRODUCTION + "numerical"
                powers.append(Entry(name, "power", Integrand(**{place: heat})))
                produced.append(Entry(column, "production", Integrand(**{place: heat / theta})))
        entropy = self.entropy.unit * u.z_tensors[self.entropy.name]
        return [*powers, Entry("entropy", "monitor", Integrand(entropy)), *produced]

    def _require_all(self, known: set[str], u: Fields) -> None:
        """Raise ParameterError for a term whose dissipation stands in its columns alone."""
        for term in u.context.terms:
            for entry in () if term is self else term.entries(u):
                if entry.kind == "dissipation" and entry.name not in known and not entry.is_outside:
                    name = type(term).__name__
                    expected = f"{name}: {entry.name!r} stated by ``dissipated``, from which heat is made"
                    raise ParameterError("Simulation.terms", name, expected)


class HeatThroughWall(_OfEntropy):
    """-int_Gamma h q/zeta_s on one wall, h what comes in, W/m^2:

    flux + coefficient (temperature - theta).
    """

    couples = "facet"

    def __init__(self, law: HeatLaw, entropy: Entropy, walls: Walls, name: str, heat: WallHeat) -> None:
        super().__init__(law, entropy)
        self.name = name
        given = (heat.temperature, heat.coefficient, heat.flux)
        self._given = [CF(0.0 if value is None else value) for value in given]
        self._indicator = facet_indicator(walls.mesh, [name])

    def _heat(self, u: Fields) -> CoefficientFunction:
        """h on the wall, zero elsewhere."""
        indicator, *values = map(u.context.given, (self._indicator, *self._given))
        temperature, coefficient, flux = values
        return indicator * (flux + coefficient * (temperature - self.theta(u)))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self._heat(u) * self.chi(u, w))]

    def entries(self, u: Fields) -> list[Entry]:
        heat = self._heat(u)
        return [
            Entry(f"power_heat_{self.name}", "power", Integrand(facets=heat)),
            Entry(f"entropy_supply_{self.name}", "production", Integrand(facets=heat / self.theta(u))),
        ]


class Conduction(_OfEntropy, Flux):
    """a(theta, chi), chi = q/zeta_s: heat conduction by ``Flux``, with the potential theta.

    For chi = 1/theta the term that is left out there doubles one without a sign.
    """

    name = "heat"

    def potential(self, u: Fields) -> CoefficientFunction:
        return self.theta(u)

    def flux(self, u: Fields) -> CoefficientFunction:
        """kappa grad theta, W/m^2."""
        return self.law.flux(self.theta(u), self.grad_theta(u), u.z_tensors, u.dim)

    def size(self, u: Fields) -> CoefficientFunction:
        """kappa, of a matrix its largest eigenvalue, W/(m K)."""
        return self.law.size(self.theta(u), u.z_tensors)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        zeta, flux = self.zeta(u), self.flux(u)
        along = inner(flux, component(u, self.entropy.name, u.grad_zeta)) / (zeta * zeta)
        grad_q = component(w, self.entropy.name, w.grad_z)
        return [inner((1 / zeta) * flux, grad_q), -(along * w.z_tensors[self.entropy.name])]

    def entries(self, u: Fields) -> list[Entry]:
        """No power, for it keeps the heat."""
        theta = self.theta(u)
        cells = inner(self.flux(u), self.grad_theta(u)) / (theta * theta)
        return [Entry(PRODUCTION + "conduction", "production", Integrand(cells, self.into(u) / theta))]


def heat_terms(model: Model, walls: Walls) -> list[Term]:
    """The terms of heat, for a model whose material has a temperature."""
    entropy = entropy_in(model.material)
    if entropy is None:
        for name, wall in walls.conditions.items():
            if wall.heat is not None:
                expected = "None for a material without a temperature; nv.Thermal(material=...) gives it one"
                raise ParameterError(f"walls[{name!r}].heat", wall.heat, expected)
        return []
    law = model.heat_law
    heats = ((name, wall.heat) for name, wall in walls.conditions.items() if wall.heat is not None)
    through = (HeatThroughWall(law, entropy, walls, name, heat) for name, heat in heats)
    heating = Heating(law, entropy, walls)
    if model.regularisation is not None and model.regularisation.delta_fields > 0:
        heating.coupled_only = "what delta_fields dissipates is made of phi'' by forms"
    terms: list[Term] = [heating, *through]
    return terms + (Conduction(law, entropy).terms if law.conducts else [])

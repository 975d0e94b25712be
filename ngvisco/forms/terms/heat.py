"""Heat in the equation of the entropy: dissipation, supply and conduction.

The entropy s, a number in its unit u (``ngvisco.physics.materials.thermal``), is a variable of the material
that is transported by its flux; zeta_s = u theta is its projected conjugate, theta the temperature.  With the
dissipation xi of all mechanisms, the test q of s, and chi = q/zeta_s,

    int (s - s_old)/tau q - B_h(v; s, q) = int xi chi - a(theta, chi) + int_Gamma h chi.

q = zeta_s gives int xi + int_Gamma h for any mesh, step and order: all dissipation becomes heat, and only the
power of loads and walls changes the total energy.  q = 1 gives the production of entropy, int xi/theta -
a(theta, 1/theta), and the entropy that heat carries through walls.
"""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import add

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PLACES, PRODUCTION, Entry, Integrand, PointRule, PointTerm, Term, dissipations
from ngvisco.forms.terms.fluxes import Flux, WallFlux, component
from ngvisco.physics.heat import HeatLaw, WallHeat
from ngvisco.physics.materials.thermal import NO_TEMPERATURE, Entropy, entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, square
from ngvisco.words import call


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
        """The test of the heat, q/zeta_s."""
        return w.z_tensors[self.entropy.name] / self.zeta(u)

    def grad_theta(self, u: Fields) -> CoefficientFunction:
        """Gradient of the temperature, K/m."""
        return (1 / self.entropy.unit) * component(u, self.entropy.name, u.grad_zeta)


class Heating(_OfEntropy):
    """Heating -int xi q/zeta_s by all dissipation and by sources."""

    def __init__(self, law: HeatLaw, entropy: Entropy, walls: Walls) -> None:
        super().__init__(law, entropy)
        self._sources = [(body, CF(source)) for body, source in law.sources]
        heats = ((name, wall.heat) for name, wall in walls.conditions.items() if wall.heat is not None)
        self._to_walls = {name: 1 - heat.friction_share for name, heat in heats if heat.friction_share < 1}
        """The share of the friction heat that goes into each wall."""

    def _supplied(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Sources of heat in cells other than dissipation, W/m^3, by the ledger's columns."""
        powers = {}
        if self._sources:
            given = u.context.given
            parts = (self.law.share(body, u.z_tensors) * given(source) for body, source in self._sources)
            powers["power_heat_source"] = reduce(add, parts)
        if self.law.numerical_heating:  # the numerical dissipation of backward Euler, J/m^3, is a source, too
            c, old = u.context, u.context.old
            dv = u.v - (1 / old.rho) * c.momentum_old
            bregman = c.rates.stored(old) - c.rates.stored(u) - inner(u.zeta, old.z - u.z)
            powers["power_heat_numerical"] = c.rate(0.5 * old.rho * square(dv) + bregman)
        return powers

    def _taken_by_walls(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Heat of friction that stays in walls, W/m^2, by the ledger's columns."""
        powers = {}
        dissipated = dissipations(u, self, "facets") if self._to_walls else {}
        for name, share in self._to_walls.items():
            if (friction := dissipated.get(f"dissipation_friction_{name}")) is None:
                advice = "1, the default, on a wall without friction; NavierFriction and "
                expected = (advice, call("Traction", friction=...))
                raise ParameterError(
                    f"walls[{name!r}].heat.friction_share", 1 - share, *expected, " have friction"
                )
            powers[f"power_heat_friction_{name}"] = -share * friction
        return powers

    def _rows(
        self, u: Fields, w: Fields, where: PointRule, further: Mapping[str, CoefficientFunction]
    ) -> Sequence[CoefficientFunction]:
        """Rows of the entropy equation: the dissipation and the heat in ``further``, times the test of heat.
        ``where`` says whether they are in cells, on facets or at collocation points."""
        heat = [*dissipations(u, self, where).values(), *further.values()]
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "cells", self._supplied(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "facets", self._taken_by_walls(u))

    def collocated(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "collocated", {})

    def entries(self, u: Fields) -> list[Entry]:
        """Powers of the heat, which is a part of the energy; and the entropy with its productions and
        supplies."""
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
        for place, further in (("cells", self._supplied(u)), ("facets", self._taken_by_walls(u))):
            for name, heat in further.items():
                column = name.replace("power_heat_", "entropy_supply_")
                if name == "power_heat_numerical":
                    column = PRODUCTION + "numerical"
                powers.append(Entry(name, "power", Integrand(**{place: heat})))
                produced.append(Entry(column, "production", Integrand(**{place: heat / theta})))
        entropy = self.entropy.unit * u.z_tensors[self.entropy.name]
        return [*powers, Entry("entropy", "monitor", Integrand(entropy)), *produced]

    def _require_all(self, dissipations: set[str], u: Fields) -> None:
        """Raise ParameterError for a term with a ledger column of dissipation that its ``dissipated``
        lacks."""
        for term in u.context.terms:
            for entry in () if term is self else term.entries(u):
                if entry.kind == "dissipation" and entry.name not in dissipations and not entry.is_outside:
                    name = type(term).__name__
                    expected = (
                        f"a term whose method dissipated returns {entry.name!r}, since this dissipation "
                        "heats the material"
                    )
                    raise ParameterError("Simulation.terms", name, expected)


class HeatThroughWall(_OfEntropy):
    """Heat -int_Gamma h q/zeta_s through one wall, with the inflow, W/m^2,

    h = flux + coefficient (temperature - theta).
    """

    couples = "facet"

    def __init__(self, law: HeatLaw, entropy: Entropy, walls: Walls, name: str, heat: WallHeat) -> None:
        super().__init__(law, entropy)
        self.name = name
        self._inwards = WallFlux(walls.mesh, name, heat.temperature, heat.coefficient, heat.flux)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self._inwards.at(u, self.theta(u)) * self.chi(u, w))]

    def entries(self, u: Fields) -> list[Entry]:
        heat, (indicator, _, coefficient, _) = self._inwards.at(u, self.theta(u)), self._inwards.values(u)
        outwards = Integrand(facets=indicator * coefficient * self.theta(u))
        supply = Entry(f"entropy_supply_{self.name}", "production", Integrand(facets=heat / self.theta(u)))
        return [
            Entry(f"power_heat_{self.name}", "power", Integrand(facets=heat), difference_of=outwards),
            supply,
        ]


class Conduction(_OfEntropy, Flux):
    """Heat conduction a(theta, chi), chi = q/zeta_s, by ``Flux`` with the potential theta.

    ``Flux`` leaves out the symmetrising term: for chi = 1/theta it would double a term that has no sign.
    """

    name = "heat"

    def potential(self, u: Fields) -> CoefficientFunction:
        return self.theta(u)

    def flux(self, u: Fields) -> CoefficientFunction:
        """Flux kappa grad theta, W/m^2."""
        return self.law.flux(self.theta(u), self.grad_theta(u), u.z_tensors, u.dim)

    def size(self, u: Fields) -> CoefficientFunction:
        """Conductivity kappa, W/(m K); for a matrix its largest eigenvalue."""
        return self.law.size(self.theta(u), u.z_tensors)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        zeta, flux = self.zeta(u), self.flux(u)
        along = inner(flux, component(u, self.entropy.name, u.grad_zeta)) / (zeta * zeta)
        grad_q = component(w, self.entropy.name, w.grad_z)
        return [inner((1 / zeta) * flux, grad_q), -(along * w.z_tensors[self.entropy.name])]

    def entries(self, u: Fields) -> list[Entry]:
        """Production of entropy; conduction has no power, since it conserves heat."""
        theta = self.theta(u)
        cells = inner(self.flux(u), self.grad_theta(u)) / (theta * theta)
        return [Entry(PRODUCTION + "conduction", "production", Integrand(cells, self.into(u) / theta))]


def heat_terms(model: Model, walls: Walls) -> list[Term]:
    """The terms of heat, for a model whose material has a temperature."""
    entropy = entropy_in(model.material)
    heats = [(name, wall.heat) for name, wall in walls.conditions.items() if wall.heat is not None]
    if entropy is None:
        for name, heat in heats:
            raise ParameterError(f"walls[{name!r}].heat", heat, NO_TEMPERATURE)
        return []
    law = model.heat_law
    at_walls = (HeatThroughWall(law, entropy, walls, name, heat) for name, heat in heats)
    heating = Heating(law, entropy, walls)
    if model.regularisation is not None and model.regularisation.delta_fields > 0:
        heating.coupled_only = "the dissipation of delta_fields is a form of phi''"
    terms: list[Term] = [heating, *at_walls]
    return terms + (Conduction(law, entropy).terms if law.conducts else [])

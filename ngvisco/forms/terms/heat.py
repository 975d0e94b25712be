"""Heat: what is dissipated, supplied and conducted, in the equation of the entropy.

The entropy s, a number of its unit u (``ngvisco.physics.materials.thermal``), is a variable of the material
that is transported by its flux; zeta_s = u theta is its projected conjugate, theta the temperature.  With xi
what all mechanisms dissipate, chi = q/zeta_s, q the test of s,

    int (s - s_old)/tau q - B_h(v; s, q) = int xi chi - a(theta, chi) + int_Gamma h chi.

q = zeta_s gives int xi + int_Gamma h, whatever mesh, step and order: all that is dissipated arrives as heat,
and the total energy changes by the power of loads and walls alone.  q = 1 gives the production of entropy,
int xi/theta - a(theta, 1/theta), and what comes with the heat through walls.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add

import numpy as np
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
    Setting,
    Term,
    Unknown,
    dissipations,
)
from ngvisco.forms.upwinding import SideMean
from ngvisco.physics.heat import HeatLaw
from ngvisco.physics.materials.thermal import Entropy, entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, linear_map, square


def penalty_weight(m: int) -> float:
    """s of the interior penalty p = s kappa/h for fields in P_m."""
    return 2.0 * (m + 1) ** 2


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

    def _row(self, u: Fields, of: CoefficientFunction) -> CoefficientFunction:
        """The row of the entropy in a gradient of all components."""
        row = np.zeros((u.layout.states.size, 1))
        row[u.layout.states.slices[self.entropy.name]] = 1.0
        return linear_map(np.kron(row.T, np.eye(u.dim)), of, (u.dim,))

    def grad_theta(self, u: Fields) -> CoefficientFunction:
        """K/m."""
        return (1 / self.entropy.unit) * self._row(u, u.grad_zeta)

    def flux(self, u: Fields) -> CoefficientFunction:
        """kappa grad theta, W/m^2."""
        return self.law.flux(self.theta(u), self.grad_theta(u), u.z_tensors, u.dim)

    def conductivity(self, u: Fields) -> CoefficientFunction:
        """kappa, of a matrix its largest eigenvalue, W/(m K)."""
        return self.law.size(self.theta(u), u.z_tensors)


class Heating(_OfEntropy):
    """-int xi q/zeta_s: all that is dissipated, sources, and what comes through walls."""

    def __init__(self, law: HeatLaw, entropy: Entropy, walls: Walls) -> None:
        super().__init__(law, entropy)
        self._sources = [(body, CF(source)) for body, source in law.sources]
        of_walls = {name: wall.heat for name, wall in walls.conditions.items() if wall.heat is not None}
        self._walls = {
            name: tuple(
                CF(0.0 if value is None else value)
                for value in (heat.temperature, heat.coefficient, heat.flux)
            )
            for name, heat in of_walls.items()
        }
        self._to_walls = {
            name: 1 - heat.friction_share for name, heat in of_walls.items() if heat.friction_share < 1
        }
        self._indicators = {name: facet_indicator(walls.mesh, [name]) for name in of_walls}

    def _supplied(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Sources of heat in cells beside what is dissipated, W/m^3, by the ledger's columns."""
        found = {}
        if self._sources:
            given = u.context.given
            parts = (self.law.share(body, u.z_tensors) * given(source) for body, source in self._sources)
            found["power_heat_source"] = reduce(add, parts)
        if self.law.numerical_heating:
            found["power_heat_numerical"] = u.context.rate(self._remainder(u))
        return found

    def _remainder(self, u: Fields) -> CoefficientFunction:
        """What a backward Euler step dissipates, J/m^3."""
        c = u.context
        old, rates = c.old, c.rates
        dv = u.v - (1 / old.rho) * c.momentum_old
        bregman = rates.stored(old) - rates.stored(u) - inner(u.zeta, old.z - u.z)
        return 0.5 * old.rho * square(dv) + bregman

    def _through_walls(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Heat that comes in through walls, W/m^2, by the ledger's columns."""
        found = {}
        for name, values in self._walls.items():
            temperature, coefficient, flux = (u.context.given(value) for value in values)
            heat = flux + coefficient * (temperature - self.theta(u))
            found[f"power_heat_{name}"] = u.context.given(self._indicators[name]) * heat
        if self._to_walls:
            dissipated = dissipations(u, self, "facets")
            for name, share in self._to_walls.items():
                friction = dissipated.get(f"dissipation_friction_{name}")
                if friction is None:
                    expected = (
                        "1 on a wall without friction, as NavierFriction or Traction(friction=...) have"
                    )
                    raise ParameterError(f"walls[{name!r}].heat.friction_share", 1 - share, expected)
                found[f"power_heat_friction_{name}"] = -share * friction
        return found

    @property
    def conducts(self) -> bool:
        """Whether heat goes from cell to cell or through walls."""
        return self.law.conducts or bool(self._walls)

    def exchange(self, u: Fields) -> list[CoefficientFunction]:
        """Heat transfer coefficients of walls, zero elsewhere, W/(m^2 K)."""
        given = u.context.given
        return [given(self._indicators[name]) * given(values[1]) for name, values in self._walls.items()]

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        heat = [*dissipations(u, self).values(), *self._supplied(u).values()]
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        heat = [*dissipations(u, self, "facets").values(), *self._through_walls(u).values()]
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def nodes(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        heat = dissipations(u, self, "nodes").values()
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def entries(self, u: Fields) -> list[Entry]:
        """The heat as powers, since it is a part of the energy; entropy, and what produces and brings it."""
        places = [dissipations(u, self, place) for place in PLACES]
        names = dict.fromkeys(name for heat in places for name in heat)
        self._require_all(set(names), u)
        supplied, through = self._supplied(u), self._through_walls(u)
        theta = self.theta(u)
        total = [reduce(add, heat.values()) if heat else None for heat in places]
        found = [
            *([Entry("power_heat_dissipated", "power", Integrand(*total))] if names else []),
            *(Entry(name, "power", Integrand(heat)) for name, heat in supplied.items()),
            *(Entry(name, "power", Integrand(facets=heat)) for name, heat in through.items()),
            Entry("entropy", "monitor", Integrand(self.entropy.unit * u.z_tensors[self.entropy.name])),
        ]
        for name in names:
            parts = [None if name not in heat else heat[name] / theta for heat in places]
            column = PRODUCTION + name.removeprefix("dissipation_")
            found.append(Entry(column, "production", Integrand(*parts)))
        for name, heat in supplied.items():
            column = name.replace("power_heat_", "entropy_supply_")
            if name.endswith("_numerical"):
                column = PRODUCTION + "numerical"
            found.append(Entry(column, "production", Integrand(heat / theta)))
        for name, heat in through.items():
            column = name.replace("power_heat_", "entropy_supply_")
            found.append(Entry(column, "production", Integrand(facets=heat / theta)))
        return found

    def _require_all(self, known: set[str], u: Fields) -> None:
        """Raise ParameterError for a term whose dissipation stands in its columns alone."""
        for term in u.context.terms:
            for entry in () if term is self else term.entries(u):
                if entry.kind == "dissipation" and entry.name not in known and not entry.is_outside:
                    name = type(term).__name__
                    expected = f"{name}: {entry.name!r} stated by ``dissipated``, from which heat is made"
                    raise ParameterError("Simulation.terms", name, expected)


class MeanTemperature(_OfEntropy, SideMean):
    """The mean of both sides' temperatures."""

    name = "theta_hat"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", setting.m),)

    def value(self, u: Fields) -> CoefficientFunction:
        return self.theta(u)


class MeanHeatFlux(_OfEntropy, SideMean):
    """The mean of kappa d_n theta - p (theta - theta_hat) of both sides: what their fluxes lack to cancel."""

    name = "heat_hat"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", setting.m),)

    def value(self, u: Fields) -> CoefficientFunction:
        c, theta = u.context, self.theta(u)
        weight = penalty_weight(u.layout.discretisation.m) * self.conductivity(u) / c.h
        return inner(self.flux(u), c.normal) - weight * (theta - u.parts["theta_hat"])


class Conduction(_OfEntropy):
    """a(theta, chi), chi = q/zeta_s: heat conduction by an interior penalty,

        sum_K int_K kappa grad theta . grad chi - sum_K int_{dK} (f - f_hat) chi,

    f = kappa d_n theta - p (theta - theta_hat), p = s kappa/h, theta_hat and f_hat the means of both sides.
    f - f_hat is half of the difference of both sides' f, the mean flux less p times half of the jump,
    opposite on both sides, so that chi = 1 gives zero: heat is kept to rounding.  On walls f_hat = f: they
    are insulated.  Incomplete: the term by which it would be symmetric in theta and chi is left out: for
    chi = 1 it is zero, and for chi = 1/theta it doubles the one without a sign.
    """

    def __init__(self, law: HeatLaw, entropy: Entropy, flux: MeanHeatFlux) -> None:
        super().__init__(law, entropy)
        self._mean = flux

    def _into(self, u: Fields) -> CoefficientFunction:
        """f - f_hat, W/m^2."""
        return u.context.inner * (self._mean.value(u) - u.parts[self._mean.name])

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        zeta, flux = self.zeta(u), self.flux(u)
        along = inner(flux, self._row(u, u.grad_zeta)) / (zeta * zeta)
        grad_q = self._row(w, w.grad_z)
        return [inner((1 / zeta) * flux, grad_q), -(along * w.z_tensors[self.entropy.name])]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self._into(u) * self.chi(u, w))]

    def entries(self, u: Fields) -> list[Entry]:
        """No power, for it keeps the heat."""
        theta = self.theta(u)
        cells = inner(self.flux(u), self.grad_theta(u)) / (theta * theta)
        return [Entry(PRODUCTION + "conduction", "production", Integrand(cells, self._into(u) / theta))]


def heat_terms(model: Model, walls: Walls) -> list[Term]:
    """Those of a model whose material has a temperature."""
    entropy = entropy_in(model.material)
    if entropy is None:
        for name, wall in walls.conditions.items():
            if wall.heat is not None:
                expected = "None for a material without a temperature; nv.Thermal(material=...) gives it one"
                raise ParameterError(f"walls[{name!r}].heat", wall.heat, expected)
        return []
    law = model.heat_law
    terms: list[Term] = [Heating(law, entropy, walls)]
    if law.conducts:
        flux = MeanHeatFlux(law, entropy)
        terms += [MeanTemperature(law, entropy), flux, Conduction(law, entropy, flux)]
    return terms

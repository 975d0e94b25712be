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
    Where,
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
        self._walls: dict[str, tuple[CoefficientFunction, ...]] = {}
        """Indicator, temperature, coefficient and flux of the walls that heat comes through."""
        self._to_walls: dict[str, float] = {}  # what of their friction walls take
        for name, wall in walls.conditions.items():
            if (heat := wall.heat) is not None:
                given = (heat.temperature, heat.coefficient, heat.flux)
                values = (CF(0.0 if value is None else value) for value in given)
                self._walls[name] = facet_indicator(walls.mesh, [name]), *values
                if heat.friction_share < 1:
                    self._to_walls[name] = 1 - heat.friction_share

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

    def _through_walls(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Heat that comes in through walls, W/m^2, by the ledger's columns."""
        found = {}
        for name, values in self._walls.items():
            indicator, temperature, coefficient, flux = (u.context.given(value) for value in values)
            heat = flux + coefficient * (temperature - self.theta(u))
            found[f"power_heat_{name}"] = indicator * heat
        dissipated = dissipations(u, self, "facets") if self._to_walls else {}
        for name, share in self._to_walls.items():
            if (friction := dissipated.get(f"dissipation_friction_{name}")) is None:
                expected = "1 on a wall without friction, as NavierFriction or Traction(friction=...) have"
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
        return [given(values[0]) * given(values[2]) for values in self._walls.values()]

    def _rows(
        self, u: Fields, w: Fields, where: Where, others: Mapping[str, CoefficientFunction]
    ) -> Sequence[CoefficientFunction]:
        """Rows of the entropy for dissipation and other heat at these places."""
        heat = [*dissipations(u, self, where).values(), *others.values()]
        return [-(reduce(add, heat) * self.chi(u, w))] if heat else []

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "cells", self._supplied(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w, "facets", self._through_walls(u))

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
        for place, others in (("cells", self._supplied(u)), ("facets", self._through_walls(u))):
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


class MeanTemperature(_OfEntropy, SideMean):
    """The mean of both sides' temperatures."""

    name = "theta_hat"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        """Raise ParameterError for constants in cells, whose fluxes by a penalty are not those of Fourier."""
        if setting.m == 0:
            expected = (
                "1 or 2 where heat is conducted: constants in cells have no gradient (or conductivity = 0)"
            )
            raise ParameterError("Discretisation.m", 0, expected)
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
    chi = 1 it is zero, and for chi = 1/theta it doubles the one without a sign.  Conduction is consistent for
    m >= 1; with m = 0 there is the penalty alone, whose flux depends on the cells' shapes however fine they
    are, and which is refused.
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
    """The terms of heat, for a model whose material has a temperature."""
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

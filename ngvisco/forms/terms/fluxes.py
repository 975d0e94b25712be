"""Fluxes down the gradient of a potential, through cells and facets.

Let mu be the potential, j = M grad mu the flux and chi a test. With an interior penalty, the term is

    int j . grad chi - sum_K int_{dK} (f - f_hat) chi,      f = j . n - p (mu - mu_hat), p = s M/h,

where mu_hat and f_hat are the means of both sides. f - f_hat is half of the difference of the two sides' f,
which is the mean of j . n over both sides, less p/2 times the jump of mu.  The difference has opposite signs
on the two sides, so that chi = 1 gives zero and the amount is conserved to rounding.  On walls f_hat = f, so
that nothing flows through them.  The penalty is incomplete: it omits the term that would make it symmetric in
mu and chi.  The flux is consistent for m >= 1.  m = 0 is refused, since the flux by the penalty alone depends
on the cells' shapes, however fine the mesh is.
"""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from ngsolve import CF, CoefficientFunction, Mesh

from ngvisco.errors import ParameterError, planar
from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm, Term
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.forms.upwinding import FacetMean
from ngvisco.physics.heat import Function
from ngvisco.physics.tensors import inner, linear_map


def penalty_weight(m: int) -> float:
    """Factor s of the interior penalty p = s M/h for fields in P_m."""
    return 2.0 * (m + 1) ** 2


def component(u: Fields, name: str, value: CoefficientFunction) -> CoefficientFunction:
    """The row of a scalar variable in a gradient of all components."""
    row = np.zeros((u.layout.states.size, 1))
    row[u.layout.states.slices[name]] = 1.0
    return linear_map(np.kron(row.T, np.eye(u.dim)), value, (u.dim,))


class WallFlux:
    """The flux into the body through one wall, flux + coefficient (outside - potential); zero elsewhere."""

    def __init__(self, mesh: Mesh, wall: str, *given: Function | None) -> None:
        """``given`` are ``outside``, the coefficient and the flux, in this order; None stands for zero.

        Raises ParameterError for a function that reads z in the plane."""
        functions = (planar(f"walls[{wall!r}]", CF(0.0 if f is None else f), mesh.dim) for f in given)
        self._given = facet_indicator(mesh, [wall]), *functions

    def values(self, u: Fields) -> Sequence[CoefficientFunction]:
        """The wall's indicator, the outside potential, the coefficient and the flux, as a step reads them."""
        return [u.context.given(value) for value in self._given]

    def at(self, u: Fields, potential: CoefficientFunction) -> CoefficientFunction:
        """The flux at a potential of the body."""
        indicator, outside, coefficient, flux = self.values(u)
        return indicator * (flux + coefficient * (outside - potential))


class Flux(PointTerm):
    """A flux with its integrands on facets; derived classes define the integrands in cells.  The names of the
    flux's unknowns begin with ``name``.
    """

    name: str
    couples = "facet"

    @abstractmethod
    def potential(self, u: Fields) -> CoefficientFunction:
        """The potential mu."""

    @abstractmethod
    def flux(self, u: Fields) -> CoefficientFunction:
        """The flux j = M grad mu."""

    @abstractmethod
    def size(self, u: Fields) -> CoefficientFunction:
        """The mobility M; for a matrix its largest eigenvalue."""

    @abstractmethod
    def chi(self, u: Fields, w: Fields) -> CoefficientFunction:
        """The test chi."""

    def require_order(self, m: int) -> None:
        """Raise ParameterError for m = 0, whose fluxes by a penalty are not consistent."""
        if m == 0:
            expected = f"1 or 2 with a flux of {self.name}, since constants in cells have no gradient"
            raise ParameterError("Discretisation.m", 0, expected)

    def into(self, u: Fields) -> CoefficientFunction:
        """Flux into a cell through its side, f - f_hat."""
        mean = MeanOfFlux(self)
        return u.context.inner * (mean.value(u) - u.parts[mean.name])

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-(self.into(u) * self.chi(u, w))]

    @property
    def terms(self) -> list[Term]:
        """The flux and the equations of its means, in the order of their solution."""
        return [MeanOfPotential(self), MeanOfFlux(self), self]


class MeanOfPotential(FacetMean):
    """Equation of mu_hat, the mean of both sides' potentials."""

    def __init__(self, flux: Flux) -> None:
        self._flux, self.name = flux, f"{flux.name}_potential_hat"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        self._flux.require_order(setting.m)
        return (Unknown(self.name, "facets", setting.m),)

    def value(self, u: Fields) -> CoefficientFunction:
        return self._flux.potential(u)


class MeanOfFlux(FacetMean):
    """Equation of f_hat, the mean of both sides' f; f_hat is zero if the fluxes of the two sides cancel."""

    def __init__(self, flux: Flux) -> None:
        self._flux, self.name = flux, f"{flux.name}_flux_hat"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", setting.m),)

    def value(self, u: Fields) -> CoefficientFunction:
        flux, c = self._flux, u.context
        weight = penalty_weight(u.layout.discretisation.m) * flux.size(u) / c.h
        jump = flux.potential(u) - u.parts[MeanOfPotential(flux).name]
        return inner(flux.flux(u), c.normal) - weight * jump

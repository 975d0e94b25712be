"""Traces on facets, means of both sides, and the speed in upwinding.

A trace is the mean of the values on both sides of a facet, and the inner value on a wall.  Transport and
elastic force use the same trace for either flow direction. With one-sided weights the force of a jump would
be a thrust on the body, of the size of the Bregman distance between both sides
(``ngvisco.forms.terms.transport``).  Upwinding is a separate term, in the transport alone,

    sum_K int_{dK} |v . n| (a - a_hat) t = 1/2 int |v . n| [a] [t]    over the facets between two cells.

The sum of upwinding and the term with the mean is the flux of the upstream side's value.
"""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.physics.tensors import if_positive, inner


def mean_share(inner: CoefficientFunction) -> CoefficientFunction:
    """Share of a side's value in the trace: 1/2 between two cells, 1 on walls."""
    return 1.0 - 0.5 * inner


def speed(u: Fields) -> CoefficientFunction:
    """Speed |v . n| on facets that matter crosses, 0 on all others, m/s."""
    return u.once("speed", lambda: _positive(u.context.crossed * (u.v * u.context.normal)))


def _positive(value: CoefficientFunction) -> CoefficientFunction:
    return if_positive(value, value, -value)


def beyond_trace(u: Fields) -> CoefficientFunction:
    """z - z_hat on a cell's side: half of the jump between two cells, 0 on walls."""
    return u.once("z - z_hat", lambda: u.z - u.z_hat)


def jump_power(u: Fields) -> CoefficientFunction:
    """(z - z_hat) : zeta on a cell's side, Pa."""
    return u.once("(z - z_hat) : zeta", lambda: inner(beyond_trace(u), u.zeta))


_ACROSS = (0.8125, 0.4875, 0.3195)
"""Direction that is parallel to no facet of a regular mesh and distinguishes the sides of facets."""


def side(u: Fields) -> CoefficientFunction:
    """Sign of a facet's side: 1 on the first, -1 on the second, 0 on walls."""
    n = u.context.normal
    along = sum((_ACROSS[i] * n[i] for i in range(1, u.dim)), _ACROSS[0] * n[0])
    one = 1.0 + 0.0 * along
    return u.context.inner * if_positive(along, one, -one)


class Largest:
    """Largest values of facet means among the iterates of a step, by the means' names.

    A term that a mean switches off at a facet stays off. If the term could be switched on again near its
    solution, the equation might have no solution.
    """

    def __init__(self) -> None:
        self._values: dict[str, np.ndarray] = {}
        self.growths = 0
        """Number of calls in which a value changed from zero."""

    def begin(self) -> None:
        """Begin the solution of a step."""
        self._values.clear()

    def __call__(self, name: str, values: np.ndarray) -> np.ndarray:
        """Return the largest values so far, including ``values``."""
        before = self._values.get(name)
        largest = values.copy() if before is None else np.maximum(before, values)
        if before is not None and ((largest > 0) & ~(before > 0)).any():
            self.growths += 1
        self._values[name] = largest
        return largest


class FacetMean(PointTerm):
    """Equation of a facet mean a_hat of both sides' values: sum_K int_{dK} share (a_hat - a) t = 0.

    a_hat is an explicit function of the cells' unknowns and of preceding means; no solver iterates on it.

    Attributes
    ----------
    is_linear : bool
        Whether the function a is linear in the unknowns that it reads. If so, a_hat is exact to rounding
        after a Newton step. Otherwise a_hat is one number per facet, and is recomputed after each increment.
    """

    name: str
    kernel, group = "facet means", ""
    is_linear = True

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", 0),)

    @property
    def facet_mean(self) -> str:  # type: ignore[override]
        """The name of the mean."""
        return self.name

    @abstractmethod
    def value(self, u: Fields) -> CoefficientFunction:
        """The function a on a cell's side."""

    def facet_projection(self, u: Fields) -> CoefficientFunction | None:
        return None if self.is_linear else self.value(u)

    def difference(self, u: Fields) -> CoefficientFunction:
        """The integrand's factor share (a_hat - a)."""
        return mean_share(u.context.inner) * (u.parts[self.name] - self.value(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.difference(u), w.parts[self.name])]


class OfFacet(FacetMean):
    """Equation of the mean of a nonlinear function over a facet, one number, in the function's unit."""

    is_linear = False

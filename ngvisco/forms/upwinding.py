"""Traces on facets: means of both sides, and the speed by which upwinding dissipates.

A trace is the mean of the values on both sides of a facet, and the value itself on a wall.  Transport and
elastic force use the same trace, whichever side is upstream: with one-sided weights the force of a jump would
be a thrust on the body, of the size of the Bregman distance between both sides
(``ngvisco.forms.terms.transport``).  Upwinding is a term of its own, in the transport alone,

    sum_K int_{dK} |v . n| (a - a_hat) t = 1/2 int |v . n| [a] [t]    over the facets between two cells,

by which the whole flux is that of the upstream side.
"""

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.tensors import if_positive, inner


def mean_share(inner: CoefficientFunction) -> CoefficientFunction:
    """The share of a side's value in the trace: 1/2 between two cells, 1 on walls."""
    return 1.0 - 0.5 * inner


def speed(u: Fields) -> CoefficientFunction:
    """|v . n| on facets that matter crosses, 0 on all others, m/s."""
    through = u.context.crossed * (u.v * u.context.normal)
    return if_positive(through, through, -through)


_ACROSS = (0.8125, 0.4875, 0.3195)
"""A direction to which no facet of a regular mesh is parallel; it tells both sides of a facet apart."""


def side(u: Fields) -> CoefficientFunction:
    """1 on the first side of a facet, -1 on the second, 0 on walls."""
    n = u.context.normal
    along = sum((_ACROSS[i] * n[i] for i in range(1, u.dim)), _ACROSS[0] * n[0])
    one = 1.0 + 0.0 * along
    return u.context.inner * if_positive(along, one, -one)


class Largest:
    """The largest values of means over facets among the iterates of a step, by the means' names.

    What a mean switches off at a facet stays off: an equation whose solution lies where it would be switched
    on and off again has none.
    """

    def __init__(self) -> None:
        self._values: dict[str, np.ndarray] = {}
        self.growths = 0
        """How often values have left zero."""

    def begin(self) -> None:
        """The solution of a step begins."""
        self._values.clear()

    def __call__(self, name: str, values: np.ndarray) -> np.ndarray:
        """The largest values so far, of these too."""
        before = self._values.get(name)
        found = values.copy() if before is None else np.maximum(before, values)
        if before is not None and ((found > 0) & ~(before > 0)).any():
            self.growths += 1
        self._values[name] = found
        return found


class SideMean(PointTerm):
    """sum_K int_{dK} share (a_hat - a) t = 0: a_hat, an unknown of facets, is a mean of both sides' values.

    a_hat is an explicit function of the cells' unknowns, and of means that stand before it, which no solver
    iterates on.

    Attributes
    ----------
    is_linear : bool
        Whether a is linear in these: Newton's method then has a_hat to rounding.  Otherwise a_hat is one
        number a facet, and made anew after each increment.
    stays : bool
        Whether a_hat is the largest of all iterates' values in the solution of a step (``Largest``).
    """

    name: str
    kernel = "facet means"
    is_linear = True
    stays = False

    @abstractmethod
    def value(self, u: Fields) -> CoefficientFunction:
        """a, on a cell's side."""

    def difference(self, u: Fields) -> CoefficientFunction:
        """share (a_hat - a)."""
        return mean_share(u.context.inner) * (u.parts[self.name] - self.value(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.difference(u), w.parts[self.name])]

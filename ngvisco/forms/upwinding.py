"""Upwinding across facets: the one place where a cell's outflow is told from its inflow.

With a = v* . n, zero on walls that nothing crosses, and the smooth modulus |a|_eta = sqrt(a^2 + eta^2),

    n^- = (1 - a/|a|_eta)/2     near 1 where v* enters a cell, near 0 where it leaves; 0 on such walls.

The shares of both sides of a facet are 1 - n^- in (0, 1) and sum up to one, so that a trace weighted by
them is a convex combination. On a wall that matter crosses the other side's value is that of what flows in
(``Incoming``), given or the cell's own, and n^- = max(-a, 0)/|a|_eta: where nothing flows the body alone
says its stress. The
velocity v* is known before a step is solved: in the energy identity the two uses of B_h
(``ngvisco.forms.terms.transport``) cancel for any weights, and with weights that do not depend on the
step's own velocity the equations of the step are smooth. With those of the step's own velocity the elastic
force would jump by [z] : [zeta] where v . n changes its sign, and the step could fold.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ngsolve import CoefficientFunction, GridFunction, HDiv, Mesh

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.tensors import if_positive, inner, sqrt


def mean_share(inner: CoefficientFunction) -> CoefficientFunction:
    """1 - n^- for v* = 0.  Both sides' shares sum up to the same whatever v*, so that a trace's mass matrix
    is that of these: 1/2 between two cells, 1 on walls."""
    return 1.0 - 0.5 * inner


@dataclass(frozen=True)
class Incoming:
    """What flows in: ``where`` is 1 on the walls that matter crosses, 0 elsewhere; ``value`` takes the fields
    of a cell's side and the name ``"rho"`` or ``"z"`` to what flows in there.

    On walls where ``continued`` is 1, for each name, that is the cell's own value less the slope of it times
    ``reach``, x less the middle of the cell; None with constants in cells.
    """

    where: CoefficientFunction
    continued: Mapping[str, CoefficientFunction]
    reach: CoefficientFunction | None
    value: Callable[[Fields, str], CoefficientFunction]


class Upwinding:
    """n^- and 1 - n^- of coefficient functions or of arrays, and the values that a trace is a mean of."""

    def __init__(
        self,
        through: CoefficientFunction,
        crossed: CoefficientFunction,
        eta: CoefficientFunction | float,
        incoming: Incoming | None = None,
    ) -> None:
        """``through`` is v* . n (m/s) also on walls, ``crossed`` 0 on facets that nothing crosses, else 1.

        ``eta`` is the width of the smoothed sign, m/s.
        """
        a = crossed * through
        sign = a / sqrt(a * a + eta * eta)
        self.inflow = 0.5 * (crossed - sign)
        if incoming is not None:
            self.inflow = self.inflow + incoming.where * (if_positive(a, 0.0 * sign, -sign) - self.inflow)
        self.incoming = incoming

    def trace(self, u: Fields, name: str) -> CoefficientFunction:
        """What an upwind trace of ``"rho"`` or ``"z"`` is zero for, of a cell's side: share (a_hat - a), and
        n^- (a_hat - a_in) where a wall is crossed."""
        hat, own = u.parts[f"{name}_hat"], u.parts[name]
        difference = self.share * (hat - own)
        if self.incoming is None:
            return difference
        return difference + (self.incoming.where * self.inflow) * (hat - self.incoming.value(u, name))

    @property
    def share(self) -> CoefficientFunction:
        """1 - n^-: what the cell's own value counts in the upwind trace."""
        return 1.0 - self.inflow


class SideMean(PointTerm):
    """sum_K int_{dK} share (a_hat - a) t = 0: a_hat, an unknown of facets, is a mean of both sides' values.

    An explicit function of the cells' unknowns, which no solver iterates on; where it reads other means,
    those of terms before it.
    """

    name: str

    @abstractmethod
    def value(self, u: Fields) -> CoefficientFunction:
        """a, on a cell's side."""

    def difference(self, u: Fields) -> CoefficientFunction:
        """share (a_hat - a)."""
        return mean_share(u.context.inner) * (u.parts[self.name] - self.value(u))

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.difference(u), w.parts[self.name])]


class FacetFlux:
    """The Raviart-Thomas field of lowest order with the mean normal components of a velocity of some order,
    m/s.

    With fields of order 0 a trace has one value a facet.  By sides that differ from point to point it is a
    mean of both cells' values where v . n changes its sign along the facet, and what leaves a cell is taken
    from its neighbour too: a density may become negative.  By the side of the mean it is the value of one
    cell, and the implicit step has an M-matrix.
    """

    def __init__(self, mesh: Mesh, velocity: CoefficientFunction, order: int) -> None:
        self.function = GridFunction(HDiv(mesh, order=0, RT=True))
        self._velocity, self._order = velocity, order

    def __call__(self) -> None:
        """Follow the present velocity."""
        self.function.Set(self._velocity, dual=True, bonus_intorder=self._order)

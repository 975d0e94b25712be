"""An integrand over cells, their boundaries or collocated points: a summand of a form or of an integral."""

from dataclasses import dataclass

from ngsolve import CoefficientFunction


@dataclass(frozen=True)
class Integrand:
    """An integrand over the cells, one over the cells' boundaries, and one over the cells by a collocated
    rule, with one point per coefficient of a field (``Quadrature.collocated``)."""

    cells: CoefficientFunction | None = None
    facets: CoefficientFunction | None = None
    collocated: CoefficientFunction | None = None

"""An integrand over cells, their boundaries or collocated points: a summand of a form or of an integral."""

from dataclasses import dataclass

from ngsolve import CoefficientFunction


@dataclass(frozen=True)
class Integrand:
    """Integrands over the cells, over the cells' boundaries, and over the cells by a collocated rule with one
    point per coefficient of a field (``Quadrature.collocated``)."""

    cells: CoefficientFunction | None = None
    facets: CoefficientFunction | None = None
    collocated: CoefficientFunction | None = None

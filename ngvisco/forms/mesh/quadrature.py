"""Quadrature: the one place where degrees are chosen, for the forms and for the ledger alike.

The energy identity holds for any quadrature as long as a form and the ledger's integral of the same
thing use the same one.  ``Quadrature`` hands out both.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from ngsolve import ET, CoefficientFunction, Integrate, IntegrationRule, Mesh, dx

from ngvisco.forms.mesh.compilation import compiled

if TYPE_CHECKING:
    from ngvisco.forms.term import Integrand

SYMMETRIC_DEGREE = 6
"""Up to it NGSolve's rules of triangles have all symmetries of the triangle.  The two sides of a face number
its vertices each in their own way: by another rule they would not see the same points, and what the one gives
would not be what the other takes."""
_FACET_BASE_ORDER = 5  # order of NGSolve's Integrate on element boundaries without a bonus


@dataclass(frozen=True)
class Quadrature:
    """Rules of one degree on the cells and one on the facets.

    Parameters
    ----------
    volume_degree, facet_degree : int
        Polynomial degrees integrated exactly on straight cells and facets.
    """

    mesh: Mesh
    volume_degree: int
    facet_degree: int

    @classmethod
    def for_orders(cls, mesh: Mesh, k: int, m: int, bonus: int = 0) -> Quadrature:
        """Degrees for velocity order k and field order m.

        The terms with the highest degree among the polynomial ones are m~ . (L^T w) and
        rate(grad w; z) : zeta, of degree m + 2k + (k - 1) and (k - 1) + 2m.  Energies are not
        polynomial; 2k + m + 1 resolves them at least as well as the fields do.  Rounded up to an even
        degree: values are kept at the points, and NGSolve has spaces of these for even degrees only.
        """
        degree = max(2 * k + m + 1, 2 * m + k) + bonus
        degree += degree % 2
        # a transport's facets want 2m + 1 for its order; see SYMMETRIC_DEGREE
        return cls(mesh, degree, degree if mesh.dim == 2 else min(degree, SYMMETRIC_DEGREE))

    @cached_property
    def cell_rules(self) -> dict[Any, IntegrationRule]:
        """The rule of every type of cell."""
        cells = (ET.TRIG, ET.QUAD) if self.mesh.dim == 2 else (ET.TET, ET.PRISM, ET.PYRAMID, ET.HEX)
        return {et: IntegrationRule(et, self.volume_degree) for et in cells}

    @cached_property
    def _facet_rules(self) -> dict[Any, IntegrationRule]:
        facets = (ET.SEGM,) if self.mesh.dim == 2 else (ET.TRIG, ET.QUAD)
        return {et: IntegrationRule(et, self.facet_degree) for et in facets}

    @property
    def cells(self) -> Any:
        """dx over the cells with the common rule."""
        return dx(intrules=self.cell_rules)

    @property
    def facets(self) -> Any:
        """dx over the boundary of every cell (both sides of each inner facet)."""
        return dx(element_boundary=True, intrules=self._facet_rules)

    def add(self, form: Any, integrands: Iterable[Integrand]) -> None:
        """Add the integrands to an NGSolve form, by the rules of ``cells`` and ``facets``."""
        for integrand in integrands:
            if integrand.cells is not None:
                form += compiled(integrand.cells) * self.cells
            if integrand.facets is not None:
                form += compiled(integrand.facets) * self.facets

    def integrate_cells(self, integrand: CoefficientFunction) -> Any:
        """Integral over the mesh, by the rule of ``cells``; a float, or a vector of them."""
        return Integrate(integrand, self.mesh, order=self.volume_degree)

    def integrate_facets(self, integrand: CoefficientFunction) -> float:
        """Integral over all cell boundaries, by the rule of ``facets``."""
        measure = dx(element_boundary=True, bonus_intorder=self.facet_degree - _FACET_BASE_ORDER)
        total = integrand * measure
        # NGSolve sums up integrals of coefficient functions over the ranks, but not these
        return float(self.mesh.comm.Sum(Integrate(total, self.mesh)))

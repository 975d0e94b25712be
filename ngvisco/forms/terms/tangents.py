"""Subtracts the thrust of jumps from the elastic force.

For a constant w the bilinear form B_h(w; z, zeta) leaves on a facet between two cells

    (w . n) N,    N = [phi] - [z] : {zeta},    [a] = a_2 - a_1, {a} = (a_1 + a_2)/2, n from cell 1 to 2,

since the cells give the integrals of phi over their boundaries.  N is zero for a quadratic energy.  For any
other energy the mean of N over the facet is subtracted.  The force is then that of the trace

    z_hat + b/2 (z_1 - z_2),    b = 2 N/([z] : [zeta]),

the point at which the tangents of phi on both sides meet.  Let D_21 and D_12 be the Bregman distances between
both sides, >= 0 for a convex energy. With zeta = phi'(z), b = (D_21 - D_12)/(D_21 + D_12) lies in [-1, 1].
|b| may be larger than 1 if zeta is a projection of phi'(z), and for parameters, in which no energy is convex:
there [z] : [zeta] may be zero where N is not.  N itself has no denominator.

The energy may have no value at a trace, as ln det B at det B <= 0, although it has a value at all points of
the cells' rule.  A facet without energy keeps its thrust, which appears in the ledger's momentum defect.  The
force jumps when a trace loses its energy. Therefore a facet that has no energy in one iterate keeps its
thrust for the rest of the step.
"""

from __future__ import annotations

from collections.abc import Sequence

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import ENTERING, PointTerm
from ngvisco.forms.upwinding import OfFacet, jump_power, side
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import is_affine, rest_state
from ngvisco.physics.response import Respond
from ngvisco.physics.tensors import if_positive, is_number

_ROUNDING = 1e-14
"""Share of a facet below which a share counts as zero."""


class TangentGap(OfFacet):
    """Equation of the facet mean of side times (phi + (z_hat - z) : zeta), which is -N/2."""

    name = "tangent_gap"

    def value(self, u: Fields) -> CoefficientFunction:
        phi = u.context.rates.stored_on_sides(u)
        return side(u) * (is_number(phi, phi, 0.0) - jump_power(u))


class WithoutEnergy(OfFacet):
    """Equation of the share of a facet on which a side's trace has no energy.

    A facet whose share is positive in any iterate keeps it for the rest of the step.
    """

    name = "without_energy"
    stays = True

    def value(self, u: Fields) -> CoefficientFunction:
        return is_number(u.context.rates.stored_on_sides(u), 0.0, 1.0)


class TangentForce(PointTerm):
    """Force - int (w . n) N over the facets in the momentum equation; here N is a mean over the facet.

    At w = v the term is a power of jumps. The dissipation of ``Upwinding`` includes this power.
    """

    linearised, group = False, ENTERING

    def excess(self, u: Fields) -> CoefficientFunction:
        """The integrand -side N/2 on the boundaries of cells, Pa."""
        return side(u) * if_positive(_ROUNDING - u.parts[WithoutEnergy.name], u.parts[TangentGap.name], 0.0)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [(w.v * u.context.normal) * self.excess(u)]


def tangents_of(material: Material, dim: int, m: int, response: Respond) -> TangentForce | None:
    """The correction of the force for fields of order ``m``; None for a quadratic energy.

    ``response`` is the material's response on meshes of dimension ``dim``.

    The result is also None for bodies with different U and m >= 1, because the bodies' amounts can be
    negative on sides of cells, where the energy then has no value.
    """
    if m > 0 and material.response(dim) is not None and not material.continued:
        return None
    return None if is_affine(response, rest_state(material, dim)) else TangentForce()

"""The trace at which the tangents of both sides meet: the elastic force of a jump leaves no thrust.

For a constant w the elastic force B_h(w; z, zeta) leaves on a facet between two cells

    (w . n) ([phi] - [z] : {zeta}),        [a] = a_2 - a_1, {a} = (a_1 + a_2)/2, n from cell 1 to cell 2,

since the cells give the integrals of phi over their boundaries.  The thrust is zero for a quadratic energy.
For any other energy the trace of the force is z_hat + b/2 (z_1 - z_2) with

    b = int [phi] - [z] : {zeta} / (1/2 int [z] : [zeta]),        integrals over the facet,

by which nothing is left: the point of the segment from z_1 to z_2 at which the tangents of phi meet.  With
zeta = phi'(z) and the Bregman distances D_21 and D_12 between both sides, both >= 0 for a convex energy,
b = (D_21 - D_12)/(D_21 + D_12) lies in [-1, 1].  Projected conjugates may ask for more; b is bounded by one,
and what is left then is seen in the ledger's momentum defect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm, Setting, Unknown
from ngvisco.forms.upwinding import SideMean, side
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import is_quadratic, modulus_scale
from ngvisco.physics.tensors import if_positive, inner

_ROUNDING = 1e-14
"""Jumps whose energy is less than this share of the moduli are rounding."""


class OfFacet(SideMean):
    """One number a facet, Pa."""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", 0),)


class TangentGap(OfFacet):
    """The mean over a facet of side (phi + (z_hat - z) : zeta), half of [phi] - [z] : {zeta} with a sign."""

    name = "tangent_gap"

    def value(self, u: Fields) -> CoefficientFunction:
        return side(u) * (u.context.rates.stored(u) - _jump(u))


class ConjugateJump(OfFacet):
    """The mean over a facet of (z - z_hat) : zeta, a quarter of [z] : [zeta]."""

    name = "conjugate_jump"

    def value(self, u: Fields) -> CoefficientFunction:
        return u.context.inner * _jump(u)


def _jump(u: Fields) -> CoefficientFunction:
    """(z - z_hat) : zeta."""
    return inner(u.z - u.z_hat, u.zeta)


def excess(u: Fields, scale: float) -> CoefficientFunction:
    """b of the module's docstring, times the side's sign; ``scale`` is a size of the moduli, Pa."""
    gap, jump = u.parts[TangentGap.name], u.parts[ConjugateJump.name]
    size = if_positive(gap, gap, -gap)
    largest = if_positive(jump - size, jump, size)
    return side(u) * gap / (largest + _ROUNDING * scale)


@dataclass(frozen=True)
class TangentForce(PointTerm):
    """- sum_K int_{dK} (w . n) b side (z_hat - z) : zeta in the momentum equation.

    At w = v it is a power of jumps, which ``Upwinding`` has in its dissipation.

    Attributes
    ----------
    scale : float
        A size of the moduli, Pa.
    """

    scale: float
    linearised = False

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        return [((w.v * c.normal) * excess(u, self.scale)) * _jump(u)]


def tangents_of(material: Material, dim: int) -> TangentForce | None:
    """The force's correction, None for a quadratic energy and for one without an expression."""
    if material.response(dim) is not None or is_quadratic(material, dim):
        return None
    return TangentForce(modulus_scale(material, dim))

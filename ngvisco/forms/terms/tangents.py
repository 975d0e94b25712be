"""The trace at which the tangents of both sides meet, so that a jump's elastic force has no thrust.

For a constant w the elastic force B_h(w; z, zeta) leaves on a facet between two cells

    (w . n) N,    N = [phi] - [z] : {zeta},    [a] = a_2 - a_1, {a} = (a_1 + a_2)/2, n from cell 1 to 2,

since the cells give the integrals of phi over their boundaries.  The thrust is zero for a quadratic energy.
For any other energy the trace of the force is z_hat + b/2 (z_1 - z_2) with

    b = int N / (1/2 int [z] : [zeta]),        integrals over the facet,

which removes the thrust: the tangents of phi meet at this point of the line through z_1 and z_2.  With
zeta = phi'(z) and the Bregman distances D_21 and D_12 between both sides, both >= 0 for a convex energy,
b = (D_21 - D_12)/(D_21 + D_12) lies in [-1, 1].  Projected conjugates may give a larger b; b is bounded, and
the ledger's momentum defect shows the remaining thrust.

The energy may have no value at a trace, as ln det B at det B <= 0, although it has one at all points of the
cells' rule.  On such a facet b = 0, and its thrust is in the ledger's momentum defect.  Since b jumps there,
it stays 0 for the rest of the step once a trace of an iterate has no energy.

An energy is not convex in its parameters, and [z] : [zeta] may be zero where a modulus and a strain jump.
Strains and parameters then have a weight each, b_i = int N D_i / (D_1^2 + D_2^2), D_i half of their share of
int [z] : [zeta].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import ENTERING, PointTerm
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.forms.upwinding import FacetMean, side
from ngvisco.physics.material import Material
from ngvisco.physics.pointwise import is_affine, rest_state
from ngvisco.physics.response import Respond
from ngvisco.physics.tensors import if_positive, inner, is_number, masked

_ROUNDING = 1e-14
"""Share of the moduli below which the energy of a jump is rounding."""

_FARTHEST = 3.0
"""Largest b; a larger quotient is replaced by a b that falls continuously to zero with [z] : [zeta]."""


class OfFacet(FacetMean):
    """Equation of the mean of a function over a facet, Pa."""

    is_linear = False

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "facets", 0),)


class TangentGap(OfFacet):
    """Equation of the facet mean of phi + (z_hat - z) : zeta, with the side's sign, which is half of N."""

    name = "tangent_gap"

    def value(self, u: Fields) -> CoefficientFunction:
        phi = u.context.rates.stored_on_sides(u)
        return side(u) * (is_number(phi, phi, 0.0) - inner(u.z - u.z_hat, u.zeta))


class WithoutEnergy(OfFacet):
    """Equation of the share of a facet on which a side's trace has no energy.

    A facet on which any iterate has such a share keeps it for the rest of the step.
    """

    name = "without_energy"
    stays = True

    def value(self, u: Fields) -> CoefficientFunction:
        return is_number(u.context.rates.stored_on_sides(u), 0.0, 1.0)


class ConjugateJump(OfFacet):
    """Equation of the facet mean of (z - z_hat) : zeta, a quarter of [z] : [zeta], for components of z."""

    def __init__(self, name: str, components: np.ndarray | None = None) -> None:
        """``components`` is a mask of components; None takes all."""
        self.name, self._components = name, components

    def jump(self, u: Fields) -> CoefficientFunction:
        """The integrand (z - z_hat) : zeta."""
        jump = u.z - u.z_hat
        return inner(jump if self._components is None else masked(jump, self._components), u.zeta)

    def value(self, u: Fields) -> CoefficientFunction:
        return u.context.inner * self.jump(u)


@dataclass(frozen=True)
class TangentForce(PointTerm):
    """Correction - sum_K int_{dK} (w . n) b side (z_hat - z) : zeta in the momentum equation.

    At w = v it is a power of jumps, which the dissipation of ``Upwinding`` includes.

    Attributes
    ----------
    jumps : tuple of ConjugateJump
        One for each group of variables with a weight.
    scale : float
        Typical size of the moduli, Pa.
    """

    jumps: tuple[ConjugateJump, ...]
    scale: float
    linearised, group = False, ENTERING

    @property
    def kept(self) -> tuple[str, ...]:  # type: ignore[override]
        """Unknowns that determine the weights, which vary steeply where a jump is small."""
        return (TangentGap.name, WithoutEnergy.name, *(of.name for of in self.jumps))

    def excess(self, u: Fields) -> CoefficientFunction:
        """The integrand side b (z - z_hat) : zeta."""
        gap, means = u.parts[TangentGap.name], [u.parts[of.name] for of in self.jumps]
        squares = reduce(add, (mean * mean for mean in means)) + (_ROUNDING * self.scale) ** 2
        least = gap * gap / _FARTHEST**2
        factor = gap / if_positive(squares - least, squares, least)
        factor = if_positive(_ROUNDING - u.parts[WithoutEnergy.name], factor, 0.0)
        jumps = (mean * of.jump(u) for mean, of in zip(means, self.jumps, strict=True))
        return side(u) * factor * reduce(add, jumps)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [(w.v * u.context.normal) * self.excess(u)]


def tangents_of(material: Material, dim: int, m: int, response: Respond) -> TangentForce | None:
    """The force's correction for fields of order ``m``, or None for a quadratic energy.

    ``response`` is that of the material on meshes of dimension ``dim``.

    It is also None for bodies of different U with m >= 1: their amounts can be negative on sides of cells,
    where the energy has no value.
    """
    if m > 0 and material.response(dim) is not None and not material.continued:
        return None
    rest = rest_state(material, dim)
    if is_affine(response, rest):
        return None
    strains = material.states(dim).strains
    jumps = [ConjugateJump("conjugate_jump", None if strains.all() else strains)]
    if not strains.all():
        jumps.append(ConjugateJump("parameter_jump", ~strains))
    return TangentForce(tuple(jumps), float(abs(response(rest[None]).hessian).max()))

"""What is spread thin of a body relaxes at the rate of the flow.

A trace of a body, smeared into another one, is sheared without end, and an implicit step turns its sign where
2 tau e > 1.  With theta the body's fraction its tensors X = n B relax,

    dt X + div(X v) = production(L; X) - c |L| w (X - n I),   w = (1 - theta)^4/((1 - theta)^4 + (4 theta)^4),

with c = 3: faster than any L stretches, so that |X/n| stays bounded whatever the shear, and steps tau -> 0
have a limit.  w is one half at theta = 1/5 and 4e-3 at 1/2.  The power is a column
of the ledger, >= 0: f(B) is least at B = I where it is not linear, and with zeta = G I the power is
G c |L| w (tr X - 3 n), of which the trace is left out where it is negative, as it may be beside a jump: a
trace that is too small stays so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.bodies import AMOUNT, Content
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import identity_like, if_positive, inner, sqrt, square, tr

RATE = 3.0
"""c: the largest stretching of X is 2 |L|."""

_STILL = 1e-6
"""|L| times the step below which it is smoothed at zero."""

_SQUARINGS = 2
"""How often 1 - theta and 4 theta are squared."""

_HALF = 1 / 5
"""The fraction at which half the rate is left."""


@dataclass(frozen=True)
class Dilution(PointTerm):
    """int c |L| w(theta) (X - n I) : G of one body's tensor, G its test."""

    material: Mixture
    body: str
    variable: Content
    is_linear: bool
    """Whether zeta is a multiple of I."""

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [inner(self.rate(u), w.z_tensors[self.variable.name])]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        name = self.variable.name
        return {f"dissipation_dilution_{name}": inner(self.rate(u), u.zeta_tensors[name])}

    def rate(self, u: Fields) -> CoefficientFunction:
        """c |L| w (X - n I), 1/s."""
        X, n = u.z_tensors[self.variable.name], u.z_tensors[AMOUNT + self.body]
        still = u.context.rate(_STILL + 0.0 * n)
        speed = square(u.L)
        speed = speed / sqrt(speed + still * still)
        beside = X - n * identity_like(X)
        if self.is_linear:
            excess = tr(beside)
            beside = beside + if_positive(excess, 0.0 * excess, (-1 / 3) * excess) * identity_like(X)
        return (RATE * speed * self.weight(u)) * beside

    def weight(self, u: Fields) -> CoefficientFunction:
        """w(theta) at a point."""
        return weight_of(self.material.fractions.at(u.z_tensors)[self.body])


def weight_of(theta: Any) -> Any:
    """w, in [0, 1] for every theta."""
    others, own = 1 - theta, (1 / _HALF - 1) * theta
    for _ in range(_SQUARINGS):
        others, own = others * others, own * own
    return others / (others + own)


def dilution_terms(material: object) -> list[Dilution]:
    """Those of a model's material: of every body's tensors, where it is not alone."""
    if not isinstance(material, Mixture) or len(material.bodies) == 1:
        return []
    return [
        Dilution(material, body.name, X, psi.is_linear)
        for body, psi in zip(material.bodies, material.energies, strict=True)
        for X in material.contents(body.name)
    ]

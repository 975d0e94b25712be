"""Tensors in bodies whose energy does not read them fade to their value at rest.

A fluid shears without end.  A tensor that it carries for a solid beside it would grow for ever there, mean
nothing, and end the run.  With r = sum theta_i over the bodies whose energy reads the tensor B,

    dt B + (v . grad) B = rate(B; L, Pi) - w(r)/tau (B - I),   w(r) = (1 - r)^4/((1 - r)^4 + (4 r)^4),

where tau is the step's length: within a step where r = 0, at half of that rate where a fifth of the matter is
of bodies with an energy of B, and hardly at all where half is (4e-3/tau).  What has smeared of a body into
the fluid has no distortion of its own; where it fades too slowly it is sheared by the fluid until it stands
against the step (``demos/soft_disc``), and where w falls more steeply, with powers of 8, increments do.  The
power w/tau (B - I) : zeta_B is a column of the ledger; with zeta_B = r G I it is a dissipation wherever
tr B >= 3, as for det B = 1.  Only tensors of the actual frame fade: I means the same for every observer of B,
not of F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import identity_like, inner
from ngvisco.physics.variables import SmallStrain, Variable

_SQUARINGS = 2
"""How often 1 - r and 4 r are squared."""

_HALF = 1 / 5
"""The share r at which half the rate is left."""


@dataclass(frozen=True)
class Fading(PointTerm):
    """int w(r)/tau (B - I) : G, G the test of the tensor."""

    material: Mixture
    variable: Variable

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        test = w.z_tensors[self.variable.name]
        return [inner(u.context.rate(self.weight(u)) * self._faded(u), test)]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        name = self.variable.name
        power = u.context.rate(self.weight(u)) * inner(self._faded(u), u.zeta_tensors[name])
        return {f"dissipation_fading_{name}": power}

    def _faded(self, u: Fields) -> CoefficientFunction:
        """The tensor less its value at rest."""
        value = u.z_tensors[self.variable.name]
        return value if isinstance(self.variable, SmallStrain) else value - identity_like(value)

    def weight(self, u: Fields) -> CoefficientFunction:
        """w(r) at a point."""
        theta = self.material.fractions.at(u.z_tensors)
        readers = self.material.readers(self.variable.name)
        others = [value for name, value in theta.items() if name not in readers]
        return weight_of(sum(others[1:], others[0]))


def weight_of(unread: Any) -> Any:
    """w(r), in [0, 1] for every r, where 1 - r is ``unread``, the share of the others."""
    read = (1 / _HALF - 1) * (1 - unread)
    for _ in range(_SQUARINGS):
        unread, read = unread * unread, read * read
    return unread / (unread + read)


def fading_terms(material: object) -> list[Fading]:
    """Those of a model's material: of the tensors that some body does not read."""
    if not isinstance(material, Mixture):
        return []
    return [
        Fading(material, variable)
        for variable in material.variables
        if variable.frame == "actual" and len(material.readers(variable.name)) < len(material.bodies)
    ]

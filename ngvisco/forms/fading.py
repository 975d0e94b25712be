"""Tensors in bodies whose energy does not read them fade to their value at rest.

A fluid shears without end.  A tensor that it carries for a solid beside it would grow for ever there, mean
nothing, and end the run.  With r = sum theta_i over the bodies whose energy reads the tensor B,

    dt B + (v . grad) B = rate(B; L, Pi) - (1 - r)^8/tau (B - I),

where tau is the step's length: within a step where r = 0, and hardly at all where a body with an energy of B
makes up half of the matter (4e-3/tau).  The power (1 - r)^8/tau (B - I) : zeta_B is a column of the ledger;
with zeta_B = r G I it is a dissipation wherever tr B >= 3, as for det B = 1.  Only tensors of the actual
frame fade: I means the same for every observer of B, not of F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import identity_like, inner
from ngvisco.physics.variables import SmallStrain, Variable

_SHARPNESS = 8
"""The power of 1 - r: 8 leaves 99.6 % of the time between r = 1/2 and r = 1 without fading in 250 steps."""


@dataclass(frozen=True)
class Fading(PointTerm):
    """int (1 - r)^8/tau (B - I) : G, G the test of the tensor."""

    material: Mixture
    variable: Variable

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        test = w.z_tensors[self.variable.name]
        return [inner(u.context.rate(self.weight(u)) * self._faded(u), test)]

    def entries(self, u: Fields) -> list[Entry]:
        name = self.variable.name
        power = u.context.rate(self.weight(u)) * inner(self._faded(u), u.zeta_tensors[name])
        return [Entry(f"dissipation_fading_{name}", "dissipation", Integrand(power))]

    def _faded(self, u: Fields) -> CoefficientFunction:
        """The tensor less its value at rest."""
        value = u.z_tensors[self.variable.name]
        return value if isinstance(self.variable, SmallStrain) else value - identity_like(value)

    def weight(self, u: Fields) -> CoefficientFunction:
        """(1 - r)^8 at a point."""
        theta = self.material.fractions.at(u.z_tensors)
        readers = self.material.readers(self.variable.name)
        others = [value for name, value in theta.items() if name not in readers]
        share = sum(others[1:], others[0])
        for _ in range(_SHARPNESS.bit_length() - 1):
            share = share * share
        return share


def fading_terms(material: object) -> list[Fading]:
    """Those of a model's material: of the tensors that some body does not read."""
    if not isinstance(material, Mixture):
        return []
    return [
        Fading(material, variable)
        for variable in material.variables
        if variable.frame == "actual" and len(material.readers(variable.name)) < len(material.bodies)
    ]

"""Films of fluid and a body in series in one cell: they have one shear traction and two shear rates.

A cell that an interface of normal n cuts has one velocity. Let S be the fluid's part of the cell. Let D be
the shear across the interface at the cell's rate, e_f the shear of the fluid and e that of the body:

    D = S e_f + (1 - S) e.

Both have the fluid's viscosity, so that the body's viscous stress is 2 G_v e. The body also bears the elastic
traction M: 2 G_v e_f = 2 G_v e + M. So

    e = D - Pi,   Pi = S M/(2 G_v),

which has the form of a creep rate. Its power is M : Pi >= 0. With the weight 1 - S, this power is the
dissipation of the two rates minus the dissipation of the one rate D. In a step of length tau, Pi is divided
by 1 + S k tau/(2 G_v), where 2 k is the stress per creep strain. A thin film then relieves M within the step,
by the midpoint rule to zero and not beyond it. Without this rate the body's part of the cell is sheared like
the film, and drags the wall along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

from ngvisco.physics.bodies import Body, Fractions, Interface
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.parameters import typical_value, value_at
from ngvisco.physics.rheology import StokesViscosity
from ngvisco.physics.tensors import Tensor, dev, shear_across
from ngvisco.physics.variables import INTERFACE, STEP, Values


@dataclass(frozen=True, kw_only=True)
class Films(FlowRule):
    """Pi = sum_f S_f/(2 G_v) times the shear of M across the interface. The sum is over fluids f, with S_f =
    chi_f theta_f."""

    fluids: tuple[tuple[str, StokesViscosity], ...]
    """Pairs of a fluid's name and its viscosity; the shear viscosity G_v is positive."""
    fractions: Fractions
    stiffness: float = 0.0
    """Half of the body's stress per creep strain at rest, Pa, at typical values of its parameters."""

    reads = frozenset({INTERFACE})
    degree = 1.0

    @classmethod
    def of(cls, fluids: Sequence[Body], fractions: Fractions, stiffness: float) -> Films | None:
        """The rule for films of those ``fluids`` that have a viscosity of Stokes; None for no such fluid."""
        viscous = [
            (body.name, body.viscosity)
            for body in fluids
            if isinstance(body.viscosity, StokesViscosity) and typical_value(body.viscosity.G_v) > 0
        ]
        return cls(fluids=tuple(viscous), fractions=fractions, stiffness=stiffness) if viscous else None

    @property
    def interface(self) -> Interface:
        """The interface between fluids and other bodies."""
        names = {name for name, _ in self.fluids}
        values = ((body, float(body in names)) for body in self.fractions.bodies)
        return Interface(tuple(values), self.fractions)

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        theta, chi = self.fractions.not_negative(z), self.fractions.behind_planes(z)
        parts = ((0.5 / value_at(law.G_v, z)) * (chi[name] * theta[name]) for name, law in self.fluids)
        fluidity = reduce(add, parts)
        relieved = z[STEP] + self.stiffness * fluidity
        return (z[STEP] * fluidity * (1 / relieved)) * dev(shear_across(M, z[INTERFACE]))

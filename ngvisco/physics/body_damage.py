"""The damage of one body among several: its law, the carried variables, and the energy of its cracks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ngvisco.physics.bodies import Body
from ngvisco.physics.materials.damaged import DAMAGE, Damaged, DamageSlope, DamageVariable
from ngvisco.physics.variables import Values


@dataclass(frozen=True)
class BodyDamage:
    """A body's damage: the law by which the body breaks, and the variables of the damage and of its
    gradient."""

    law: Damaged
    damage: DamageVariable
    slope: DamageSlope

    @classmethod
    def of(cls, body: Body) -> BodyDamage:
        """The damage of a body whose material is ``Damaged``."""
        law = body.material
        assert isinstance(law, Damaged)
        damage = replace(DAMAGE, name=f"{DAMAGE.name}_{body.name}")
        return cls(law, damage, replace(law.slope, name=f"{law.slope.name}_{body.name}"))

    def surface_energy(self, z: Values, weight: Any) -> Any:
        """The energy of the body's cracks, Pa, per actual volume.  ``weight`` is the reference volume per
        actual volume."""
        own = {"A": weight, DAMAGE.name: z[self.damage.name], self.law.slope.name: z[self.slope.name]}
        return self.law.surface_energy(own)

"""Materials that harden: the plastic strain is one more variable, with an energy of its own."""

from dataclasses import dataclass, replace

from ngsolve import CoefficientFunction

from ngvisco.physics.flow_rules.hardening import PLASTIC_STRAIN, Hardening
from ngvisco.physics.material import Material, Wrapper
from ngvisco.physics.materials.regularised import WithQuadratic
from ngvisco.physics.materials.yosida import Yosida
from ngvisco.physics.variables import Values, Variable


@dataclass(frozen=True, kw_only=True)
class Hardened(Wrapper):
    """phi(z) + phi_h(k) of a material and the plastic strain k that it carries.

    A ``Model`` makes it where its flow rule hardens.

    Parameters
    ----------
    material : Material
        The material without hardening, with all parameters that the hardening reads.
    hardening : Hardening
        phi_h.
    """

    hardening: Hardening

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (*self.material.variables, PLASTIC_STRAIN)

    @property
    def lagged(self) -> frozenset[str]:
        return self.material.lagged

    def energy(self, z: Values) -> CoefficientFunction:
        own = {v.name: z[v.name] for v in self.material.variables}
        return self.material.energy(own) + self.hardening.energy(z)


def hardened(material: Material, hardening: Hardening | None) -> Material:
    """The material with this hardening in place of any other; what regularises one has it within."""
    if isinstance(material, (WithQuadratic, Yosida)):
        return replace(material, material=hardened(material.material, hardening))
    if isinstance(material, Hardened):
        return hardened(material.material, hardening)
    return material if hardening is None else Hardened(material=material, hardening=hardening)

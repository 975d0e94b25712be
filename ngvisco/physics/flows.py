"""What creeps in a model: flow rules and the variables that each of them acts on."""

from dataclasses import dataclass
from typing import Any

from ngvisco.physics.bodies import PlasticContent
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.flow_rules.hardening import PLASTIC_STRAIN
from ngvisco.physics.mixture import Fractions
from ngvisco.physics.variables import Values


@dataclass(frozen=True)
class Flow:
    """A flow rule, with a creep rate Pi of its own.

    Attributes
    ----------
    rule : FlowRule
    names : tuple of str
        Variables whose rates have its Pi.
    body : str or None
        The body that it is the creep of, by its own tensors; None of the material.
    fractions : Fractions or None
        Those of the bodies.
    """

    rule: FlowRule
    names: tuple[str, ...]
    body: str | None = None
    fractions: Fractions | None = None

    def share(self, z: Values) -> Any:
        """The body's fraction of the point, > 0: its power per volume is that times its own."""
        return 1.0 if self.fractions is None or self.body is None else self.fractions.positive(z, self.body)

    @property
    def plastic_strain(self) -> str:
        """The variable that is made by its hardening: k, or K_i of a body."""
        return PLASTIC_STRAIN.name if self.body is None else PlasticContent.of(self.body).name

    def amount(self, z: Values) -> Any:
        """n_i of the body, > 0: what makes its dk/dt that of K_i."""
        return 1.0 if self.fractions is None else self.share(z) * self.fractions.total(z)

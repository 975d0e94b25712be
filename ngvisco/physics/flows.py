"""What creeps in a model: flow rules and the variables that each of them acts on."""

from dataclasses import dataclass
from typing import Any

from ngvisco.physics.flow_rules import FlowRule
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

"""Flow rules, the laws of a material's creep rate."""

from ngvisco.physics.flow_rules.conformation import PTT, Giesekus
from ngvisco.physics.flow_rules.laws import Composite, Creep, DruckerPrager, Eyring, Norton, Perzyna
from ngvisco.physics.flow_rules.rule import FlowRule

__all__ = [
    "PTT",
    "Composite",
    "Creep",
    "DruckerPrager",
    "Eyring",
    "FlowRule",
    "Giesekus",
    "Norton",
    "Perzyna",
]

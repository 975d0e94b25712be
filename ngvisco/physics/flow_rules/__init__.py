"""Flow rules: how fast a material creeps."""

from ngvisco.physics.flow_rules.laws import Composite, Creep, CreepLaw, DruckerPrager, Eyring, Norton, Perzyna
from ngvisco.physics.flow_rules.rule import FlowRule

__all__ = [
    "Composite",
    "Creep",
    "CreepLaw",
    "DruckerPrager",
    "Eyring",
    "FlowRule",
    "Norton",
    "Perzyna",
]

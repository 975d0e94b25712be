"""Flow rules: how fast a material creeps, one family a file."""

from ngvisco.physics.flow_rules.composite import Composite
from ngvisco.physics.flow_rules.eyring import Eyring
from ngvisco.physics.flow_rules.linear import Creep, CreepLaw
from ngvisco.physics.flow_rules.plastic import DruckerPrager, Perzyna
from ngvisco.physics.flow_rules.power import Norton
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

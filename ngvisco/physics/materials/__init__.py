"""Constitutive laws, one family a file; each is a list of variables and an energy."""

from ngvisco.physics.materials.barotropic import BarotropicFluid
from ngvisco.physics.materials.conformation import FENEP, OldroydB
from ngvisco.physics.materials.custom import CustomMaterial
from ngvisco.physics.materials.damaged import Damaged
from ngvisco.physics.materials.linearised import HardeningElastic, IsotropicStrainEnergy, LinearElastic
from ngvisco.physics.materials.mooney_rivlin import (
    LogarithmicMooneyRivlin,
    MooneyRivlin,
    ReferentialMooneyRivlin,
)
from ngvisco.physics.materials.neo_hookean import NeoHookean
from ngvisco.physics.materials.perspective import PerMass, PerReferentialVolume
from ngvisco.physics.materials.referential import (
    IsochoricNeoHookean,
    LogarithmicNeoHookean,
    ReferentialNeoHookean,
)
from ngvisco.physics.materials.regularised import WithQuadratic
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.materials.yosida import Yosida

__all__ = [
    "FENEP",
    "BarotropicFluid",
    "CustomMaterial",
    "Damaged",
    "HardeningElastic",
    "IsochoricNeoHookean",
    "IsotropicStrainEnergy",
    "LinearElastic",
    "LogarithmicMooneyRivlin",
    "LogarithmicNeoHookean",
    "MooneyRivlin",
    "NeoHookean",
    "OldroydB",
    "PerMass",
    "PerReferentialVolume",
    "ReferentialMooneyRivlin",
    "ReferentialNeoHookean",
    "Thermal",
    "WithQuadratic",
    "Yosida",
]

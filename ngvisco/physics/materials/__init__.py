"""Constitutive laws; each is a list of variables and an energy."""

from ngvisco.physics.materials.custom import CustomMaterial
from ngvisco.physics.materials.damaged import Damaged
from ngvisco.physics.materials.fluids import FENEP, BarotropicFluid, OldroydB
from ngvisco.physics.materials.gent import Gent
from ngvisco.physics.materials.hyperelastic import (
    IsochoricNeoHookean,
    LogarithmicMooneyRivlin,
    LogarithmicNeoHookean,
    MooneyRivlin,
    NeoHookean,
    ReferentialMooneyRivlin,
    ReferentialNeoHookean,
)
from ngvisco.physics.materials.linearised import HardeningElastic, IsotropicStrainEnergy, LinearElastic
from ngvisco.physics.materials.network import Branch, Network
from ngvisco.physics.materials.ogden import Ogden
from ngvisco.physics.materials.perspective import PerMass, PerReferentialVolume
from ngvisco.physics.materials.prony import prony_network, read_prony
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.materials.wrapped import WithQuadratic, Yosida

__all__ = [
    "FENEP",
    "BarotropicFluid",
    "Branch",
    "CustomMaterial",
    "Damaged",
    "Gent",
    "HardeningElastic",
    "IsochoricNeoHookean",
    "IsotropicStrainEnergy",
    "LinearElastic",
    "LogarithmicMooneyRivlin",
    "LogarithmicNeoHookean",
    "MooneyRivlin",
    "NeoHookean",
    "Network",
    "Ogden",
    "OldroydB",
    "PerMass",
    "PerReferentialVolume",
    "ReferentialMooneyRivlin",
    "ReferentialNeoHookean",
    "Thermal",
    "WithQuadratic",
    "Yosida",
    "prony_network",
    "read_prony",
]

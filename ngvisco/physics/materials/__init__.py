"""Constitutive laws, one family a file; each is a list of variables and an energy."""

from ngvisco.physics.materials.custom import CustomMaterial
from ngvisco.physics.materials.linearised import IsotropicStrainEnergy, LinearElastic
from ngvisco.physics.materials.neo_hookean import NeoHookean

__all__ = ["CustomMaterial", "IsotropicStrainEnergy", "LinearElastic", "NeoHookean"]

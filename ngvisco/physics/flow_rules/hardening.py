"""Isotropic hardening: a yield stress that grows with the plastic strain k that has been.

k is carried by the matter, and what yield stores of its work is an energy phi_h(k) beside the elastic one:

    dk/dt + (v . grad) k = sqrt(2/3) |Pi|,    sigma_Y(k) = sigma_Y + phi_h'(k).

Of the power M : Pi the part phi_h'(k) dk/dt is stored.  At the yield stress the rest, which is dissipated, is
sqrt(2/3) sigma_Y |Pi| with the yield stress of the virgin material, whatever k.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction

from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.tensors import exp, power_of_square, square, tr
from ngvisco.physics.variables import Values, Variable


@dataclass(frozen=True)
class PlasticStrain(Variable):
    """k >= 0, the length of the path of plastic strains, uniaxial: carried, and made by yield."""

    name: str = "plastic_strain"
    kind: str = "scalar"

    def rate(self, z: Values, L: CoefficientFunction, Pi: CoefficientFunction) -> CoefficientFunction:
        """Zero: what yield makes of it is not linear in Pi, and the part of a term."""
        return 0 * tr(L)

    def from_distortion(self, F: CoefficientFunction) -> CoefficientFunction:
        """Zero: whatever was before a start is in its yield stress."""
        return CF(0.0)


PLASTIC_STRAIN = PlasticStrain()


@dataclass(frozen=True, kw_only=True)
class Hardening:
    """phi_h(k) = H k^2/2 + Q (k + (exp(-b k) - 1)/b): linear, and that of Voce (1948) which saturates.

    Per actual volume and convex in k, so that the energy with it is one of ``Material``.  H and Q, Pa, may
    be expressions of parameters.
    """

    H: Modulus
    Q: Modulus
    b: float

    def energy(self, z: Values) -> CoefficientFunction:
        """phi_h, Pa."""
        k = z[PLASTIC_STRAIN.name]
        linear = (0.5 * value_at(self.H, z)) * (k * k)
        if self.Q == 0:
            return linear
        return linear + value_at(self.Q, z) * (k + (1 / self.b) * (exp(-self.b * k) - 1))

    @staticmethod
    def rate(Pi: CoefficientFunction, floor: float) -> CoefficientFunction:
        """dk/dt, 1/s, for |Pi| smoothed at zero below ``floor``, 1/s."""
        size = square(Pi)
        return math.sqrt(2 / 3) * (size * power_of_square(size, -0.5, floor))

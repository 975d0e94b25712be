"""Gent's rubber elasticity: chains of finite length, with one more parameter than neo-Hookean materials."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ngvisco.errors import Quantity
from ngvisco.physics.materials.hyperelastic import ContinuedInJ, IsotropicElastic, referential_volume
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import Tensor, log
from ngvisco.physics.variables import Distortion, LeftCauchyGreen, Values


@dataclass(frozen=True, kw_only=True)
class Gent(ContinuedInJ, IsotropicElastic):
    """phi(H, J) = K_e/2 (J - 2 + 1/J) - G_e J_m ln(1 - (|H|^2 - 3)/J_m), H = J^{-1/3} F (Gent 1996).

    In terms of B = J^{-2/3} F F^T, |H|^2 is tr B.  phi is convex in (H, J) and in (B, J), since -ln is convex
    and falling, and |H|^2 is convex.  The limiter or shorter steps keep J_m + 3 - |H|^2 > 0, and J > 0.  At
    rest the law agrees with ``ReferentialNeoHookean``, and for J_m -> infinity the chains' energy is linear
    in tr B.  In uniaxial stretch lambda at constant volume T_11 - T_22 = 2 G_e f (lambda^2 - 1/lambda) with f
    = J_m/(J_m + 3 - |H|^2).  T(I) = 0.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_e : float
        Bulk modulus.  The value 0 is for branches of a network only.
    J_m : float
        Largest |H|^2 - 3, at which the chains are fully stretched: some 30 to 100 for rubber.
    J_min : float, optional
        J below which the part singular at J = 0 is continued linearly.
    """

    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    J_m: Annotated[float, Quantity("1", "> 0", 50.0)]
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    by_F = Distortion("H", exponent=-1 / 3)
    by_B = LeftCauchyGreen(exponent=-2 / 3)

    def domain(self, z: Values) -> Values:
        return {"J_m + 3 - |H|^2": self._slack(z)}

    def energy(self, z: Values) -> Tensor:
        volume = referential_volume(self.K_e, 0.0, 1.0, z["J"], self.J_min)
        return volume - self.G_e * self.J_m * log((1 / self.J_m) * self._slack(z))

    def _slack(self, z: Values) -> Tensor:
        """The distance J_m + 3 - |H|^2 from full stretch."""
        return (self.J_m + 3) - self.first_invariant(z)

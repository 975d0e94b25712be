"""Mooney-Rivlin materials, which feel the cofactor of F too (paper: rem-polyconvex-general and the
Mooney-Rivlin example after it)."""

import math
from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.materials.elastic_state import IsotropicElastic
from ngvisco.physics.materials.neo_hookean import NeoHookean, first_invariant, volumetric
from ngvisco.physics.materials.referential import LogarithmicNeoHookean, ReferentialNeoHookean
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    Values,
    Variable,
)


@dataclass(frozen=True, kw_only=True)
class MooneyRivlin(NeoHookean):
    """The actual polyconvex Mooney-Rivlin energy in (F, Cof F, J) (paper: rem-polyconvex-general).

        phi = K_e/2 (J - 1 + epsilon/K_e)^2 - epsilon ln J + G_e J^{-2/3} |F|^2
              + 2/(3 sqrt 3) G_mr J^{-2} |H|^3

    The second invariant of F_iso is |H|^2 J^{-4/3}, which is not convex (the paper's remark in the
    Mooney-Rivlin example: the exponent must be <= 1).  Its power 3/2, |H|^3/J^2, is: the perspective of the
    cube (Hartmann and Neff 2003, which the paper cites).  Its factor makes the two agree to second order at
    rest.  Jointly convex in (F, H, J); minimum on SO(3); blows up as J -> 0+.  Stress at rest is
    hydrostatic, T = phi(rest) I with phi(rest) = 3 G_e + 2 G_mr + epsilon^2/(2 K_e).  G_e + G_mr is half
    the usual shear modulus, and the bulk modulus is ``NeoHookean``'s.

    With ``elastic_state="B"`` the two invariants are tr B and (tr N)^{3/2}, B = J^{-2/3} F F^T and
    N = J^{-4/3} Cof(F F^T): linear and convex, so that phi is jointly convex in (B, N, J).
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_e
        Weight of |F|^2; G_e + G_mr is half the usual shear modulus.
    G_mr : float
        Weight of the cofactor; G_e + G_mr is half the usual shear modulus.
    """

    G_mr: Annotated[Modulus, Quantity("Pa", ">= 0", 2.0)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        if self.is_by_B:
            return (LeftCauchyGreen(exponent=-2 / 3), CofactorLeftCauchyGreen(exponent=-4 / 3), Jacobian())
        return (Distortion(), Cofactor(), Jacobian())

    def energy(self, z: Values) -> CoefficientFunction:
        J = z["J"]
        second = tr(z["N"]) ** 1.5 if self.is_by_B else square(z["H"]) ** 1.5 / (J * J)
        first = self.G_e * first_invariant(self, z)
        return volumetric(self, J) + first + 2 / (3 * math.sqrt(3)) * self.G_mr * second


@dataclass(frozen=True, kw_only=True)
class _WithCofactor(IsotropicElastic):
    """Adds G_mr |N|^2, N = J^{-7/6} Cof F, or by B tr N, N = J^{-7/3} Cof(F F^T), to the class after it."""

    G_mr: Annotated[Modulus, Quantity("Pa", ">= 0", 2.0)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        first, *others = super().variables  # type: ignore[safe-super]
        by_F, by_B = Cofactor("N", exponent=-7 / 6), CofactorLeftCauchyGreen(exponent=-7 / 3)
        return (first, by_B if self.is_by_B else by_F, *others)

    def energy(self, z: Values) -> CoefficientFunction:
        second = tr(z["N"]) if self.is_by_B else square(z["N"])
        return super().energy(z) + self.G_mr * second  # type: ignore[safe-super]


@dataclass(frozen=True, kw_only=True)
class ReferentialMooneyRivlin(_WithCofactor, ReferentialNeoHookean):
    """phi(H, N, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2 + G_mr |N|^2 (paper: exa-Mooney–Rivlin-ref),

    H = J^{-5/6} F and N = J^{-7/6} Cof F: the compressible Mooney-Rivlin material with the invariants of
    F_iso, per referential volume.  N's rate is not the paper's printed one, see ``variables``.  Jointly
    convex, strongly in (H, N); blows up as J -> 0+.  T(I) = 0.  K_e is the usual bulk modulus
    (K_e + kappa (kappa + 1) epsilon with the added term), G_e + G_mr half the usual shear modulus (so G_e and
    G_mr are the usual C_10 and C_01).  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_e : float
        Weight of |F|^2 (C_10); G_e + G_mr is half the usual shear modulus.
    G_mr : float
        Weight of the cofactor (C_01); G_e + G_mr is half the usual shear modulus.
    """


@dataclass(frozen=True, kw_only=True)
class LogarithmicMooneyRivlin(_WithCofactor, LogarithmicNeoHookean):
    """``LogarithmicNeoHookean`` with a part of the cofactor (paper: exa-Mooney–Rivlin-ref).

    The paper's referential Mooney-Rivlin energy is neo-Hookean-potential-actual and G_mr |F_iso^-1|^2 per
    referential volume, with -epsilon ln J:

        phi(H, N, A, K) = K_e/2 (1/A - 2(1 - c) + (1 - c)^2 A) + G_e |H|^2 + G_mr |N|^2 - epsilon K,

    c = epsilon/K_e, H = J^{-5/6} F, N = J^{-7/6} Cof F, A = 1/J, K = ln J/J.  Jointly convex, strongly in
    (H, N), strictly in A, and it blows up as A -> 0+.  T(I) = 0; the bulk modulus at rest is K_e + epsilon,
    G_e + G_mr half the usual shear modulus.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    G_e : float
        Weight of |H|^2; G_e + G_mr is half the usual shear modulus.
    G_mr : float
        Weight of the cofactor; G_e + G_mr is half the usual shear modulus.
    K_e, epsilon
        As for ``LogarithmicNeoHookean``.
    """

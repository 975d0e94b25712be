"""Referential neo-Hookean materials: three convex forms of one family (paper: exa-neo-Hookean-ref).

The energy per *referential* volume is K_e/2 (J - 1 + c)^2 + G_e |F_iso|^2 + s(J), F_iso = J^{-1/3} F,
and phi is that divided by J.  With s = 0, c = 0 this is K_e/2 (J - 2 + 1/J) + G_e J^{-5/3} |F|^2, which is
convex neither in F nor in (F, J) but in each of the pairs of variables below.

A body at rest is free of stress, T(I) = 0, because the referential energy is stationary there.  K_e is the
usual bulk modulus at J = 1 (up to c and s); G_e is half the usual shear modulus: T_12 = 2 G_e gamma in
simple shear.

With ``elastic_state="B"`` all three have G_e tr B with the one B = J^{-5/3} F F^T: linear in it, convex in
(B, J) or (B, A, K), strictly in J or A.  (|H|^2/J = tr(J^{-2/3} F F^T)/J is not convex in that tensor and J,
so that there is no second form by B.)
"""

from dataclasses import dataclass
from typing import Annotated, Any

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.materials.elastic_state import IsotropicElastic
from ngvisco.physics.materials.singular import continued_in_J, inverse_power
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import (
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    Values,
    Variable,
)

_BY_B = LeftCauchyGreen(exponent=-5 / 3)


@dataclass(frozen=True, kw_only=True)
class ReferentialNeoHookean(IsotropicElastic):
    """phi(H, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2, H = J^{-5/6} F (paper: exa-neo-Hookean-ref).

    With epsilon > 0 the referential term epsilon/J^kappa is added, i.e. epsilon/J^{kappa + 1} to phi, and
    J - 2 + 1/J becomes (J - 1 + c)^2/J with c = kappa epsilon/K_e, so that T(I) stays 0.

    Jointly convex in (H, J), strongly in H (the paper's rem-neo-Hookean-ref), and it blows up as J -> 0+.
    T(I) = 0; K_e is the usual bulk modulus (K_e + kappa (kappa + 1) epsilon with the added term), G_e half
    the usual shear modulus.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_e : float
        Bulk modulus; the usual one is K_e + kappa (kappa + 1) epsilon.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    epsilon : float
        Weight of the term epsilon/J^kappa per referential volume, which is singular at J = 0.
    kappa : float
        Exponent of that term.
    J_min : float, optional
        All terms singular in J are continued linearly below it (paper: rem-neo-Hookean-ref).
    """

    K_e: Annotated[Modulus, Quantity("Pa", "> 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]
    epsilon: Annotated[Modulus, Quantity("Pa", ">= 0", 0.1)] = 0.0
    kappa: Annotated[float, Quantity("1", ">= 0", 2.0)] = 1.0
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (_BY_B if self.is_by_B else Distortion("H", exponent=-5 / 6), Jacobian())

    @property
    def continued(self) -> frozenset[str]:
        return continued_in_J(self.J_min)

    def energy(self, z: Values) -> CoefficientFunction:
        volume = referential_volume(self.K_e, self.epsilon, self.kappa, z["J"], self.J_min)
        return volume + self.G_e * (tr(z["B"]) if self.is_by_B else square(z["H"]))


@dataclass(frozen=True, kw_only=True)
class IsochoricNeoHookean(ReferentialNeoHookean):
    """phi(H, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2/J, H = J^{-1/3} F (paper: exa-neo-Hookean-ref).

    The same material as ``ReferentialNeoHookean`` by the isochoric part of F.  Jointly convex in (H, J),
    though not strongly (|H|^2/J is the perspective of a square).  By B the two have the same variables.
    Stress at rest, moduli, and ``epsilon`` and ``kappa`` as there.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    J_min : float, optional
        The terms singular in J alone are continued linearly below it.
    """

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (_BY_B if self.is_by_B else Distortion("H", exponent=-1 / 3), Jacobian())

    @property
    def continued(self) -> frozenset[str]:
        return continued_in_J(self.J_min, is_total=self.is_by_B)

    def energy(self, z: Values) -> CoefficientFunction:
        volume = referential_volume(self.K_e, self.epsilon, self.kappa, z["J"], self.J_min)
        return volume + self.G_e * (tr(z["B"]) if self.is_by_B else square(z["H"]) / z["J"])


@dataclass(frozen=True, kw_only=True)
class LogarithmicNeoHookean(IsotropicElastic):
    """neo-Hookean-potential-actual per referential volume, with -epsilon ln J (paper: exa-neo-Hookean-ref).

        phi(H, A, K) = K_e/2 (1/A - 2(1 - c) + (1 - c)^2 A) + G_e |H|^2 - epsilon K,   c = epsilon/K_e,

    with H = J^{-5/6} F, A = 1/J and K = ln J/J.  -(ln J)/J is not convex in J, but linear in K, whose rate
    (tr L)(A - K) closes with that of A.  Jointly convex in (H, A, K), strongly in H, strictly in A, and it
    blows up as A -> 0+.  T(I) = 0; the bulk modulus at rest is K_e + epsilon, G_e is half the usual shear
    modulus.  Raises ParameterError if a parameter is not a finite positive number.

    Parameters
    ----------
    K_e : float
        Bulk modulus; the usual one is K_e + epsilon.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    epsilon : float
        Weight of -epsilon ln J per referential volume, which is singular at J = 0.
    """

    K_e: Annotated[Modulus, Quantity("Pa", "> 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]
    epsilon: Annotated[Modulus, Quantity("Pa", "> 0", 0.1)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        by_F = Distortion("H", exponent=-5 / 6)
        return (_BY_B if self.is_by_B else by_F, ReciprocalJacobian(), LogJacobian())

    def energy(self, z: Values) -> CoefficientFunction:
        A, rest = z["A"], 1 - self.epsilon / self.K_e
        volume = 0.5 * self.K_e * (1 / A - 2 * rest + rest * rest * A)
        shear = tr(z["B"]) if self.is_by_B else square(z["H"])
        return volume + self.G_e * shear - self.epsilon * z["K"]


def referential_volume(
    K_e: Any, epsilon: Any, kappa: float, J: CoefficientFunction, J_min: float | None
) -> CoefficientFunction:
    """[K_e/2 (J - 1 + c)^2 + epsilon/J^kappa]/J with c = kappa epsilon/K_e."""
    rest = 1 - kappa * epsilon / K_e
    volume = 0.5 * K_e * (J - 2 * rest) + inverse_power(0.5 * K_e * rest * rest, 1.0, J, J_min)
    is_without = isinstance(epsilon, (int, float)) and epsilon == 0
    return volume if is_without else volume + inverse_power(epsilon, kappa + 1, J, J_min)

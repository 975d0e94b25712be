"""Neo-Hookean and Mooney-Rivlin materials, by F as in the paper or by B = F F^T.

**F or B.**  F = V Q.  Creep relaxes the stretch V; the rotation Q stays, and in a lasting flow the angles of
neighbouring points differ more and more.  A space of fixed h cannot represent this: the mean of two rotations
has a determinant below one, so that det F and J drift apart while the ledger still closes.  B does not
contain Q, and suffices for isotropic energies, which are linear or convex in B.

**Actual and referential.**  The paper's energies are per actual volume.  The referential energies are K_e/2
(J - 1 + c)^2 + G_e |F_iso|^2 + s(J) per *referential* volume, with F_iso = J^{-1/3} F, and phi is this energy
divided by J (paper: exa-neo-Hookean-ref). phi is convex neither in F nor in (F, J), but in the variables
chosen here.  The referential energies are stationary at rest, so that T(I) = 0.  (|H|^2/J = tr(J^{-2/3} F
F^T)/J is not convex in J^{-2/3} F F^T and J, so that all referential materials have B = J^{-5/3} F F^T.)

**J_min** is the J below which the part singular at J = 0 is continued linearly (paper: rem-neo-Hookean-ref).
The continuation is convex and C1, and has no effect as long as J >= J_min.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Self

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.material import ElasticState, Material
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import Tensor, if_positive, log, square, tr
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    Values,
    Variable,
)


def continued(s: Callable[[Any], Any], slope: Callable[[Any], Any], J: Tensor, J_min: float | None) -> Tensor:
    """The function s(J), continued linearly below ``J_min`` (None: nowhere); ``slope`` is s'.

    s is never evaluated below J_min, not even in the branch of the condition that is not used.
    """
    if J_min is None:
        return s(J)
    above = if_positive(J - J_min, J, J_min)
    return s(above) + slope(above) * (J - above)


class ContinuedInJ(Material):
    """A material whose terms singular in J are all continued linearly below ``J_min``."""

    J_min: float | None

    @property
    def continued(self) -> frozenset[str]:
        return frozenset() if self.J_min is None else frozenset({"J"})


def minus_log(epsilon: Any, J: Tensor, J_min: float | None) -> Tensor:
    """The term -epsilon ln J (paper: neo-Hookean-potential-actual)."""
    return continued(lambda a: -epsilon * log(a), lambda a: -epsilon / a, J, J_min)


def inverse_power(epsilon: Any, kappa: float, J: Tensor, J_min: float | None) -> Tensor:
    """The term epsilon / J^kappa, convex for kappa >= 0 (paper: exa-polyconvex-general)."""
    return continued(lambda a: epsilon * a**-kappa, lambda a: -epsilon * kappa * a ** (-kappa - 1), J, J_min)


def referential_volume(
    K_e: Any, epsilon: Any, kappa: float, J: Tensor, J_min: float | None
) -> Tensor | float:
    """The volumetric energy [K_e/2 (J - 1 + c)^2 + epsilon/J^kappa]/J with c = kappa epsilon/K_e; the number
    0 for a branch with K_e = 0, whose energy does not read J.

    The square is not multiplied out: near J = 1 the sum K_e/2 (J - 2 + 1/J) is a difference of large numbers,
    and its rounding error is a force that no stiffness resists (``forms.terms.tangents``).
    """
    is_without = isinstance(epsilon, (int, float)) and epsilon == 0
    if is_without and isinstance(K_e, (int, float)) and K_e == 0:
        return 0.0
    J_rest = 1.0 if is_without else 1 - kappa * epsilon / K_e

    def square_over_J(a: Any) -> Any:
        return 0.5 * K_e * (a - J_rest) * (a - J_rest) / a

    volume = continued(square_over_J, lambda a: 0.5 * K_e * (1 - (J_rest / a) * (J_rest / a)), J, J_min)
    return volume if is_without else volume + inverse_power(epsilon, kappa + 1, J, J_min)


@dataclass(frozen=True, kw_only=True)
class IsotropicElastic(Material):
    """An isotropic material with a choice of its tensor variables.

    Parameters
    ----------
    elastic_state : str, optional
        Variables by the distortion "F", or by "B" = F F^T; default B with creep or m = 0, else F.
    K_e : float
        Bulk modulus.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    """

    elastic_state: Annotated[ElasticState | None, Quantity(example="B")] = None
    K_e: Annotated[Modulus, Quantity("Pa", "> 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]

    by_F: ClassVar[Variable] = Distortion("H", exponent=-5 / 6)
    by_B: ClassVar[Variable] = LeftCauchyGreen(exponent=-5 / 3)
    """The tensors that express |F|^2, by F and by B."""

    def with_elastic_state(self, state: ElasticState) -> Self:
        return self if self.elastic_state is not None else replace(self, elastic_state=state)

    @property
    def is_by_B(self) -> bool:
        """Whether the variables are left Cauchy-Green tensors; False while ``elastic_state`` is None."""
        return self.elastic_state == "B"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (self.by_B if self.is_by_B else self.by_F, Jacobian())

    def first_invariant(self, z: Values) -> Tensor:
        """Trace of B, or squared norm of the tensor by F: |F|^2 times a power of J."""
        return tr(z["B"]) if self.is_by_B else square(z[self.by_F.name])


@dataclass(frozen=True, kw_only=True)
class NeoHookean(ContinuedInJ, IsotropicElastic):
    """The actual polyconvex neo-Hookean energy (paper: neo-Hookean-potential-actual).

        phi(F, J) = K_e/2 (J - 1 + epsilon/K_e)^2 + G_e J^{-2/3} |F|^2 - epsilon ln J

    With ``kappa``, epsilon/J^kappa replaces -epsilon ln J and kappa epsilon/K_e replaces epsilon/K_e, which
    keeps the minimum at J = 1 (paper: last sentence of exa-polyconvex-general).

    phi is jointly convex in (F, J) (paper: convexity-neo-Hookean), strictly in J, and blows up as J -> 0+.
    The minimum of phi is on SO(3).  The energy is per *actual* volume. The stress at rest is therefore
    phi(I, 1) I = (3 G_e + epsilon^2/(2 K_e)) I, with kappa (3 G_e + epsilon + (kappa epsilon)^2/(2 K_e)) I. A
    body of fixed shape does not feel this stress. Open walls have to bear it, by a pressure of minus this
    stress.  In simple shear F = I + gamma e1 x e2, T_12 is 2 G_e gamma.

    With ``elastic_state="B"`` phi is linear in B = J^{-2/3} F F^T and convex in (B, J), strictly in J.
    Raises ParameterError if a modulus is not positive, or ``elastic_state`` is neither "F" nor "B".

    Parameters
    ----------
    K_e : float
        Modulus; the bulk modulus is K_e + epsilon. With ``kappa`` the bulk modulus is K_e + kappa (kappa + 1)
        epsilon.
    epsilon : float
        Weight of the term that is singular at J = 0.
    kappa : float, optional
        Exponent of epsilon/J^kappa, which replaces -epsilon ln J; the paper has kappa >= 1.
    J_min : float, optional
        J below which the singular term is continued linearly (paper: rem-neo-Hookean-ref); G_e J^{-2/3} |F|^2
        is not continued.
    """

    epsilon: Annotated[Modulus, Quantity("Pa", "> 0", 0.1)]
    kappa: Annotated[float | None, Quantity("1", "> 0", 2.0)] = None
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    by_F = Distortion()
    by_B = LeftCauchyGreen(exponent=-2 / 3)

    @property
    def continued(self) -> frozenset[str]:
        return super().continued if self.is_by_B else frozenset()

    def first_invariant(self, z: Values) -> Tensor:
        """The invariant J^{-2/3} |F|^2."""
        return tr(z["B"]) if self.is_by_B else z["J"] ** (-2 / 3) * square(z["F"])

    def energy(self, z: Values) -> Tensor:
        return self._volumetric(z["J"]) + self.G_e * self.first_invariant(z)

    def _volumetric(self, J: Tensor) -> Tensor:
        """The volumetric energy K_e/2 (J - 1 + c)^2 + s(J), with c such that the minimum is at J = 1."""
        K_e, epsilon, kappa = self.K_e, self.epsilon, self.kappa
        c = epsilon / K_e if kappa is None else kappa * epsilon / K_e
        quadratic = 0.5 * K_e * (J - 1 + c) * (J - 1 + c)
        if kappa is None:
            return quadratic + minus_log(epsilon, J, self.J_min)
        return quadratic + inverse_power(epsilon, kappa, J, self.J_min)


@dataclass(frozen=True, kw_only=True)
class MooneyRivlin(NeoHookean):
    """The actual polyconvex Mooney-Rivlin energy in (F, Cof F, J) (paper: rem-polyconvex-general).

        phi = K_e/2 (J - 1 + epsilon/K_e)^2 - epsilon ln J + G_e J^{-2/3} |F|^2
              + 2/(3 sqrt 3) G_mr J^{-2} |H|^3

    The second invariant of F_iso, |H|^2 J^{-4/3}, is not convex; its power 3/2, |H|^3/J^2, is the perspective
    of the cube (Hartmann and Neff 2003, cited by the paper).  The factor 2/(3 sqrt 3) makes the power and the
    invariant agree to second order at rest.  phi is jointly convex in (F, H, J), has its minimum on SO(3),
    and blows up as J -> 0+.  The stress at rest is T = phi(rest) I with phi(rest) = 3 G_e + 2 G_mr +
    epsilon^2/(2 K_e).

    With ``elastic_state="B"`` the two invariants are tr B and (tr N)^{3/2}, N = J^{-4/3} Cof(F F^T), and phi
    is jointly convex in (B, N, J).  Raises ParameterError if a parameter is out of its range.

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
        first, J = super().variables
        return (first, CofactorLeftCauchyGreen(exponent=-4 / 3) if self.is_by_B else Cofactor(), J)

    def energy(self, z: Values) -> Tensor:
        second = tr(z["N"]) ** 1.5 if self.is_by_B else square(z["H"]) ** 1.5 / (z["J"] * z["J"])
        return super().energy(z) + 2 / (3 * math.sqrt(3)) * self.G_mr * second


@dataclass(frozen=True, kw_only=True)
class ReferentialNeoHookean(ContinuedInJ, IsotropicElastic):
    """phi(H, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2, H = J^{-5/6} F (paper: exa-neo-Hookean-ref).

    With epsilon > 0 phi has the further term epsilon/J^{kappa + 1}, which is epsilon/J^kappa per referential
    volume, and J - 2 + 1/J becomes (J - 1 + c)^2/J with c = kappa epsilon/K_e, so that T(I) is still 0.

    phi is jointly convex in (H, J), strongly in H (the paper's rem-neo-Hookean-ref), and blows up as J -> 0+.
    T_12 = 2 G_e gamma in simple shear.  As a function of (B, J), phi is linear in B and strictly convex in J.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_e : float
        Modulus; the bulk modulus is K_e + kappa (kappa + 1) epsilon.  The value 0 is for branches
        without epsilon.
    epsilon : float
        Weight of the term epsilon/J^kappa per referential volume, which is singular at J = 0.
    kappa : float
        Exponent of the term epsilon/J^kappa.
    J_min : float, optional
        J below which all terms singular in J are continued linearly (paper: rem-neo-Hookean-ref).
    """

    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    epsilon: Annotated[Modulus, Quantity("Pa", ">= 0", 0.1)] = 0.0
    kappa: Annotated[float, Quantity("1", ">= 0", 2.0)] = 1.0
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.K_e == 0 and self.epsilon != 0:
            expected = "a number > 0 if epsilon is not 0, so that the energy has its minimum at J = 1"
            raise ParameterError(f"{type(self).__name__}.K_e", self.K_e, expected)
        require_effect(self, self.epsilon != 0, "with epsilon = 0", "kappa")

    def energy(self, z: Values) -> Tensor:
        volume = referential_volume(self.K_e, self.epsilon, self.kappa, z["J"], self.J_min)
        return volume + self.G_e * self.first_invariant(z)


@dataclass(frozen=True, kw_only=True)
class IsochoricNeoHookean(ReferentialNeoHookean):
    """phi(H, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2/J, H = J^{-1/3} F (paper: exa-neo-Hookean-ref).

    This is ``ReferentialNeoHookean`` in the isochoric part of F.  phi is jointly convex in (H, J), but not
    strongly (|H|^2/J is the perspective of a square).  With ``elastic_state="B"`` both materials are equal.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    J_min : float, optional
        J below which the terms singular in J alone are continued linearly.
    """

    by_F = Distortion("H", exponent=-1 / 3)

    @property
    def continued(self) -> frozenset[str]:
        return super().continued if self.is_by_B else frozenset()

    def first_invariant(self, z: Values) -> Tensor:
        return tr(z["B"]) if self.is_by_B else square(z["H"]) / z["J"]


@dataclass(frozen=True, kw_only=True)
class LogarithmicNeoHookean(IsotropicElastic):
    """The neo-Hookean energy per referential volume with -epsilon ln J (paper: exa-neo-Hookean-ref).

        phi(H, A, K) = K_e/2 (1/A - 2(1 - c) + (1 - c)^2 A) + G_e |H|^2 - epsilon K,   c = epsilon/K_e,

    with H = J^{-5/6} F, A = 1/J and K = ln J/J.  -(ln J)/J is not convex in J, but linear in K, whose rate
    (tr L)(A - K) needs A only.  phi is jointly convex in (H, A, K), strongly in H and strictly in A, and
    blows up as A -> 0+.  T(I) = 0.  Raises ParameterError if a parameter is not a finite positive number.

    Parameters
    ----------
    K_e : float
        Modulus; the bulk modulus is K_e + epsilon.
    epsilon : float
        Weight of -epsilon ln J per referential volume, which is singular at J = 0.
    """

    epsilon: Annotated[Modulus, Quantity("Pa", "> 0", 0.1)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (super().variables[0], ReciprocalJacobian(), LogJacobian())

    def energy(self, z: Values) -> Tensor:
        A, J_rest = z["A"], 1 - self.epsilon / self.K_e
        volume = 0.5 * self.K_e * (1 - J_rest * A) * (1 - J_rest * A) / A
        return volume + self.G_e * self.first_invariant(z) - self.epsilon * z["K"]


@dataclass(frozen=True, kw_only=True)
class _WithCofactor(IsotropicElastic):
    """Mix-in that adds G_mr |N|^2 with N = J^{-7/6} Cof F; or, by B, G_mr tr N with N = J^{-7/3} Cof(F F^T).

    Parameters
    ----------
    G_e : float
        Weight of |H|^2 (C_10); G_e + G_mr is half the usual shear modulus.
    G_mr : float
        Weight of the cofactor (C_01); G_e + G_mr is half the usual shear modulus.
    """

    G_mr: Annotated[Modulus, Quantity("Pa", ">= 0", 2.0)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        first, *volumetric = super().variables
        by_F, by_B = Cofactor("N", exponent=-7 / 6), CofactorLeftCauchyGreen(exponent=-7 / 3)
        return (first, by_B if self.is_by_B else by_F, *volumetric)

    def energy(self, z: Values) -> Tensor:
        second = tr(z["N"]) if self.is_by_B else square(z["N"])
        return super().energy(z) + self.G_mr * second  # type: ignore[safe-super]


@dataclass(frozen=True, kw_only=True)
class ReferentialMooneyRivlin(_WithCofactor, ReferentialNeoHookean):
    """phi(H, N, J) = K_e/2 (J - 2 + 1/J) + G_e |H|^2 + G_mr |N|^2 (paper: exa-Mooney–Rivlin-ref),

    with H = J^{-5/6} F and N = J^{-7/6} Cof F: the compressible Mooney-Rivlin material in the invariants of
    F_iso, per referential volume.  The rate of N differs from the paper's misprint, see ``variables``.  phi
    is jointly convex, strongly in (H, N), and blows up as J -> 0+.  T(I) = 0.  Raises ParameterError if a
    parameter is out of its range.
    """

    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]


@dataclass(frozen=True, kw_only=True)
class LogarithmicMooneyRivlin(_WithCofactor, LogarithmicNeoHookean):
    """``LogarithmicNeoHookean`` with a cofactor term (paper: exa-Mooney–Rivlin-ref).

        phi(H, N, A, K) = K_e/2 (1/A - 2(1 - c) + (1 - c)^2 A) + G_e |H|^2 + G_mr |N|^2 - epsilon K,

    c = epsilon/K_e, H = J^{-5/6} F, N = J^{-7/6} Cof F, A = 1/J, K = ln J/J: the paper's referential
    Mooney-Rivlin energy.  phi is jointly convex, strongly in (H, N), strictly in A, and blows up as A -> 0+.
    T(I) = 0.  Raises ParameterError if a parameter is out of its range.
    """

"""The actual neo-Hookean material of the finite-strain model (paper: Section 3)."""

from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.materials.elastic_state import IsotropicElastic
from ngvisco.physics.materials.singular import continued_in_J, inverse_power, minus_log
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import square, tr
from ngvisco.physics.variables import Distortion, Jacobian, LeftCauchyGreen, Values, Variable


@dataclass(frozen=True, kw_only=True)
class NeoHookean(IsotropicElastic):
    """The actual polyconvex neo-Hookean energy (paper: neo-Hookean-potential-actual).

        phi(F, J) = K_e/2 (J - 1 + epsilon/K_e)^2 + G_e J^{-2/3} |F|^2 - epsilon ln J

    or, with ``kappa``, epsilon/J^kappa in place of -epsilon ln J and kappa epsilon/K_e in place of
    epsilon/K_e, which keeps the minimum at J = 1 (paper: exa-polyconvex-general, its last sentence).

    Jointly convex in (F, J) (paper: convexity-neo-Hookean), strictly so in J by epsilon and K_e; it blows up
    as J -> 0+.  Its minimum is on SO(3).  Stress at rest is hydrostatic and constant, T(I, 1) = phi(I, 1) I =
    (3 G_e + epsilon^2/(2 K_e)) I (with kappa: (3 G_e + epsilon + (kappa epsilon)^2/(2 K_e)) I): an energy per
    *actual* volume, which a body with a fixed shape does not feel.  The usual bulk modulus at rest is K_e +
    epsilon (with kappa: K_e + kappa (kappa + 1) epsilon), and the paper's G_e is half the usual shear
    modulus: in simple shear F = I + gamma e1 x e2, T_12 is 2 G_e gamma.

    With ``elastic_state="B"`` the shear energy is G_e tr B, B = J^{-2/3} F F^T: linear, so that phi is convex
    in (B, J), strictly in J.  Raises ParameterError if a parameter is not a finite positive number, or
    ``elastic_state`` is another.

    Parameters
    ----------
    K_e : float
        Bulk modulus; the usual one is K_e + epsilon, with kappa K_e + kappa (kappa + 1) epsilon.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    epsilon : float
        Weight of the term that is singular at J = 0.
    kappa : float, optional
        Exponent of epsilon/J^kappa, which stands for -epsilon ln J without it; the paper has kappa >= 1.
    J_min : float, optional
        The singular term is continued linearly below this J (paper: rem-neo-Hookean-ref); G_e J^{-2/3} |F|^2
        stays as it is.
    """

    K_e: Annotated[Modulus, Quantity("Pa", "> 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]
    epsilon: Annotated[Modulus, Quantity("Pa", "> 0", 0.1)]
    kappa: Annotated[float | None, Quantity("1", "> 0", 2.0)] = None
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (LeftCauchyGreen(exponent=-2 / 3) if self.is_by_B else Distortion(), Jacobian())

    @property
    def continued(self) -> frozenset[str]:
        return continued_in_J(self.J_min, is_total=self.is_by_B)

    def energy(self, z: Values) -> CoefficientFunction:
        return volumetric(self, z["J"]) + self.G_e * first_invariant(self, z)


def first_invariant(material: NeoHookean, z: Values) -> CoefficientFunction:
    """J^{-2/3} |F|^2."""
    return tr(z["B"]) if material.is_by_B else z["J"] ** (-2 / 3) * square(z["F"])


def volumetric(material: NeoHookean, J: CoefficientFunction) -> CoefficientFunction:
    """K_e/2 (J - 1 + c)^2 + s(J), with c such that the minimum is at J = 1."""
    K_e, epsilon, kappa = material.K_e, material.epsilon, material.kappa
    c = epsilon / K_e if kappa is None else kappa * epsilon / K_e
    quadratic = 0.5 * K_e * (J - 1 + c) * (J - 1 + c)
    if kappa is None:
        return quadratic + minus_log(epsilon, J, material.J_min)
    return quadratic + inverse_power(epsilon, kappa, J, material.J_min)

"""Neo-Hookean materials of the finite-strain model (paper: Section 3)."""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import CoefficientFunction, log

from ngvisco.errors import require_positive
from ngvisco.physics.material import Material
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian, Values, Variable


@dataclass(frozen=True, kw_only=True)
class NeoHookean(Material):
    """The actual polyconvex neo-Hookean energy (paper: neo-Hookean-potential-actual).

        phi(F, J) = K_e/2 (J - 1 + epsilon/K_e)^2 + G_e J^{-2/3} |F|^2 - epsilon ln J

    Jointly convex in (F, J) (paper: convexity-neo-Hookean), strictly so in J by epsilon and K_e; it
    blows up as J -> 0+.  Its minimum is on SO(3).  Stress at rest is hydrostatic and constant,
    T(I, 1) = phi(I, 1) I = (3 G_e + epsilon^2/(2 K_e)) I: an energy per *actual* volume, which a
    body with a fixed shape does not feel.  The paper's G_e is half the usual shear modulus:
    in simple shear F = I + gamma e1 x e2, T_12 = 2 G_e gamma.

    Parameters
    ----------
    K_e, G_e, epsilon : float
        Bulk modulus, half the shear modulus, and weight of the singular term, all Pa, > 0.

    Raises
    ------
    ParameterError
        If a parameter is not a finite positive number.
    """

    K_e: float
    G_e: float
    epsilon: float

    def __post_init__(self) -> None:
        require_positive(self, K_e=self.K_e, G_e=self.G_e, epsilon=self.epsilon)

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Distortion(), Jacobian())

    def energy(self, z: Values) -> CoefficientFunction:
        F, J = z["F"], z["J"]
        volumetric = 0.5 * self.K_e * (J - 1 + self.epsilon / self.K_e) * (J - 1 + self.epsilon / self.K_e)
        return volumetric + self.G_e * J ** (-2 / 3) * square(F) - self.epsilon * log(J)

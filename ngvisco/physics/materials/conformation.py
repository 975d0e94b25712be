"""Viscoelastic fluids by a conformation tensor: Oldroyd-B, Leonov, FENE-P.

B = J^{-2/3} F F^T is the conformation tensor of the dissolved chains.  The energies have a barrier at
det B = 0 and their least value at B = I, so that B relaxes to I without being told its determinant.  What
fluid it is says ``Creep(law=...)``; with the relaxation time lambda = G_m/(4 G_e) and the viscosity
eta = 2 G_e lambda = G_m/2 the relaxation of B is

| law            | Pi                   | relaxation of B in ``OldroydB``          | fluid             |
|----------------|----------------------|------------------------------------------|-------------------|
| "conformation" | 2 zeta/G_m           | -(B - I)/lambda                          | Oldroyd-B, FENE-P |
| "leonov"       | (M/2 + dev zeta)/G_m | -(B^2 - I - tr(B - B^-1)/3 B)/(2 lambda) | Leonov            |
| "mandel"       | M/G_m                | -(B^2 - (tr B/3) B)/lambda               | the paper's creep |

K_e is the usual bulk modulus and G_e half the usual shear modulus; T(I) = 0.  The solvent is the model's
``StokesViscosity``.
"""

from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.material import Material
from ngvisco.physics.materials.referential import referential_volume
from ngvisco.physics.materials.singular import continued_in_J
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import log, log_det, tr
from ngvisco.physics.variables import Jacobian, LeftCauchyGreen, Values, Variable


@dataclass(frozen=True, kw_only=True)
class OldroydB(Material):
    """phi(B, J) = K_e/2 (J - 2 + 1/J) + G_e (tr B - ln det B - 3), B = J^{-2/3} F F^T.

    The energy of Hookean dumbbells, and of Leonov's fluid; see the module's docstring.  Strictly convex in
    B and in J, so jointly; singular as det B -> 0+ and J -> 0+.  dev T = 2 G_e dev B.  Raises ParameterError
    if a parameter is not a finite positive number.

    Parameters
    ----------
    K_e : float
        Bulk modulus, the usual one.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    J_min : float, optional
        The part that is singular at J = 0 is continued linearly below this J.
    """

    K_e: Annotated[Modulus, Quantity("Pa", "> 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (LeftCauchyGreen(exponent=-2 / 3), Jacobian())

    @property
    def conformation(self) -> str | None:
        return "B"

    @property
    def continued(self) -> frozenset[str]:
        return continued_in_J(self.J_min)

    def energy(self, z: Values) -> CoefficientFunction:
        chains = tr(z["B"]) - log_det(z["B"]) - 3
        return referential_volume(self.K_e, 0.0, 1.0, z["J"], self.J_min) + self.G_e * chains


@dataclass(frozen=True, kw_only=True)
class FENEP(OldroydB):
    """phi(B, J) = K_e/2 (J - 2 + 1/J) - G_e [(b - 3) ln((b - tr B)/(b - 3)) + ln det B], B = J^{-2/3} F F^T.

    Dumbbells of a finite length (FENE-P, with Peterlin's closure): zeta_B = G_e (f I - B^-1) with
    f = (b - 3)/(b - tr B), which is 1 at rest, so that -(f B - I)/lambda is the relaxation by the law
    ``conformation``.  Convex in (B, J), strictly; singular as tr B -> b, det B -> 0+ and J -> 0+.
    ``OldroydB`` is the limit b -> infinity.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    b : float
        Square of the chains' largest extension, tr B < b.
    """

    b: Annotated[float, Quantity("1", "> 3", 50.0)]

    def energy(self, z: Values) -> CoefficientFunction:
        B, slack = z["B"], self.b - 3
        chains = slack * log((self.b - tr(B)) * (1 / slack)) + log_det(B)
        return referential_volume(self.K_e, 0.0, 1.0, z["J"], self.J_min) - self.G_e * chains

"""Barotropic fluids, and viscoelastic fluids by a conformation tensor (Oldroyd-B, Leonov, FENE-P).

B = J^{-2/3} F F^T is the conformation tensor of dissolved chains.  The energies of these fluids have a
barrier at det B = 0 and their least value at B = I, so that B relaxes to I without a constraint on det B.
``Creep(law=...)`` chooses the fluid; with the relaxation time lambda = G_m/(4 G_e) and the viscosity eta = 2
G_e lambda = G_m/2 the relaxation of B is

| law            | Pi                   | relaxation of B in ``OldroydB``          | fluid             |
|----------------|----------------------|------------------------------------------|-------------------|
| "conformation" | 2 zeta/G_m           | -(B - I)/lambda                          | Oldroyd-B, FENE-P |
| "leonov"       | (M/2 + dev zeta)/G_m | -(B^2 - I - tr(B - B^-1)/3 B)/(2 lambda) | Leonov            |
| "mandel"       | M/G_m                | -(B^2 - (tr B/3) B)/lambda               | the paper's creep |

T(I) = 0.  The model's ``StokesViscosity`` is the solvent's viscosity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from ngsolve import CF

from ngvisco.errors import ParameterError, Quantity, require_effect, require_numbers
from ngvisco.physics.materials.hyperelastic import ContinuedInJ, inverse_power, referential_volume
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import Tensor, log, log_det, tr
from ngvisco.physics.variables import Jacobian, LeftCauchyGreen, ReciprocalJacobian, Values, Variable


@dataclass(frozen=True, kw_only=True)
class BarotropicFluid(ContinuedInJ):
    """phi = B J^{-gamma} (paper: rem-barotropic-fluids, where B = 1).

    The Cauchy stress is -p I with p = -(J phi(J))' = (gamma - 1) B J^{-gamma}.  As rho = rho_R/J with the
    referential density rho_R, the fluid has the isentropic state equation

        p = a rho^gamma,   a = (gamma - 1) B / rho_R^gamma,

    and phi = B A^gamma with A = 1/J = rho/rho_R.  ``from_state_equation`` makes the material from a.  The
    speed of sound is sqrt(gamma p/rho), the bulk modulus gamma p.  phi is convex in J and in A.  Creep has
    no effect, since there is no shear modulus.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    B : float
        Energy density at the referential density; the pressure there is (gamma - 1) B.
    gamma : float
        Adiabatic exponent.
    form : str
        The carried variable, "J" or "A" = 1/J.
    J_min : float, optional
        J below which the energy is continued linearly, with form = "J" (paper: rem-neo-Hookean-ref).
    rho_R : float, optional
        Density where J = 1, which determines the initial density from J, or J from the density.
    """

    B: Annotated[Modulus, Quantity("Pa", "> 0", 1.0)]
    gamma: Annotated[float, Quantity("1", "> 1", 1.4)]
    form: Literal["J", "A"] = "J"
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0, "arithmetic")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, self.form == "J", 'with form = "A"', "J_min")

    @classmethod
    def from_state_equation(
        cls,
        a: Annotated[float, Quantity("Pa (m^3/kg)^gamma", "> 0", 1.0)],
        gamma: Annotated[float, Quantity("1", "> 1", 1.4)],
        rho_R: Annotated[float, Quantity("kg/m^3", "> 0", 1000.0)],
        form: Literal["J", "A"] = "J",
        J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None,
    ) -> BarotropicFluid:
        """The fluid with the isentropic state equation p = a rho^gamma.

        Raises ParameterError if a parameter is out of its range.

        Parameters
        ----------
        a : float
            Coefficient of the state equation p = a rho^gamma.
        gamma, rho_R, form, J_min
            As for ``BarotropicFluid``.
        """
        require_numbers("BarotropicFluid", "> 0", float, a=a)
        fluid = cls(B=1.0, gamma=gamma, form=form, J_min=J_min, rho_R=rho_R)
        with np.errstate(over="ignore"):
            B = float(a * np.float64(rho_R) ** gamma / (gamma - 1))
        if not 0 < B < math.inf:
            expected = "a number with which a rho_R^gamma/(gamma - 1) is finite and > 0"
            raise ParameterError("BarotropicFluid.a", a, expected)
        return replace(fluid, B=B)

    @property
    def referential_density(self) -> Modulus | None:
        return self.rho_R

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Jacobian(),) if self.form == "J" else (ReciprocalJacobian(),)

    def energy(self, z: Values) -> Tensor:
        if self.form == "A":
            return self.B * z["A"] ** self.gamma
        return inverse_power(self.B, self.gamma, z["J"], self.J_min)

    def start(self, rho_0: float | Tensor, rho_R: float) -> dict[str, Tensor]:
        """The variable's initial value for the density rho_0, as ``Initial(values=...)`` takes it."""
        return {self.form: CF(rho_R / rho_0 if self.form == "J" else rho_0 / rho_R)}


@dataclass(frozen=True, kw_only=True)
class OldroydB(ContinuedInJ):
    """phi(B, J) = K_e/2 (J - 2 + 1/J) + G_e (tr B - ln det B - 3), B = J^{-2/3} F F^T.

    This is the energy of Hookean dumbbells, and of Leonov's fluid; see the module's docstring. The energy is
    strictly convex in B and in J, and therefore jointly. The energy is singular as det B -> 0+ and as J ->
    0+. dev T = 2 G_e dev B. Oldroyd's fluid B needs ``Creep(law="conformation")``: with the default law of
    ``Creep`` the viscosity falls with the rate of shear. Raises ParameterError if a parameter is not a finite
    positive number.

    Parameters
    ----------
    K_e : float
        Bulk modulus.  The value 0 is for branches of a network only.
    G_e : float
        Elastic modulus of shear: half the usual shear modulus.
    J_min : float, optional
        J below which the part singular at J = 0 is continued linearly.
    """

    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None

    conformation = "B"

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (LeftCauchyGreen(exponent=-2 / 3), Jacobian())

    def energy(self, z: Values) -> Tensor:
        return referential_volume(self.K_e, 0.0, 1.0, z["J"], self.J_min) + self.G_e * self.chains(z["B"])

    def chains(self, B: Tensor) -> Tensor:
        """The energy of the chains divided by G_e."""
        return tr(B) - log_det(B) - 3


@dataclass(frozen=True, kw_only=True)
class FENEP(OldroydB):
    """phi(B, J) = K_e/2 (J - 2 + 1/J) - G_e [(b - 3) ln((b - tr B)/(b - 3)) + ln det B], B = J^{-2/3} F F^T.

    The chains are dumbbells of finite length (FENE-P, with Peterlin's closure): zeta_B = G_e (f I - B^-1)
    with f = (b - 3)/(b - tr B), which is 1 at rest.  The relaxation by the law ``conformation`` is -(f B -
    I)/lambda.  phi is strictly convex in (B, J), and singular as tr B -> b, det B -> 0+ and J -> 0+. The
    limiter or shorter steps keep b - tr B > 0, as they keep J > 0.  ``OldroydB`` is the limit b -> infinity.
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    b : float
        Square of the chains' largest extension, tr B < b.
    """

    b: Annotated[float, Quantity("1", "> 3", 50.0)]

    def domain(self, z: Values) -> Values:
        return {"b - tr B": self.b - tr(z["B"])}

    def chains(self, B: Tensor) -> Tensor:
        slack = self.b - 3
        return -(slack * log((self.b - tr(B)) * (1 / slack)) + log_det(B))

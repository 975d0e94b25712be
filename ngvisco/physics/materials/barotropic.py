"""Barotropic fluids: an energy of the volume alone (paper: rem-barotropic-fluids)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from ngsolve import CF, CoefficientFunction

from ngvisco.errors import ParameterError, Quantity, require_choice, require_positive
from ngvisco.physics.material import Material
from ngvisco.physics.materials.singular import continued_in_J, inverse_power
from ngvisco.physics.parameters import Modulus, require_ranges
from ngvisco.physics.variables import Jacobian, ReciprocalJacobian, Values, Variable


@dataclass(frozen=True, kw_only=True)
class BarotropicFluid(Material):
    """phi = B J^{-gamma} (paper: rem-barotropic-fluids, where B = 1).

    The Cauchy stress is -p I with p = -(J phi(J))' = (gamma - 1) B J^{-gamma}.  As rho = rho_R/J with the
    referential density rho_R, this is the isentropic state equation

        p = a rho^gamma,   a = (gamma - 1) B / rho_R^gamma,

    so that rho/rho_R may be taken for the argument: A = 1/J = rho/rho_R obeys the same equation as the
    density, and phi = B A^gamma.  ``from_state_equation`` is the material from a.  With ``rho_R`` a run's
    initial J is that of its initial density, or the other way round (``start`` is J by hand).  The speed of
    sound is c^2 = dp/d rho = gamma p/rho.

    Convex in J for every gamma > 0, in A for gamma >= 1; gamma > 1 is asked for, since the pressure is
    not positive otherwise.  Stress at rest -(gamma - 1) B I; the bulk modulus is gamma p.  There is no
    shear modulus, and creep does nothing.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    B : float
        Energy density at the referential density; the pressure there is (gamma - 1) B.
    gamma : float
        Adiabatic exponent.
    form : str
        The variable that is carried, "J" or "A" = 1/J.
    J_min : float, optional
        With form = "J": the energy is continued linearly below this J (paper: rem-neo-Hookean-ref).
    rho_R : float, optional
        Density where J = 1; with it the initial density and J follow from one another.
    """

    B: Annotated[Modulus, Quantity("Pa", "> 0", 1.0)]
    gamma: Annotated[float, Quantity("1", "> 1", 1.4)]
    form: str = "J"
    J_min: Annotated[float | None, Quantity("1", "> 0", 0.1)] = None
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0)] = None

    def __post_init__(self) -> None:
        require_ranges(self)
        require_choice(self, ("J", "A"), form=self.form)
        if self.form == "A":
            require_choice(self, (None,), J_min=self.J_min)

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
            Of the state equation p = a rho^gamma.
        gamma, rho_R, form, J_min
            As for ``BarotropicFluid``.
        """
        require_positive("BarotropicFluid", a=a)
        fluid = cls(B=1.0, gamma=gamma, form=form, J_min=J_min, rho_R=rho_R)
        with np.errstate(over="ignore"):
            B = float(a * np.float64(rho_R) ** gamma / (gamma - 1))
        if not 0 < B < math.inf:
            raise ParameterError("BarotropicFluid.a", a, "a rho_R^gamma/(gamma - 1) finite and > 0")
        return replace(fluid, B=B)

    @property
    def referential_density(self) -> Modulus | None:
        return self.rho_R

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (Jacobian(),) if self.form == "J" else (ReciprocalJacobian(),)

    @property
    def continued(self) -> frozenset[str]:
        return continued_in_J(self.J_min)

    def energy(self, z: Values) -> CoefficientFunction:
        if self.form == "A":
            return self.B * z["A"] ** self.gamma
        return inverse_power(self.B, self.gamma, z["J"], self.J_min)

    def start(self, rho_0: float | CoefficientFunction, rho_R: float) -> dict[str, CoefficientFunction]:
        """Initial value of the variable that belongs to rho_0, for ``Initial(values=...)``."""
        return {self.form: CF(rho_R / rho_0 if self.form == "J" else rho_0 / rho_R)}

    def pressure(self, rho: Any, rho_R: float) -> Any:
        """p = a rho^gamma, Pa; ``rho`` a number or a coefficient function."""
        return (self.gamma - 1) * self.B * (rho / rho_R) ** self.gamma

    def sound_speed(self, rho: float, rho_R: float) -> float:
        """sqrt(gamma p/rho), m/s."""
        return math.sqrt(self.gamma * self.pressure(rho, rho_R) / rho)

"""Barotropic fluids: an energy of the volume alone (paper: rem-barotropic-fluids)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import require_above, require_choice, require_positive
from ngvisco.physics.material import Material
from ngvisco.physics.materials.singular import check_continuation, continued_in_J, inverse_power
from ngvisco.physics.variables import Jacobian, ReciprocalJacobian, Values, Variable


@dataclass(frozen=True, kw_only=True)
class BarotropicFluid(Material):
    """phi = B J^{-gamma} (paper: rem-barotropic-fluids, where B = 1).

    The Cauchy stress is -p I with p = -(J phi(J))' = (gamma - 1) B J^{-gamma}.  As rho = rho_R/J with the
    referential density rho_R, this is the isentropic state equation

        p = a rho^gamma,   a = (gamma - 1) B / rho_R^gamma,

    so that rho/rho_R may be taken for the argument: A = 1/J = rho/rho_R obeys the same equation as the
    density, and phi = B A^gamma.  ``start`` gives the variable's initial value for an initial density, and
    ``from_state_equation`` the material from a.  The speed of sound is c^2 = dp/d rho = gamma p/rho.

    Convex in J for every gamma > 0, in A for gamma >= 1; gamma > 1 is asked for, since the pressure is
    not positive otherwise.  Stress at rest -(gamma - 1) B I; the bulk modulus is gamma p.  There is no
    shear modulus, and creep does nothing.

    Parameters
    ----------
    B : float
        Energy density at rho = rho_R, Pa, > 0.
    gamma : float
        Adiabatic exponent, > 1.
    form : str
        The transported variable, ``"J"`` (default) or ``"A"``.
    J_min : float, optional
        With ``form="J"``: the energy is continued linearly below it (paper: rem-neo-Hookean-ref).

    Raises
    ------
    ParameterError
        If a parameter is out of its range.
    """

    B: float
    gamma: float
    form: str = "J"
    J_min: float | None = None

    def __post_init__(self) -> None:
        require_positive(self, B=self.B)
        require_above(self, 1, gamma=self.gamma)
        require_choice(self, ("J", "A"), form=self.form)
        check_continuation(self, self.J_min)
        if self.form == "A":
            require_choice(self, (None,), J_min=self.J_min)

    @classmethod
    def from_state_equation(cls, a: float, gamma: float, rho_R: float, form: str = "J") -> BarotropicFluid:
        """The fluid with p = a rho^gamma and referential density rho_R, kg/m^3."""
        return cls(B=a * rho_R**gamma / (gamma - 1), gamma=gamma, form=form)

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

"""Creep by thermally activated jumps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.flow_rules.rule import GradientRule
from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.tensors import exp, if_positive, log, sqrt, square
from ngvisco.physics.variables import Values

_SMALL = 1e-4
"""(|M|/sigma_0)^2 below which sinh x/x is its series, whose error is then 2e-16."""


@dataclass(frozen=True, kw_only=True)
class Eyring(GradientRule):
    """Pi = A sinh(|M|/sigma_0) M/|M|, of the potential A sigma_0 (cosh(|M|/sigma_0) - 1) (Eyring 1936).

    Linear below sigma_0, with G_m = sigma_0/A, and exponential above: glassy polymers, and rocks at low
    temperatures.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    A : float
        Rate of the jumps.
    sigma_0 : float
        Stress that biases them.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, with nu > 0; far below A.
    """

    A: Annotated[Modulus, Quantity("1/s", "> 0", 0.1)]
    sigma_0: Annotated[Modulus, Quantity("Pa", "> 0", 1.0)]
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        sigma = value_at(self.sigma_0, z)
        s = square(M) / (sigma * sigma)
        x = sqrt(s + _SMALL**4)
        ratio = if_positive(s - _SMALL, (exp(x) - exp(-x)) / (2 * x), 1 + s / 6 + s * s / 120)
        return value_at(self.A, z) / sigma * ratio * M

    def psi(self, Pi: CoefficientFunction, z: Values) -> CoefficientFunction:
        """sigma_0 (|Pi| arsinh(|Pi|/A) - sqrt(|Pi|^2 + A^2) + A), W/m^3."""
        A, size = value_at(self.A, z), sqrt(square(Pi) + self.rate_floor**2)
        hypotenuse = sqrt(size * size + A * A)
        return value_at(self.sigma_0, z) * (size * log((size + hypotenuse) / A) - hypotenuse + A)

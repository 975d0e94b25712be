"""Power-law creep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.flow_rules.rule import TINY_STRESS, GradientRule
from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.tensors import power_of_square, square
from ngvisco.physics.variables import Values


@dataclass(frozen=True, kw_only=True)
class Norton(GradientRule):
    """Power-law creep Pi = A |M|^{n-1} M, of the potential A |M|^{n+1}/(n+1) (Norton 1929, Glen 1955).

    A law of uniaxial tests, strain rate B sigma^n, has A = (3/2)^{(n+1)/2} B.  With n = 1 it is ``Creep``
    with G_m = 1/A.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    A : float
        Rate of creep at |M| = 1 Pa.
    n : float
        Exponent of the stress.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, with nu > 0; far below the rates of interest.
    """

    A: Annotated[Modulus, Quantity("1/s/Pa^n", "> 0", 0.1)]
    n: Annotated[float, Quantity("1", "from 1 to 10", 3.0)]
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    @property
    def degree(self) -> float:  # type: ignore[override]
        return float(self.n)

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        return value_at(self.A, z) * power_of_square(square(M), 0.5 * (self.n - 1), TINY_STRESS) * M

    def psi(self, Pi: CoefficientFunction, z: Values) -> CoefficientFunction:
        """n/(n+1) A^{-1/n} |Pi|^{(n+1)/n}, W/m^3."""
        n = float(self.n)
        factor = (n / (n + 1)) * value_at(self.A, z) ** (-1 / n)
        return factor * power_of_square(square(Pi), 0.5 * (n + 1) / n, self.rate_floor)

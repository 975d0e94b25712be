"""Yield: creep by what the stress exceeds its yield stress by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.flow_rules.hardening import Hardening
from ngvisco.physics.flow_rules.rule import TINY_STRESS, FlowRule, GradientRule
from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.tensors import if_positive, power_of_square, sqrt, square
from ngvisco.physics.variables import HARDENING, PRESSURE, Values


def norm(A: CoefficientFunction) -> CoefficientFunction:
    """|A|, with a derivative, zero, at A = 0."""
    return sqrt(square(A) + TINY_STRESS**2)


def positive(a: CoefficientFunction) -> CoefficientFunction:
    """a where it is positive, 0 elsewhere."""
    return if_positive(a, a, 0 * a)


@dataclass(frozen=True, kw_only=True)
class Perzyna(GradientRule):
    """Viscoplasticity with the yield condition of von Mises (Perzyna 1966; n = 1: Bingham 1916).

        Pi = 1/G_m (|M| - s)^+ ((|M| - s)^+/s)^{n-1} M/|M|,   s = sqrt(2/3) sigma_Y,

    of the potential s^2/(G_m (n + 1)) ((|M| - s)^+/s)^{n+1}.  Nothing flows up to the uniaxial stress
    sigma_Y; in shear that is sigma_Y/sqrt(3).  For G_m -> 0 the stress does not leave the yield surface,
    which is rate-independent perfect plasticity (Prandtl-Reuss).

    With H or Q it hardens isotropically: sigma_Y grows by H k + Q (1 - exp(-b k)) with the plastic strain k,
    dk/dt = sqrt(2/3) |Pi|, which the matter carries (the field ``plastic_strain``), and stores the work of it
    (``ngvisco.physics.flow_rules.hardening``).  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    sigma_Y : float
        Uniaxial yield stress.
    G_m : float
        Viscosity of what exceeds it: twice the plastic viscosity of a Bingham fluid.
    n : float
        Exponent of the overstress.
    H : float
        Linear hardening: slope of the uniaxial yield stress by the plastic strain.
    Q : float
        Hardening that saturates (Voce 1948): by how much the yield stress grows altogether.
    b : float
        How fast it does: 1/b is the plastic strain at which 63 per cent of Q are there.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, with nu > 0: what does not yield flows by less than it.  A
        thousandth of the rates of interest; one much smaller may need more iterations than there are.
    """

    sigma_Y: Annotated[Modulus, Quantity("Pa", "> 0", 2.0)]
    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 0.1)]
    n: Annotated[float, Quantity("1", "from 1 to 10")] = 1.0
    H: Annotated[Modulus, Quantity("Pa", ">= 0", 5.0)] = 0.0
    Q: Annotated[Modulus, Quantity("Pa", ">= 0", 1.0)] = 0.0
    b: Annotated[float, Quantity("1", "> 0")] = 10.0
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    @property
    def hardening(self) -> Hardening | None:
        if self.H == 0 and self.Q == 0:
            return None
        return Hardening(H=self.H, Q=self.Q, b=float(self.b))

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset() if self.hardening is None else frozenset({HARDENING})

    def threshold(self, z: Values) -> CoefficientFunction | float:
        """|M| at which it yields, s, Pa."""
        sigma_Y = value_at(self.sigma_Y, z)
        return math.sqrt(2 / 3) * (sigma_Y if self.hardening is None else sigma_Y + z[HARDENING])

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        size, s = norm(M), self.threshold(z)
        over = positive(size - s)
        if self.n > 1:
            over = over * power_of_square(over * over / (s * s), 0.5 * (self.n - 1), TINY_STRESS)
        return over / (value_at(self.G_m, z) * size) * M

    def psi(self, Pi: CoefficientFunction, z: Values) -> CoefficientFunction:
        """s |Pi| + n/(n+1) (G_m s^{n-1})^{1/n} |Pi|^{(n+1)/n}, W/m^3."""
        n, s, size = float(self.n), self.threshold(z), square(Pi)
        viscous = (value_at(self.G_m, z) * s ** (n - 1)) ** (1 / n)
        smooth = power_of_square(size, 0.5 * (n + 1) / n, self.rate_floor)
        return s * power_of_square(size, 0.5, self.rate_floor) + (n / (n + 1) * viscous) * smooth


@dataclass(frozen=True, kw_only=True)
class DruckerPrager(FlowRule):
    """Viscoplasticity of frictional matter, whose strength grows with its pressure p (Drucker, Prager 1952).

        Pi = 1/G_m (|M| - s)^+ M/|M|,   s = sqrt(2) (c cos phi + p sin phi)^+,   p = -tr T/3,

    so that sqrt(J_2) = |M|/sqrt(2) is held to c cos phi + p sin phi, as in plane strain by Mohr and Coulomb.
    It does not dilate: tr Pi = 0, which has no potential together with this s, but M : Pi >= 0 always.  It is
    local.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    cohesion : float
        Cohesion c.
    friction_angle : float
        Angle phi of internal friction, degrees.
    G_m : float
        Viscosity of what exceeds the strength.
    """

    cohesion: Annotated[Modulus, Quantity("Pa", ">= 0", 1.0)]
    friction_angle: Annotated[float, Quantity("1", "in [0, 90) degrees", 30.0)]
    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 0.1)]

    reads = frozenset({PRESSURE})

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        phi = math.radians(self.friction_angle)
        strength = math.cos(phi) * value_at(self.cohesion, z) + math.sin(phi) * z[PRESSURE]
        size = norm(M)
        over = positive(size - math.sqrt(2) * positive(strength))
        return over / (value_at(self.G_m, z) * size) * M

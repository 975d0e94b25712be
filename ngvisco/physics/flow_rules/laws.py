"""The flow rules: the paper's linear rule, powers, Eyring's jumps, yield, and sums of rules."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Annotated, Literal, TypeAlias

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.flow_rules.rule import TINY_STRESS, FlowRule, GradientRule, Hardening
from ngvisco.physics.parameters import Modulus, typical_value, value_at
from ngvisco.physics.tensors import Tensor, dev, exp, if_positive, log, power_of_square, sqrt, square
from ngvisco.physics.variables import HARDENING, PRESSURE, Values

CreepLaw: TypeAlias = Literal["mandel", "conformation", "leonov"]
DrivenBy: TypeAlias = Literal["mandel", "conformation"]
"""Direction of the rate: "mandel" is M, "conformation" is 2 zeta, zeta the conjugate of a conformation
tensor."""


class _Driven(GradientRule):
    """A rule whose rate is along a tensor that ``law`` chooses, such as M, or 2 zeta, which has a trace."""

    law: CreepLaw

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law != "mandel" and self.nu != 0:
            expected = f"0 for law = {self.law!r}, since this law is local"
            raise ParameterError(f"{type(self).__name__}.nu", self.nu, expected)

    @property
    def reads_conjugate(self) -> bool:  # type: ignore[override]
        return self.law != "mandel"

    @property
    def has_trace(self) -> bool:  # type: ignore[override]
        return self.law == "conformation"

    def along(self, M: Tensor, zeta: Tensor | None) -> Tensor:
        """The direction of the rate, M or 2 zeta, Pa."""
        return M if zeta is None or self.law == "mandel" else 2 * zeta


@dataclass(frozen=True, kw_only=True)
class Creep(_Driven):
    """Maxwellian creep G_m Pi - div(nu |grad Pi|^{q-2} grad Pi) = M (paper: ED-Euler-large3).

    ``law`` chooses the driving stress of Pi.  The laws ``"conformation"`` and ``"leonov"`` need a
    conformation tensor B with the conjugate zeta (``OldroydB``, ``FENEP``), are local (nu = 0), and agree
    with ``"mandel"`` at small elastic strains:

    * ``"mandel"``: G_m Pi = M; for small strains E_ZJ = eps(v) - R dev S (paper:
      Euler-small-viscoelastodyn+2),
    * ``"conformation"``: G_m Pi = 2 zeta, with a trace, so that det B relaxes too (Oldroyd-B, FENE-P),
    * ``"leonov"``: G_m Pi = M/2 + dev zeta (Leonov).

    The sign follows from the energy balance; the paper's flow rules print G_m Pi = -M. In a steady flow with
    the strain rate eps, dev T = G_m dev eps.  The stress relaxes like exp(-t/lambda) with the Maxwell time
    lambda = G_m/(2 G), where G is the usual shear modulus (G_e for small-strain materials, 2 G_e for
    neo-Hookean ones, 2 (G_e + G_mr) for Mooney-Rivlin).  Raises ParameterError if a parameter is out of its
    range.

    Parameters
    ----------
    G_m : float
        Creep modulus: twice the usual viscosity eta of the Maxwell dashpot, G_m = 2 eta; with the usual shear
        modulus G the relaxation time of shear is G_m/(2 G). An infinite G_m gives no creep (Kelvin-Voigt).
    floor : float
        |grad Pi| below which powers other than even integers are smoothed.
    law : str
        Driving stress: "mandel" (the paper); "conformation" or "leonov" with a conformation tensor.
    """

    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 5.0, "harmonic")]
    floor: Annotated[float, Quantity("1/(m s)", "> 0")] = 1e-10
    law: CreepLaw = "mandel"

    degree = 1.0

    def __post_init__(self) -> None:
        if isinstance(self.G_m, float) and self.G_m == math.inf:
            replace(self, G_m=1.0)  # the base class checks the other parameters
        else:
            super().__post_init__()

    @property
    def R(self) -> float:
        """Reciprocal creep modulus 1/G_m, 1/(Pa s), at the typical value of G_m if G_m is an expression."""
        return 1 / typical_value(self.G_m)

    @property
    def is_linear(self) -> bool:
        return isinstance(self.G_m, float)

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        R = 1 / value_at(self.G_m, z)
        if self.law == "mandel":
            return R * M
        assert zeta is not None
        return R * (2 * zeta if self.law == "conformation" else 0.5 * M + dev(zeta))

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential G_m |Pi|^2/2, W/m^3."""
        return (0.5 * value_at(self.G_m, z)) * square(Pi)

    @property
    def flows(self) -> bool:
        return self.R > 0


@dataclass(frozen=True, kw_only=True)
class Norton(_Driven):
    """Power-law creep Pi = A |M|^{n-1} M, with the potential A |M|^{n+1}/(n+1) (Norton 1929, Glen 1955).

    The uniaxial law, strain rate = B sigma^n, has A = (3/2)^{(n+1)/2} B.  For n = 1 the rule is ``Creep``
    with G_m = 1/A.  ``law`` = "conformation" gives Pi = A |M|^{n-1} 2 zeta, a fluid whose relaxation time
    falls with the stress.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    A : float
        Rate of creep at |M| = 1 Pa.
    n : float
        Exponent of the stress.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, if nu > 0. Choose a value far below the rates of interest.
    law : str
        Direction of Pi: "mandel", or "conformation" for a fluid by a conformation tensor.
    """

    A: Annotated[Modulus, Quantity("1/s/Pa^n", "> 0", 0.1, "arithmetic")]
    n: Annotated[float, Quantity("1", "from 1 to 10", 3.0)]
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9
    law: DrivenBy = "mandel"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, self.n > 1, "with n = 1", "rate_floor")

    @property
    def degree(self) -> float:  # type: ignore[override]
        return float(self.n)

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        size = value_at(self.A, z) * power_of_square(square(M), 0.5 * (self.n - 1), TINY_STRESS)
        return size * self.along(M, zeta)

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential n/(n+1) A^{-1/n} |Pi|^{(n+1)/n}, W/m^3."""
        n = float(self.n)
        factor = (n / (n + 1)) * value_at(self.A, z) ** (-1 / n)
        return factor * power_of_square(square(Pi), 0.5 * (n + 1) / n, self.rate_floor)


_SMALL = 1e-4
"""(|M|/sigma_0)^2 below which sinh x/x is evaluated by its series, with an error of 2e-16."""


@dataclass(frozen=True, kw_only=True)
class Eyring(GradientRule):
    """Pi = A sinh(|M|/sigma_0) M/|M|, with the potential A sigma_0 (cosh(|M|/sigma_0) - 1) (Eyring 1936).

    The rule is linear below sigma_0, with G_m = sigma_0/A, and exponential above, as for glassy polymers and
    for rocks at low temperatures.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    A : float
        Rate of the thermal jumps.
    sigma_0 : float
        Stress that biases the jumps by the factor e.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, if nu > 0. Choose a value far below A.
    """

    A: Annotated[Modulus, Quantity("1/s", "> 0", 0.1, "arithmetic")]
    sigma_0: Annotated[Modulus, Quantity("Pa", "> 0", 1.0)]
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        sigma = value_at(self.sigma_0, z)
        s = square(M) / (sigma * sigma)
        x = sqrt(s + _SMALL**4)
        ratio = if_positive(s - _SMALL, (exp(x) - exp(-x)) / (2 * x), 1 + s / 6 + s * s / 120)
        return value_at(self.A, z) / sigma * ratio * M

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential sigma_0 (|Pi| arsinh(|Pi|/A) - sqrt(|Pi|^2 + A^2) + A), W/m^3."""
        A, size = value_at(self.A, z), sqrt(square(Pi) + self.rate_floor**2)
        hypotenuse = sqrt(size * size + A * A)
        return value_at(self.sigma_0, z) * (size * log((size + hypotenuse) / A) - hypotenuse + A)


def norm(A: Tensor) -> Tensor:
    """The norm |A|, smoothed so that its derivative at A = 0 is zero."""
    return sqrt(square(A) + TINY_STRESS**2)


def positive(a: Tensor) -> Tensor:
    """The positive part of a."""
    return if_positive(a, a, 0 * a)


@dataclass(frozen=True, kw_only=True)
class Perzyna(_Driven):
    """Viscoplasticity with the yield condition of von Mises (Perzyna 1966; n = 1: Bingham 1916).

        Pi = 1/G_m (|M| - s)^+ ((|M| - s)^+/s)^{n-1} M/|M|,   s = sqrt(2/3) sigma_Y,

    with the potential s^2/(G_m (n + 1)) ((|M| - s)^+/s)^{n+1}.  The material creeps only above the stress
    sigma_Y in tension, or sigma_Y/sqrt(3) in shear.  The limit G_m -> 0 is rate-independent perfect
    plasticity.

    With H or Q the material hardens: sigma_Y grows by H k + Q (1 - exp(-b k)) with the plastic strain k. The
    matter carries k (the field ``plastic_strain``), and the work of hardening is stored
    (``ngvisco.physics.flow_rules.rule``).

    ``law`` = "conformation" replaces M/|M| by 2 zeta/|M|.  With ``OldroydB`` this is the elastoviscoplastic
    fluid of Saramito (2007), and for n > 1 of Herschel-Bulkley type (Saramito 2009), with the yield stress
    sigma_Y/sqrt(3) in shear and the relaxation time G_m/(4 G_e).  Raises ParameterError if a parameter is out
    of its range, or H or Q is not 0 with this law.

    Parameters
    ----------
    sigma_Y : float
        Uniaxial yield stress.
    G_m : float
        Viscosity of the overstress: twice the plastic viscosity of a Bingham fluid.
    n : float
        Exponent of the overstress.
    H : float
        Linear hardening: slope of the uniaxial yield stress by the plastic strain.
    Q : float
        Saturating hardening (Voce 1948): total growth of the yield stress.
    b : float
        Rate of the saturation: the growth is 63 per cent of Q at the plastic strain 1/b.
    rate_floor : float
        |Pi| below which psi is smoothed at zero, if nu > 0; matter below yield creeps by less than
        rate_floor.  Choose a thousandth of the rates of interest, since with a much smaller rate_floor
        Newton's iteration may fail.
    law : str
        Direction of Pi: "mandel", or "conformation" for a fluid by a conformation tensor.
    """

    sigma_Y: Annotated[Modulus, Quantity("Pa", "> 0", 2.0)]
    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 0.1, "harmonic")]
    n: Annotated[float, Quantity("1", "from 1 to 10")] = 1.0
    H: Annotated[Modulus, Quantity("Pa", ">= 0", 5.0)] = 0.0
    Q: Annotated[Modulus, Quantity("Pa", ">= 0", 1.0)] = 0.0
    b: Annotated[float, Quantity("1", "> 0")] = 10.0
    rate_floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9
    law: DrivenBy = "mandel"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("H", "Q") if self.law != "mandel" else ():
            if (value := getattr(self, name)) != 0:
                expected = f"0 for law = {self.law!r}, since the rate of this law is not along M"
                raise ParameterError(f"Perzyna.{name}", value, expected)
        require_effect(self, self.Q != 0, "with Q = 0", "b")

    @property
    def hardening(self) -> Hardening | None:
        return None if self.H == self.Q == 0 else Hardening(H=self.H, Q=self.Q, b=float(self.b))

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset() if self.hardening is None else frozenset({HARDENING})

    def threshold(self, z: Values) -> Tensor | float:
        """The threshold s of |M| for yield, Pa."""
        sigma_Y = value_at(self.sigma_Y, z)
        return math.sqrt(2 / 3) * (sigma_Y if self.hardening is None else sigma_Y + z[HARDENING])

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        size, s = norm(M), self.threshold(z)
        over = positive(size - s)
        if self.n > 1:
            over = over * power_of_square(over * over / (s * s), 0.5 * (self.n - 1), TINY_STRESS)
        return over / (value_at(self.G_m, z) * size) * self.along(M, zeta)

    def overstress(self, rate: float, z: Values) -> float:
        ratio = typical_value(self.G_m) * rate / (math.sqrt(2 / 3) * typical_value(self.sigma_Y))
        return float(ratio ** (1 / self.n))

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential s |Pi| + n/(n+1) (G_m s^{n-1})^{1/n} |Pi|^{(n+1)/n}, W/m^3."""
        n, s, size = float(self.n), self.threshold(z), square(Pi)
        viscous = (value_at(self.G_m, z) * s ** (n - 1)) ** (1 / n)
        smooth = power_of_square(size, 0.5 * (n + 1) / n, self.rate_floor)
        return s * power_of_square(size, 0.5, self.rate_floor) + (n / (n + 1) * viscous) * smooth


@dataclass(frozen=True, kw_only=True)
class DruckerPrager(FlowRule):
    """Viscoplasticity of frictional matter, whose strength grows with the pressure p (Drucker, Prager 1952).

        Pi = 1/G_m (|M| - s)^+ M/|M|,   s = sqrt(2) (c cos phi + p sin phi)^+,   p = -tr T/3,

    so that sqrt(J_2) = |M|/sqrt(2) is limited to c cos phi + p sin phi, which is the limit of Mohr and
    Coulomb in plane strain.  The material does not dilate: tr Pi = 0.  Because s depends on p, the rule has
    no potential, but M : Pi >= 0 always.  The rule is local.  Raises ParameterError if a parameter is out of
    its range.

    Parameters
    ----------
    cohesion : float
        Cohesion c.
    friction_angle : float
        Angle phi of internal friction, degrees.
    G_m : float
        Viscosity of the overstress.
    """

    cohesion: Annotated[Modulus, Quantity("Pa", ">= 0", 1.0)]
    friction_angle: Annotated[float, Quantity("1", "in [0, 90) degrees", 30.0)]
    G_m: Annotated[Modulus, Quantity("Pa s", "> 0", 0.1, "harmonic")]

    reads = frozenset({PRESSURE})

    def overstress(self, rate: float, z: Values) -> float:
        strength = math.sqrt(2) * math.cos(math.radians(self.friction_angle)) * typical_value(self.cohesion)
        return typical_value(self.G_m) * rate / strength if strength > 0 else 0.0

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        phi = math.radians(self.friction_angle)
        strength = math.cos(phi) * value_at(self.cohesion, z) + math.sin(phi) * z[PRESSURE]
        size = norm(M)
        return positive(size - math.sqrt(2) * positive(strength)) / (value_at(self.G_m, z) * size) * M


@dataclass(frozen=True, kw_only=True)
class Composite(FlowRule):
    """Sum of the rates of several rules under one stress, such as diffusion and dislocation creep.

    The potential of Pi has no closed form, so that the rule is local.  Raises ParameterError if a parameter
    is out of its range.

    Parameters
    ----------
    rules : sequence of FlowRule
        The rules, at least one, each local (nu = 0).
    """

    rules: tuple[FlowRule, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.rules:
            raise ParameterError("Composite.rules", self.rules, "at least one flow rule")
        for i, rule in enumerate(self.rules):
            if not rule.is_local:
                expected = "0 in a sum of flow rules, since a sum has no gradient term"
                raise ParameterError(f"Composite.rules[{i}].nu", rule.nu, expected)
            if rule.hardening is not None:
                expected = "0, no hardening, since a sum of rules has no plastic strain of a single rule"
                name = "Q" if rule.hardening.H == 0 else "H"
                raise ParameterError(f"Composite.rules[{i}].{name}", getattr(rule.hardening, name), expected)

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        return reduce(add, (rule.rate(M, zeta, z) for rule in self.rules if rule.flows))

    def overstress(self, rate: float, z: Values) -> float:
        return max(rule.overstress(rate, z) for rule in self.rules)

    @property
    def flows(self) -> bool:
        return any(rule.flows for rule in self.rules)

    @property
    def reads_conjugate(self) -> bool:  # type: ignore[override]
        return any(rule.reads_conjugate for rule in self.rules)

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return frozenset[str]().union(*(rule.reads for rule in self.rules))

    @property
    def degree(self) -> float:  # type: ignore[override]
        return max(rule.degree for rule in self.rules)

    @property
    def has_trace(self) -> bool:  # type: ignore[override]
        return any(rule.has_trace for rule in self.rules)

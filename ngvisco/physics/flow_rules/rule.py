"""Flow rules: the creep rate Pi as a function of what drives it, and hardening.

A rule is local, Pi = rate(M, zeta, z) at every point, or has a gradient term,

    psi'(Pi) - div(nu |grad Pi|^{q-2} grad Pi) = M,   (n . grad) Pi = 0 on walls   (paper: ED-Euler-large3)

with psi(Pi) the potential whose derivative is the inverse of M -> rate(M).  Both are written with the
operations of ``ngvisco.physics.tensors``, for coefficient functions and arrays alike; derivatives are never
written.

A rule that hardens has a yield stress that grows with the plastic strain k that has been.  The matter carries
k, and what yield stores of its work is an energy phi_h(k) per reference volume beside the elastic one.  Per
actual volume, with A = 1/J, the matter carries the density K = A k and has the energy A phi_h(K/A), the
perspective of phi_h, jointly convex in (A, K); k has no pressure of its own:

    dk/dt + (v . grad) k = sqrt(2/3) |Pi|,    sigma_Y(k) = sigma_Y + A phi_h'(k).

M and sigma_Y are per actual area.  Of the power M : Pi the part A phi_h'(k) dk/dt is stored.  At the yield
stress the rest, which is dissipated, is sqrt(2/3) sigma_Y |Pi| with the yield stress of the virgin material,
whatever k.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CF

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.parameters import Modulus, require_fields, value_at
from ngvisco.physics.tensors import Tensor, exp, is_even, power_of_square, square, tr
from ngvisco.physics.variables import Values, Variable

TINY_STRESS = 1e-100
"""|M|, Pa, below which powers of it are smoothed at zero, where they have no derivative."""

SMALL_STRAIN = 1e-2
"""Elastic shear strain at which a rule is asked for its relaxation time."""


@dataclass(frozen=True)
class PlasticContent(Variable):
    """K = A k >= 0, carried by its flux: k is the length of the path of plastic strains, uniaxial.

    dK/dt + div(K v) = A dk/dt, A = 1/J; of body i that is n_i k with the amount n_i of the body.
    """

    name: str = "plastic_content"
    kind: str = "scalar"

    by_flux = True

    @classmethod
    def of(cls, body: str) -> PlasticContent:
        """The plastic content of the body of this name."""
        return cls(f"plastic_content_{body}")

    @property
    def strain(self) -> str:
        """The name of the field k."""
        return self.name.replace("content", "strain", 1)

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        """The rate by the content's flux alone: the growth by yield is not linear in Pi, and is a part of a
        term."""
        return -tr(L) * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        """Zero: whatever was before a start is in its yield stress."""
        return CF(0.0)


PLASTIC_CONTENT = PlasticContent()


@dataclass(frozen=True, kw_only=True)
class Hardening:
    """phi_h(k) = H k^2/2 + Q (k + (exp(-b k) - 1)/b): linear, and that of Voce (1948) which saturates.

    phi_h is an energy per reference volume, Pa, convex in k.  H and Q, Pa, may be expressions of parameters.
    """

    H: Modulus
    Q: Modulus
    b: float

    def energy(self, amount: Tensor, content: Tensor, z: Values) -> Tensor:
        """A phi_h(K/A), Pa per actual volume, of the amount A and the content K; ``z`` has the parameters."""
        k = content / amount
        phi = (0.5 * value_at(self.H, z)) * (k * k)
        if self.Q != 0:
            phi = phi + value_at(self.Q, z) * (k + (1 / self.b) * (exp(-self.b * k) - 1))
        return amount * phi


class FlowRule(ABC):
    """A law of a material's creep rate Pi; derived classes are frozen dataclasses that give ``rate``.

    A rule with a gradient term declares ``nu`` and gives ``psi`` as well; ``Model`` refuses a rule whose
    power M : Pi is negative, whose Pi is not symmetric and trace-free, or whose psi' is not the inverse of
    ``rate``, by samples.  Raises ParameterError for a parameter outside the range of its annotation.
    """

    nu: float = 0.0
    """Coefficient of the gradient term, such that nu |grad Pi|^q is W/m^3; 0 is a local rule."""
    q: float = 4.0
    """Its exponent, > 1."""
    floor: float = 1e-10
    """Regularisation of |grad Pi| at zero for exponents that are no even integers, 1/(m s), > 0."""
    rate_floor: float = 1e-9
    """|Pi| below which ``psi`` is smoothed at zero where it is no even power, 1/s, > 0."""
    reads_conjugate: bool = False
    """Whether ``rate`` reads zeta: the material then needs a conformation tensor, and the rule is local."""
    reads: frozenset[str] = frozenset()
    """Which of ``PRESSURE``, ``TEMPERATURE``, ``HARDENING``, ``CONFORMATION`` of ``variables`` it reads."""
    has_trace: bool = False
    """Whether tr Pi is not zero: the determinant of B is then not that of a distortion."""
    degree: float = math.inf
    """The power of |M| that the rate grows as, 1 of a linear rule; infinite of one that grows otherwise."""

    def __post_init__(self) -> None:
        require_fields(self)

    @abstractmethod
    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        """Pi, 3x3, 1/s, of the Mandel stress M, 3x3, Pa, at a point with the values ``z``.

        ``zeta`` is the conjugate of the conformation tensor, 3x3, Pa; None where the material has none.
        """

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential of Pi, 3x3, W/m^3, whose derivative by Pi is M; convex, where nu > 0.

        Raises ParameterError for a rule that does not give it.
        """
        raise ParameterError(f"{type(self).__name__}.nu", self.nu, "0: the rule gives no potential psi(Pi)")

    def force(self, Pi: Tensor, z: Values) -> Tensor:
        """psi'(Pi), 3x3, Pa."""
        if isinstance(Pi, Array):
            variable = Array(Pi.value)
            return Array(derivatives(self.psi(variable, z), [variable])[0], None)
        variable = Pi.MakeVariable()
        return self.psi(variable, z).Diff(variable)

    @property
    def flows(self) -> bool:
        """Whether Pi is not zero always."""
        return True

    @property
    def is_local(self) -> bool:
        """Whether Pi is a function of the values at a point, without a field of its own."""
        return self.nu == 0 or not self.flows

    @property
    def hardening(self) -> Hardening | None:
        """The energy that a rule that reads ``HARDENING`` stores of its power; None for other rules."""
        return None

    def hardening_rate(self, Pi: Tensor) -> Tensor:
        """dk/dt of its hardening, 1/s: of a local rule by |Pi|, else smoothed as ``psi`` is."""
        size, floor = square(Pi), TINY_STRESS if self.is_local else self.rate_floor
        return math.sqrt(2 / 3) * (size * power_of_square(size, -0.5, floor))

    def gradient_coefficient(self, s: Tensor) -> Tensor:
        """nu s^{(q-2)/2} for s = |grad Pi|^2."""
        return self.nu * power_of_square(s, 0.5 * (self.q - 2), self.floor)

    def overstress(self, rate: float, z: Values) -> float:
        """The excess of |M| over the yield stress at |Pi| = ``rate``, 1/s, over the yield stress; 0 for a
        rule without one.

        ``z`` are arrays of one point; a strength by pressure counts as that without any.
        """
        return 0.0

    def relaxation_time(self, shear: float, z: Values) -> float:
        """Elastic strain over its rate, s, in shear by ``SMALL_STRAIN``; ``inf`` where it does not flow.

        ``shear`` is the modulus G of shear, Pa; ``z`` are arrays of one point.
        """
        strain = np.zeros((3, 3, 1))
        strain[0, 1] = strain[1, 0] = SMALL_STRAIN
        M = Array(2 * shear * strain, None)
        fastest = float(np.linalg.norm(self.rate(M, 0.5 * M, z).value.real))
        return float(np.linalg.norm(strain)) / fastest if fastest > 0 else math.inf


@dataclass(frozen=True, kw_only=True)
class GradientRule(FlowRule):
    """A rule that may have a gradient term: it gives ``psi``.

    Parameters
    ----------
    nu : float
        Gradient of the creep rate: nu |grad Pi|^q is its dissipation.
    q : float
        Exponent of the creep rate's gradient; the paper's analysis has q > 3.
    """

    nu: Annotated[float, Quantity("W/m^3 (m s)^q", ">= 0", 1e-4)] = 0.0
    q: Annotated[float, Quantity("1", "> 1")] = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, self.nu > 0, "with nu = 0", "q", "floor", "rate_floor")
        require_effect(self, not is_even(self.q), "with q an even integer", "floor")

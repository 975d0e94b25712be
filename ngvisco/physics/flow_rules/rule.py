"""Flow rules: the creep rate Pi as a function of its driving stress, and hardening.

A rule is local, Pi = rate(M, zeta, z) at every point, or has a gradient term,

    psi'(Pi) - div(nu |grad Pi|^{q-2} grad Pi) = M,   (n . grad) Pi = 0 on walls   (paper: ED-Euler-large3)

with the potential psi(Pi) whose derivative is the inverse of M -> rate(M).  A rule defines rate and psi with
the operations of ``ngvisco.physics.tensors``, for coefficient functions and arrays alike.  A rule does not
define the derivatives of rate and psi.

If a rule hardens, its yield stress grows with the accumulated plastic strain k, which the matter carries.
The stored part of the work of yield is an energy phi_h(k) per reference volume, in addition to the elastic
energy. Per actual volume, with A = 1/J, the matter carries the density K = A k and has the energy A
phi_h(K/A). This is the perspective of phi_h, and jointly convex in (A, K); k causes no pressure:

    dk/dt + (v . grad) k = sqrt(2/3) |Pi|,    sigma_Y(k) = sigma_Y + A phi_h'(k).

M and sigma_Y are per actual area.  The part A phi_h'(k) dk/dt of the power M : Pi is stored, and the rest is
dissipated.  At the yield stress the dissipation is sqrt(2/3) sigma_Y |Pi| for every k, where sigma_Y is the
yield stress of the virgin material.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.arrays import Array, derivatives
from ngvisco.physics.parameters import Checked, Modulus, value_at
from ngvisco.physics.tensors import Tensor, exp, is_even, power_of_square, square
from ngvisco.physics.variables import PerVolume, Values

TINY_STRESS = 1e-100
"""Powers of |M| are smoothed below this |M|, Pa, because they have no derivative at zero."""

SMALL_STRAIN = 1e-2
"""Elastic shear strain at which the relaxation time of a rule is evaluated."""


@dataclass(frozen=True)
class PlasticContent(PerVolume):
    """K = A k >= 0, transported by its flux; k is the accumulated plastic strain, in uniaxial measure.

    dK/dt + div(K v) = A dk/dt with A = 1/J; for body i the amount n_i replaces A.  ``rate`` is the rate
    without growth, which the flux gives.  A term adds the growth by yield, because the growth is not linear
    in Pi.  The initial yield stress contains hardening before the start.
    """

    name: str = "plastic_content"

    by_flux = True

    @classmethod
    def of(cls, body: str) -> PlasticContent:
        """The plastic content of the body of this name."""
        return cls(f"plastic_content_{body}")

    @property
    def strain(self) -> str:
        """The name of the field k."""
        return self.name.replace("content", "strain", 1)


PLASTIC_CONTENT = PlasticContent()


@dataclass(frozen=True, kw_only=True)
class Hardening:
    """phi_h(k) = H k^2/2 + Q (k + (exp(-b k) - 1)/b): linear hardening and Voce's (1948), which saturates.

    phi_h is an energy per reference volume, Pa, convex in k.  H and Q, Pa, may be expressions of parameters.
    """

    H: Modulus
    Q: Modulus
    b: float

    def energy(self, amount: Tensor, content: Tensor, z: Values) -> Tensor:
        """The energy A phi_h(K/A), Pa, for A = ``amount``, K = ``content`` and the parameters in ``z``."""
        k = content / amount
        phi = (0.5 * value_at(self.H, z)) * (k * k)
        if self.Q != 0:
            phi = phi + value_at(self.Q, z) * (k + (1 / self.b) * (exp(-self.b * k) - 1))
        return amount * phi


class FlowRule(Checked, ABC):
    """A law of a material's creep rate Pi; derived classes are frozen dataclasses that give ``rate``.

    A rule with a gradient term declares ``nu`` and gives ``psi`` as well.  ``Model`` samples a rule and
    refuses it if its power M : Pi is negative, its Pi is not symmetric and trace-free, or its psi' is not the
    inverse of ``rate``.  Raises ParameterError for a parameter outside the range of its annotation.
    """

    nu: float = 0.0
    """Coefficient of the gradient term, such that nu |grad Pi|^q is W/m^3; 0 is a local rule."""
    q: float = 4.0
    """Exponent of the gradient term, > 1."""
    floor: float = 1e-10
    """Size of |grad Pi|, 1/(m s), > 0, below which powers other than even integers are smoothed."""
    rate_floor: float = 1e-9
    """Size of |Pi|, 1/s, > 0, below which a ``psi`` without an even power is smoothed."""
    reads_conjugate: bool = False
    """Whether ``rate`` reads zeta; the material then needs a conformation tensor, and the rule is local."""
    reads: frozenset[str] = frozenset()
    """Names among ``PRESSURE``, ``TEMPERATURE``, ``HARDENING`` and ``CONFORMATION`` that ``rate`` reads."""
    has_trace: bool = False
    """Whether tr Pi may differ from zero; J then does not determine det B."""
    degree: float = math.inf
    """Power of |M| with which the rate grows: 1 for a linear rule, infinite for a rate that is no power."""

    @abstractmethod
    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        """The creep rate Pi, 3x3, 1/s, for the Mandel stress M, 3x3, Pa, at a point with the values ``z``.

        ``zeta`` is the conjugate of the conformation tensor, 3x3, Pa; None for a material without one.
        """

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """The potential psi(Pi), W/m^3, for Pi, 3x3, with the derivative M; convex, and needed if nu > 0.

        Raises ParameterError for a rule without a potential.
        """
        expected = "0, since the rule gives no potential psi(Pi)"
        raise ParameterError(f"{type(self).__name__}.nu", self.nu, expected)

    def force(self, Pi: Tensor, z: Values) -> Tensor:
        """The derivative psi'(Pi), 3x3, Pa."""
        if isinstance(Pi, Array):
            variable = Array(Pi.value)
            return Array(derivatives(self.psi(variable, z), [variable])[0], None)
        variable = Pi.MakeVariable()
        return self.psi(variable, z).Diff(variable)

    @property
    def flows(self) -> bool:
        """Whether Pi can differ from zero."""
        return True

    @property
    def is_linear(self) -> bool:
        """Whether Pi is linear in M and zeta, with constant coefficients, and ``rate`` reads nothing else."""
        return False

    @property
    def is_local(self) -> bool:
        """Whether Pi is a function of the values at a point, so that it needs no field."""
        return self.nu == 0 or not self.flows

    @property
    def hardening(self) -> Hardening | None:
        """The stored energy of hardening, for a rule that reads ``HARDENING``; None for other rules."""
        return None

    def hardening_rate(self, Pi: Tensor) -> Tensor:
        """The rate dk/dt, 1/s, from |Pi|. For a rule with a gradient term |Pi| is smoothed as in ``psi``."""
        size, floor = square(Pi), TINY_STRESS if self.is_local else self.rate_floor
        return math.sqrt(2 / 3) * (size * power_of_square(size, -0.5, floor))

    def gradient_coefficient(self, s: Tensor) -> Tensor:
        """The coefficient nu s^{(q-2)/2} for s = |grad Pi|^2."""
        return self.nu * power_of_square(s, 0.5 * (self.q - 2), self.floor)

    def overstress(self, rate: float, z: Values) -> float:
        """The ratio of the overstress at |Pi| = ``rate``, 1/s, to the yield stress; 0 for a rule without a
        yield stress.

        ``z`` are arrays of one point; a strength that depends on pressure is evaluated at p = 0.
        """
        return 0.0

    def relaxation_time(self, shear: float, z: Values) -> float:
        """An elastic shear strain, ``SMALL_STRAIN``, divided by the creep rate that its stress causes, s;
        ``inf`` without creep.

        ``shear`` is the shear modulus G, Pa; ``z`` are arrays of one point.
        """
        strain = np.zeros((3, 3, 1))
        strain[0, 1] = strain[1, 0] = SMALL_STRAIN
        M = Array(2 * shear * strain, None)
        fastest = float(np.linalg.norm(self.rate(M, 0.5 * M, z).value.real))
        return float(np.linalg.norm(strain)) / fastest if fastest > 0 else math.inf


@dataclass(frozen=True, kw_only=True)
class GradientRule(FlowRule):
    """A rule with a ``psi``, which may have a gradient term.

    Parameters
    ----------
    nu : float
        Coefficient of the creep rate's gradient, which dissipates nu |grad Pi|^q.
    q : float
        Exponent of the creep rate's gradient; the paper's analysis has q > 3.
    """

    nu: Annotated[float, Quantity("W/m^3 (m s)^q", ">= 0", 1e-4)] = 0.0
    q: Annotated[float, Quantity("1", "> 1")] = 4.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, self.nu > 0, "with nu = 0", "q", "floor", "rate_floor")
        require_effect(self, not is_even(self.q), "with q an even integer", "floor")

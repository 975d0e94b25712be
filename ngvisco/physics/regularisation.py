"""The regularisations of the paper's discrete scheme, each off by default.

(paper: Euler-small-viscoelastodyn+disc, Euler-large-viscoelastodyn+disc.)  Those that change the stored
energy are materials of their own: ``WithQuadratic`` and ``Yosida`` wrap any material, also one another, and
the linear continuation of a singular part is the parameter ``J_min`` of the materials that have one.
Gravity is averaged over the step in every run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import ParameterError, require_above, require_nonnegative, require_positive
from ngvisco.physics.tensors import Scalar, if_positive, power_of_square


@dataclass(frozen=True, kw_only=True)
class Regularisation:
    """delta-, epsilon- and cut-off terms of the scheme.

    Parameters
    ----------
    delta_density : float
        delta in div(delta |grad rho|^{r-2} grad rho) of the continuity equation, with its compensating
        term in the momentum equation; >= 0, in (m^2/s)(kg/m^4)^{2-r}.  It moves mass without power: no
        energy enters or leaves by it.
    r : float
        Its exponent, > 1; the paper's analysis wants r > 3.  Default 4.
    delta_fields : float
        delta in the Laplacian of all transported variables, m^2/s, >= 0.  The ledger has its power under
        ``dissipation_delta_fields``, >= 0 for every convex energy.  phi'' at rest has to be positive definite
        in the variables that the energy is not linear in; ``WithQuadratic`` makes it so.
    epsilon : float
        Coefficient of epsilon |v|^{p-2} v in the momentum equation, such that epsilon |v|^p is W/m^3; >= 0.
    p : float
        Its exponent, > 1.  Default 4; the paper takes that of the hyperviscosity.
    rho_max : float, optional
        Density above which the cut-off acts, kg/m^3, > 0; None (default) is no cut-off.  A density that
        starts at most at rho_max + width stays so: with m = 0 by the scheme, with m > 0 by the limiter.
    width : float
        The cut-off falls from 1 at rho_max to 0 at rho_max + width, kg/m^3, > 0; the paper has 1.
    penalty : float
        Dimensionless weight of the interior penalty of the two diffusions, > 0.
    gradient_floor : float
        |grad rho| (kg/m^4) below which the penalty of the r-Laplacian stops following it, > 0.
    floor : float
        Regularisation of |v| and |grad rho| at zero for exponents that are no even integers, > 0.

    Raises
    ------
    ParameterError
        If a parameter is out of its range.
    """

    delta_density: float = 0.0
    r: float = 4.0
    delta_fields: float = 0.0
    epsilon: float = 0.0
    p: float = 4.0
    rho_max: float | None = None
    width: float = 1.0
    penalty: float = 4.0
    gradient_floor: float = 1e-3
    floor: float = 1e-10

    def __post_init__(self) -> None:
        require_nonnegative(
            self, delta_density=self.delta_density, delta_fields=self.delta_fields, epsilon=self.epsilon
        )
        require_above(self, 1, r=self.r, p=self.p)
        require_positive(
            self,
            width=self.width,
            penalty=self.penalty,
            gradient_floor=self.gradient_floor,
            floor=self.floor,
        )
        if self.rho_max is not None:
            require_positive(self, rho_max=self.rho_max)

    def require_gradients(self, name: str, m: int) -> None:
        """Raise ParameterError for a diffusion, ``name``, of fields of order m = 0."""
        if m == 0:
            raise ParameterError(
                f"Regularisation.{name}", getattr(self, name), "0 with m = 0, which has no gradients"
            )

    def penalty_weight(self, m: int) -> float:
        """s = penalty (m + 1)^2, for polynomials of degree m."""
        return self.penalty * (m + 1) ** 2

    def diffusivity(self, gradient_square: Scalar) -> Scalar:
        """delta |grad rho|^{r-2}, m^2/s, of |grad rho|^2."""
        return self.delta_density * power_of_square(gradient_square, 0.5 * (self.r - 2), self.floor)

    def friction(self, speed_square: CoefficientFunction) -> CoefficientFunction:
        """epsilon |v|^{p-2} of |v|^2."""
        return self.epsilon * power_of_square(speed_square, 0.5 * (self.p - 2), self.floor)

    def cut_off(self, rho: CoefficientFunction) -> CoefficientFunction:
        """The cut-off K(rho) (paper: cut-off).

        1 on [0, rho_max], 0 below 0 and above rho_max + width, and 1 - 3 s^2 + 2 s^3 with
        s = (rho - rho_max)/width between: C1 but for the jump at 0, where K(rho) rho is Lipschitz.
        """
        if self.rho_max is None:
            return CF(1.0)
        s = (rho - self.rho_max) * (1 / self.width)
        smooth = 1 - s * s * (3 - 2 * s)
        return if_positive(rho, if_positive(s, if_positive(1 - s, smooth, 0.0), 1.0), 0.0)

    @property
    def densest_flow(self) -> float:
        """The density at which K(rho) rho is largest, kg/m^3; infinite without a cut-off."""
        if self.rho_max is None:
            return math.inf
        c = 6 * self.rho_max / self.width
        return self.rho_max + self.width * (1 - c + math.sqrt((c - 1) ** 2 + 32)) / 16

    def carried(self, rho: CoefficientFunction) -> CoefficientFunction:
        """K(rho) rho, what the velocity carries; rho itself without a cut-off."""
        return rho if self.rho_max is None else self.cut_off(rho) * rho

    def rising(self, rho: CoefficientFunction) -> CoefficientFunction:
        """The non-decreasing part of K(rho) rho: that of min(rho, ``densest_flow``)."""
        return if_positive(self.densest_flow - rho, self.carried(rho), self.carried(CF(self.densest_flow)))

    def falling(self, rho: CoefficientFunction) -> CoefficientFunction:
        """The non-increasing part: K(rho) rho is ``rising`` + ``falling``."""
        return self.carried(rho) - self.rising(rho)

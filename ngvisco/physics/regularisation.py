"""The regularisations of the paper's discrete scheme, each off by default.

(paper: Euler-small-viscoelastodyn+disc, Euler-large-viscoelastodyn+disc.)  Regularisations of the stored
energy are materials: ``WithQuadratic`` and ``Yosida`` wrap any material, also one another, and the parameter
``J_min`` continues the singular part of an energy linearly.

The diffusion of the fields needs phi''(z) at rest, and the directions in which phi'' vanishes.  Some energies
are linear in some variables: energies with -epsilon ln J in K = ln J / J, and many energies in B = F F^T. The
conjugates of these variables are constant.  In all other variables phi'' has to be positive definite;
``WithQuadratic`` makes it so for every convex energy.  phi'' is the second derivative by the strains, not by
parameters.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CF

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.energy_checks import StateSampling
from ngvisco.physics.material import Material
from ngvisco.physics.parameters import Checked
from ngvisco.physics.pointwise import respond, rest_state
from ngvisco.physics.tensors import Scalar, Tensor, if_positive, is_even, power_of_square


@dataclass(frozen=True, kw_only=True)
class Regularisation(Checked):
    """The paper's regularising terms: diffusions by delta, friction by epsilon, and the cut-off.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    delta_density : float
        Diffusion of the density by the r-Laplacian, div(delta |grad rho|^{r-2} grad rho), with its
        compensating term in the momentum equation.  The diffusion moves mass without power.
    r : float
        Exponent of the r-Laplacian; the paper's analysis has r > 3.
    delta_fields : float
        Diffusion of all transported variables.  phi'' at rest has to be positive definite in all variables
        in which the energy is not linear; ``WithQuadratic`` makes phi'' positive definite.
    epsilon : float
        Friction epsilon |v|^{p-2} v in the momentum equation.
    p : float
        Exponent of the friction; the paper takes the exponent of the hyperviscosity.
    rho_max : float, optional
        Density above which the paper's cut-off acts; by default there is no cut-off.  A density that starts
        at or below rho_max + width stays there: for m = 0 by the scheme, for m > 0 by the limiter.
    width : float
        Width of density over which the cut-off falls from 1 to 0; the paper has 1.
    penalty : float
        Weight of the diffusions' interior penalty.
    gradient_floor : float
        |grad rho| below which the penalty of the r-Laplacian is constant.
    floor : float
        |v| and |grad rho|, in SI units, below which powers other than even integers are smoothed.
    """

    delta_density: Annotated[float, Quantity("m^2/s (kg/m^4)^(2-r)", ">= 0", 1e-6)] = 0.0
    r: Annotated[float, Quantity("1", "> 1")] = 4.0
    delta_fields: Annotated[float, Quantity("m^2/s", ">= 0", 1e-6)] = 0.0
    epsilon: Annotated[float, Quantity("W/m^3 (s/m)^p", ">= 0", 1e-3)] = 0.0
    p: Annotated[float, Quantity("1", "> 1")] = 4.0
    rho_max: Annotated[float | None, Quantity("kg/m^3", "> 0", 10.0)] = None
    width: Annotated[float, Quantity("kg/m^3", "> 0")] = 1.0
    penalty: Annotated[float, Quantity("1", "> 0")] = 4.0
    gradient_floor: Annotated[float, Quantity("kg/m^4", "> 0")] = 1e-3
    floor: Annotated[float, Quantity("1", "> 0")] = 1e-10

    def __post_init__(self) -> None:
        super().__post_init__()
        diffuses, rubs = self.delta_density > 0, self.epsilon > 0
        require_effect(self, diffuses, "with delta_density = 0", "r", "gradient_floor")
        require_effect(self, rubs, "with epsilon = 0", "p")
        require_effect(self, self.rho_max is not None, "without rho_max", "width")
        require_effect(self, diffuses or self.delta_fields > 0, "without a diffusion", "penalty")
        smooths = (diffuses and not is_even(self.r)) or (rubs and not is_even(self.p))
        require_effect(self, smooths, "where all powers are even integers", "floor")

    @property
    def bends_the_flux(self) -> bool:
        """Whether the flux of mass differs from rho v, by the cut-off or by diffusion of the density."""
        return self.rho_max is not None or self.delta_density > 0

    def require_gradients(self, name: str, m: int) -> None:
        """Raise ParameterError, with the diffusion's ``name``, for fields of order m = 0."""
        if m == 0:
            expected = "0 with m = 0, since constants in cells have no gradient"
            raise ParameterError(f"Regularisation.{name}", getattr(self, name), expected)

    def penalty_weight(self, m: int) -> float:
        """The penalty's weight s = penalty (m + 1)^2 for polynomials of degree m."""
        return self.penalty * (m + 1) ** 2

    def diffusivity(self, gradient_square: Scalar) -> Scalar:
        """The diffusivity delta |grad rho|^{r-2}, m^2/s, from |grad rho|^2."""
        return self.delta_density * power_of_square(gradient_square, 0.5 * (self.r - 2), self.floor)

    def friction(self, speed_square: Tensor) -> Tensor:
        """The friction coefficient epsilon |v|^{p-2}, from |v|^2."""
        return self.epsilon * power_of_square(speed_square, 0.5 * (self.p - 2), self.floor)

    def cut_off(self, rho: Tensor) -> Tensor:
        """The cut-off K(rho) (paper: cut-off).

        K is 1 on [0, rho_max], 0 below 0 and above rho_max + width, and 1 - 3 s^2 + 2 s^3 with s = (rho -
        rho_max)/width between: K is C1 except for the jump at 0, where K(rho) rho is Lipschitz.
        """
        if self.rho_max is None:
            return CF(1.0)
        s = (rho - self.rho_max) * (1 / self.width)
        smooth = 1 - s * s * (3 - 2 * s)
        return if_positive(rho, if_positive(s, if_positive(1 - s, smooth, 0.0), 1.0), 0.0)

    @property
    def densest_flow(self) -> float:
        """The density that maximises K(rho) rho, kg/m^3; infinite without a cut-off."""
        if self.rho_max is None:
            return math.inf
        c = 6 * self.rho_max / self.width
        return self.rho_max + self.width * (1 - c + math.sqrt((c - 1) ** 2 + 32)) / 16

    def carried(self, rho: Tensor) -> Tensor:
        """The density K(rho) rho that the velocity carries; rho itself without a cut-off."""
        return rho if self.rho_max is None else self.cut_off(rho) * rho

    def rising(self, rho: Tensor) -> Tensor:
        """The non-decreasing part of K(rho) rho: K(s) s with s = min(rho, ``densest_flow``)."""
        return if_positive(self.densest_flow - rho, self.carried(rho), self.carried(CF(self.densest_flow)))

    def falling(self, rho: Tensor) -> Tensor:
        """The non-increasing part of K(rho) rho, which is ``rising`` + ``falling``."""
        return self.carried(rho) - self.rising(rho)


_SPREAD = 0.2
"""The spread of the sampled states in the test for linear directions."""

_ZERO = 1e-10
"""Size of an entry of phi'', relative to the largest entry, below which the entry counts as zero."""


@dataclass(frozen=True)
class Curvature:
    """The part of phi'' that does not depend on the state."""

    linear: np.ndarray
    """Orthogonal projection, (N, N), to the directions n in the space of strains with phi''(z) n = 0 for all
    z."""
    strains: np.ndarray
    """Mask of the components of strains, (N,)."""
    compliance: np.ndarray
    """Inverse of phi''(rest) + ``linear`` (in Pa) on the strains, positive definite, (N, N)."""

    @property
    def of_itself(self) -> np.ndarray:
        """Projection to the ``linear`` directions and the parameters, (N, N)."""
        return self.linear + np.diag(np.where(self.strains, 0.0, 1.0))


def curvature_of(material: Material, dim: int) -> Curvature:
    """The curvature of a material's energy on meshes of dimension ``dim``.

    Raises ParameterError if phi'' at rest is not positive definite in the directions other than ``linear``.
    """
    sampling = StateSampling(material, dim, _SPREAD, np.random.default_rng(0))
    fitting, strains = sampling.fitting(), sampling.space.strains
    states = np.concatenate([rest_state(material, dim)[None], fitting, sampling.changed(fitting)])
    response, of_strains = respond(material, dim)(states), np.ix_(strains, strains)
    hessians = response.hessian[:, strains][:, :, strains]
    at_rest = hessians[0]
    hessians = hessians[np.isfinite(hessians).all(axis=(1, 2))]
    sizes = np.abs(hessians).max(axis=(1, 2), keepdims=True)
    scaled = hessians / np.where(sizes > 0, sizes, 1.0)
    # the kernel of the mean is the common kernel if all matrices are positive semidefinite; for other
    # matrices, the next lines check that the kernel is common
    values, vectors = np.linalg.eigh(scaled.mean(axis=0))
    kernel = vectors[:, np.abs(values) <= _ZERO]
    if np.abs(scaled @ kernel).max(initial=0.0) > _ZERO:
        kernel = kernel[:, :0]
    linear = kernel @ kernel.T
    linear[np.abs(linear) < 1e-12] = 0.0
    scale = float(np.abs(at_rest).max())
    least = np.linalg.eigvalsh(at_rest / scale + linear)[0] if scale > 0 and np.isfinite(scale) else 0.0
    if not least > _ZERO:
        raise ParameterError(
            "Regularisation.delta_fields",
            f"a number > 0 for {type(material).__name__}",
            "0, since delta_fields needs a phi'' that is positive definite in all variables in which the "
            f"energy is not linear, but phi'' at rest has the eigenvalue {least * scale:.3g} Pa. To use "
            "delta_fields, wrap a single material in WithQuadratic, or give all bodies the same volumetric "
            "energy",
        )
    inverse = np.linalg.inv(at_rest + linear)
    projection, compliance = np.zeros((2, len(strains), len(strains)))
    projection[of_strains] = linear
    compliance[of_strains] = 0.5 * (inverse + inverse.T)
    return Curvature(projection, strains, compliance)

"""Materials of the linearised convective model (paper: Section 2), in the small strain E."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, Quantity, require_effect
from ngvisco.physics.energy_checks import check_energy, require_isotropy
from ngvisco.physics.material import Material
from ngvisco.physics.parameters import Modulus
from ngvisco.physics.tensors import dev, is_even, power_of_square, sph, square, tr
from ngvisco.physics.variables import SmallStrain, Values, Variable


@dataclass(frozen=True, kw_only=True)
class LinearElastic(Material):
    """phi(E) = 3/2 K_e |sph E|^2 + G_e |dev E|^2 (paper: St.Venenat-Kirchhoff-linear).

    phi is strongly convex, and T(0) = 0.  The moduli are the usual bulk and shear moduli of linear
    elasticity: S = K_e (tr E) I + 2 G_e dev E, and T = S + phi I.  Raises ParameterError if a modulus is not
    a finite positive number.

    Parameters
    ----------
    K_e : float
        Elastic bulk modulus.  The value 0 is for branches of a network only.
    G_e : float
        Elastic shear modulus.
    """

    K_e: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    G_e: Annotated[Modulus, Quantity("Pa", "> 0", 5.0)]

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (SmallStrain(),)

    def energy(self, z: Values) -> CoefficientFunction:
        E = z["E"]
        return 1.5 * self.K_e * square(sph(E)) + self.G_e * square(dev(E))


@dataclass(frozen=True, kw_only=True)
class IsotropicStrainEnergy(Material):
    """phi(E) = strain_energy(E) for any convex isotropic function of E (paper: Euler-small-ass-phi).

    Isotropy is needed besides convexity: because S E = E S, the spin part of the Zaremba-Jaumann rate has no
    power (paper: E:WS=E:SW), and T = S + phi I is symmetric.  Raises ParameterError if the energy is not a
    real function of E alone, or not isotropic; the message then has a rotation that shows it.

    Parameters
    ----------
    strain_energy : callable
        Function of E (3x3 coefficient function) with the energy density, Pa, as value, e.g. ``lambda E:
        0.5*K*Trace(E)**2 + G*square(dev(E)) + c*square(dev(E))**2``.
    """

    energy_parameter = "strain_energy"

    strain_energy: Callable[[CoefficientFunction], CoefficientFunction]

    def __post_init__(self) -> None:
        if not callable(self.strain_energy):
            raise ParameterError("IsotropicStrainEnergy.strain_energy", self.strain_energy, "a function of E")
        check_energy(self)
        require_isotropy(self)

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (SmallStrain(),)

    def energy(self, z: Values) -> CoefficientFunction:
        return self.strain_energy(z["E"])


@dataclass(frozen=True, kw_only=True)
class HardeningElastic(LinearElastic):
    """phi(E) = 3/2 K_e |sph E|^2 + G_e |dev E|^2 + K_h/s |tr E|^s + 2 G_h/s |dev E|^s, s > 2.

    The paper's analysis of large strains admits this energy of St Venant-Kirchhoff type, because it grows
    faster than quadratically (paper: rem-general-phi).  The energy is strongly convex and isotropic.  T(0) =
    0. At small strains K_e and G_e are the usual bulk and shear moduli; the tangent moduli grow like
    |E|^{s-2}.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_e : float
        Elastic bulk modulus at zero strain.
    G_e : float
        Elastic shear modulus at zero strain.
    K_h : float
        Bulk hardening modulus.
    G_h : float
        Shear hardening modulus.
    s : float
        Exponent of the hardening.
    floor : float
        Strain below which |E|^s is smoothed if s is not an even integer.
    """

    K_h: Annotated[Modulus, Quantity("Pa", ">= 0", 10.0)]
    G_h: Annotated[Modulus, Quantity("Pa", ">= 0", 5.0)]
    s: Annotated[float, Quantity("1", "> 2")] = 4.0
    floor: Annotated[float, Quantity("1", "> 0")] = 1e-8

    def __post_init__(self) -> None:
        super().__post_init__()
        require_effect(self, not is_even(self.s + 2), "with s an even integer", "floor")

    def energy(self, z: Values) -> CoefficientFunction:
        E, half = z["E"], 0.5 * self.s
        bulk = self.K_h / self.s * power_of_square(tr(E) * tr(E), half, self.floor)
        shear = 2 * self.G_h / self.s * power_of_square(square(dev(E)), half, self.floor)
        return super().energy(z) + bulk + shear

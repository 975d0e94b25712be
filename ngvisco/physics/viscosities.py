"""Viscosities that change with the strain rate: generalised Newtonian fluids.

Each is G_v(s) of the squared shear rate s = 2 |dev eps|^2 (``IsotropicViscosity``), with G_v(s) sqrt(s)
rising, so that its potential is convex (paper: dissipation-pot).  Derivatives are never written.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from ngvisco.errors import Quantity
from ngvisco.physics.parameters import Modulus, value_at
from ngvisco.physics.rheology import IsotropicViscosity, ValueOfModulus
from ngvisco.physics.tensors import power_of_square
from ngvisco.physics.variables import Values


@dataclass(frozen=True, kw_only=True)
class PowerLaw(IsotropicViscosity):
    """G_v = consistency (s + floor^2)^{(n-1)/2}: the law of Ostwald and de Waele, 1925.

    Thinning for n < 1, thickening for n > 1.  Below the shear rate ``floor`` the viscosity does not grow any
    more: it is consistency floor^{n-1} at rest.  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_v : float
        Bulk viscosity.
    consistency : float
        Shear stress at a shear rate of 1/s.
    n : float
        Exponent of the shear rate in the shear stress.
    floor : float
        Shear rate below which the fluid is Newtonian.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    consistency: Annotated[Modulus, Quantity("Pa s^n", "> 0", 0.01)]
    n: Annotated[float, Quantity("1", "in (0, 5]", 0.5)]
    floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-3

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        thinning = (self.floor**2 + s) ** (0.5 * (float(self.n) - 1))
        return value_at(self.K_v, z), value_at(self.consistency, z) * thinning


@dataclass(frozen=True, kw_only=True)
class Carreau(IsotropicViscosity):
    """G_v = G_inf + (G_0 - G_inf) (1 + relaxation^2 s)^{(n-1)/2} (Carreau 1972).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_v : float
        Bulk viscosity.
    G_0 : float
        Shear viscosity at rest.
    G_inf : float
        Shear viscosity at large shear rates; for n > 1 it is passed.
    relaxation : float
        Time whose inverse is the shear rate at which the viscosity begins to change.
    n : float
        Exponent of the power law in between.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    G_0: Annotated[Modulus, Quantity("Pa s", "> 0", 1.0)]
    relaxation: Annotated[float, Quantity("s", "> 0", 1.0)]
    n: Annotated[float, Quantity("1", "in (0, 5]", 0.5)]
    G_inf: Annotated[Modulus, Quantity("Pa s", ">= 0")] = 0.0

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        power = (1.0 + self.relaxation**2 * s) ** (0.5 * (float(self.n) - 1))
        least = value_at(self.G_inf, z)
        return value_at(self.K_v, z), least + (value_at(self.G_0, z) - least) * power


@dataclass(frozen=True, kw_only=True)
class Cross(IsotropicViscosity):
    """G_v = G_inf + (G_0 - G_inf)/(1 + (relaxation sqrt(s))^m) (Cross 1965).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    K_v : float
        Bulk viscosity.
    G_0 : float
        Shear viscosity at rest.
    G_inf : float
        Shear viscosity at large shear rates.
    relaxation : float
        Time whose inverse is the shear rate at which the viscosity is in the middle of both.
    m : float
        How steep it falls; above 1 the shear stress would fall with the shear rate.
    floor : float
        Shear rate below which powers of it are smoothed.
    """

    K_v: Annotated[Modulus, Quantity("Pa s", ">= 0", 0.01)]
    G_0: Annotated[Modulus, Quantity("Pa s", "> 0", 1.0)]
    relaxation: Annotated[float, Quantity("s", "> 0", 1.0)]
    m: Annotated[float, Quantity("1", "in (0, 1]", 0.8)]
    G_inf: Annotated[Modulus, Quantity("Pa s", ">= 0")] = 0.0
    floor: Annotated[float, Quantity("1/s", "> 0")] = 1e-9

    def moduli(self, s: Any, z: Values) -> tuple[ValueOfModulus, ValueOfModulus]:
        x = self.relaxation ** float(self.m) * power_of_square(s, 0.5 * self.m, self.floor)
        least = value_at(self.G_inf, z)
        return value_at(self.K_v, z), least + (value_at(self.G_0, z) - least) / (1.0 + x)

"""Materials with heat, whose variables include the entropy and whose energy is the internal energy.

The entropy s per actual volume is conserved up to its production, ds/dt = -(tr L) s + ..., so that it is
transported like A = 1/J.  Its conjugate is the temperature, theta = d phi/d s.  With S = s/A per reference
volume and a heat capacity c at constant volume

    phi = phi_m + A c theta_R (exp(S/c - g) - 1) [+ A c theta_R g],    theta = theta_R exp(S/c - g) > 0,

where phi_m is the energy without heat, and g is Gamma (J - 1) with the term in brackets (``expansion``), or
Gamma ln J without it (``gruneisen``).  Both added energies are perspectives of convex functions of (S, J), so
that phi is jointly convex if phi_m is.

In a material that breaks, ``Thermal(material=Damaged(part="all"))``, damage degrades the thermal stress too.
With the degradation g(d), the degraded energy a, T = theta_R exp(S/c) and the bulk modulus K at rest

    phi = g (a + A h + A e) + A (c (T - theta_R) - e) + ...,
    h = c T (exp(-g_J) - 1) + c theta_R g_J,   g_J = Gamma (J - 1),
    e = (Gamma c)^2 (T - theta_R)^2/(2 (K + Gamma^2 c T)),

which is the energy above for d = 0, and a function of S alone for d = 1: a broken body has no thermal stress.
e is the elastic energy of a body that is clamped at J = 1 and heated.  The energy a + A h + A e drives
damage. In a freely expanding body it is zero, to second order in the thermal strain; in all other bodies it
is positive.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Self

import numpy as np
from ngsolve import CF, Id

from ngvisco.errors import ParameterError, Quantity
from ngvisco.physics.material import ElasticState, Material, conjugates_along, rest_stress_and_modulus
from ngvisco.physics.parameters import Modulus, substituted
from ngvisco.physics.signals import sampled
from ngvisco.physics.tensors import Tensor, exp, expm1, log
from ngvisco.physics.variables import PerVolume, ReciprocalJacobian, Values, Variable
from ngvisco.words import Words, call


@dataclass(frozen=True)
class Entropy(PerVolume):
    """The entropy per actual volume, counted in ``unit``, a heat capacity, J/(m^3 K): ds/dt = -(tr L) s.

    The conjugate of the entropy is ``unit`` theta, Pa.  ``Initial.temperature`` gives the initial entropy.
    """

    name: str = "s"
    unit: float = 1.0

    is_conserved = True
    own_scale = 1e4
    """Size of s for tolerances, in heat capacities.  A change by 1e-9 of this size is 3 mK at 300 K; rounding
    is 1e-11 of this size.

    If temperatures differ by a hundredth and A = 1, an increment of 1e-10 in every variable changes the
    energy above that at theta_R by 1e-8.
    """


NO_TEMPERATURE = Words(
    None,
    " for a material without a temperature; ",
    call("Thermal", material=...),
    " gives a material a temperature",
)
"""Remedy in messages about a parameter of heat in a material without an entropy."""


def entropy_in(material: Material) -> Entropy | None:
    """The entropy among a material's variables; None without heat."""
    return next((v for v in material.variables if isinstance(v, Entropy)), None)


@dataclass(frozen=True, kw_only=True)
class Thermal(Material):
    """A material with a temperature: phi(z, s) is its internal energy, and theta = d phi/d s.

    With ``expansion`` the thermal pressure is Gamma c (theta - theta_R) with Gamma c = K ``expansion``. K is
    the (isothermal) bulk modulus at rest of the material without heat. With ``gruneisen`` the thermal
    pressure is Gamma c theta/J. If there is no other material, ``Thermal`` with ``gruneisen`` is an ideal gas
    with the adiabatic exponent 1 + Gamma. With ``p_infinity`` this gas becomes a stiffened gas, a model of
    liquids, whose pressure is lower by ``p_infinity``. Raises ParameterError if a parameter is out of its
    range, if parameters contradict one another, or if the material has heat already.

    Example::

        import ngvisco as nv

        steel = nv.ReferentialNeoHookean(K_e=160e9, G_e=40e9)
        material = nv.Thermal(material=steel, c=3.6e6, expansion=3.6e-5, theta_R=293.0)
        air = nv.Thermal(c=862.0, gruneisen=0.4, theta_R=293.0, rho_R=1.2)
        water = nv.Thermal(c=1.8e6, gruneisen=1.35, theta_R=293.0, p_infinity=7.1e8, rho_R=1000.0)
        print([variable.name for variable in material.variables], air.pressure(293.0, J=1.0))

    Parameters
    ----------
    material : Material, optional
        The material without heat; A = 1/J is carried too if its variables lack it.  None for a gas, which has
        thermal pressure only.
    c : float
        Heat capacity at constant volume, per referential volume.
    theta_R : float
        Reference temperature, at which the entropy is zero where J = 1.
    expansion : float, optional
        Thermal expansion of volume, three times the linear thermal expansion.
    gruneisen : float, optional
        Grueneisen's parameter Gamma, in place of ``expansion``.
    p_infinity : float
        Stiffening pressure of a gas with the pressure Gamma c theta/J - p_infinity; default 0, an ideal gas.
    rho_R : float, optional
        Density where J = 1, which determines the initial density from J, or J from the density.
    entropy_unit : float, optional
        Unit of the carried entropy; default c.
    """

    material: Material | None = None
    c: Annotated[float, Quantity("J/(m^3 K)", "> 0", 3.6e6)]
    theta_R: Annotated[float, Quantity("K", "> 0", 293.0)]
    expansion: Annotated[float | None, Quantity("1/K", ">= 0", 3.6e-5)] = None
    gruneisen: Annotated[float | None, Quantity("1", ">= 0", 0.4)] = None
    p_infinity: Annotated[float, Quantity("Pa", ">= 0", 7.1e8)] = 0.0
    rho_R: Annotated[Modulus | None, Quantity("kg/m^3", "> 0", 1000.0, "arithmetic")] = None
    entropy_unit: Annotated[float | None, Quantity("J/(m^3 K)", "> 0", 3.6e6)] = None
    _Gamma: float = field(init=False, repr=False, default=0.0)
    """Grueneisen's parameter, which is Gamma in the module's docstring."""

    def __post_init__(self) -> None:
        super().__post_init__()
        material, Gamma = self.material, self.gruneisen or 0.0
        if material is None and self.expansion is not None:
            expected = " without a material, since the pressure of a gas is given by gruneisen > 0"
            raise ParameterError("Thermal.expansion", self.expansion, None, expected)
        if self.expansion is not None and self.gruneisen is not None:
            raise ParameterError("Thermal.gruneisen", self.gruneisen, None, ", since expansion is given")
        if material is None and not self.gruneisen:
            expected = "a number > 0, which gives the pressure of a gas; otherwise give a material"
            raise ParameterError("Thermal.gruneisen", self.gruneisen, expected)
        if material is not None and entropy_in(material) is not None:
            raise ParameterError("Thermal.material", material, "a material without heat")
        if material is not None and material.response(3) is not None:
            expected = (
                "a material whose energy is an expression; put the Yosida approximation around this material"
            )
            raise ParameterError("Thermal.material", material, expected)
        if material is not None and material.lagged and (self.expansion or self.gruneisen):
            self._check_damage(material)
        if material is not None and self.p_infinity:
            expected = "0 with a material, since p_infinity belongs to a stiffened gas"
            raise ParameterError("Thermal.p_infinity", self.p_infinity, expected)
        if self.expansion and material is not None:
            Gamma = self.expansion * rest_stress_and_modulus(material)[1] / self.c
            if not Gamma > 0:
                expected = " for a material whose bulk modulus at rest is not > 0"
                raise ParameterError("Thermal.expansion", self.expansion, None, expected)
        object.__setattr__(self, "_Gamma", Gamma)

    def _check_damage(self, material: Material) -> None:
        """Raise ParameterError for a thermal stress that a broken material would keep."""
        if self.gruneisen:
            expected = (
                " for a material that breaks, since expansion gives the thermal stress of such a material"
            )
            raise ParameterError("Thermal.gruneisen", self.gruneisen, None, expected)
        if getattr(material, "part", None) != "all":
            expected = (
                " for damage of the tensile part, since the thermal stress would stay in a broken body; take "
            )
            remedy = (call("Damaged", part="all"),)
            raise ParameterError("Thermal.expansion", self.expansion, None, expected, *remedy)

    def with_elastic_state(self, state: ElasticState) -> Self:
        if self.material is None:
            return self
        return replace(self, material=self.material.with_elastic_state(state))

    @property
    def entropy(self) -> Entropy:
        """The carried entropy."""
        return Entropy(unit=self.entropy_unit or self.c)

    @property
    def variables(self) -> tuple[Variable, ...]:
        carried = self.isothermal_material.variables
        volume = () if ReciprocalJacobian() in carried else (ReciprocalJacobian(),)
        return (*carried, *volume, self.entropy)

    @property
    def referential_density(self) -> Modulus | None:
        return self.isothermal_material.referential_density if self.rho_R is None else self.rho_R

    @property
    def conformation(self) -> str | None:
        return self.isothermal_material.conformation

    def conformation_of(self, branch: str) -> str | None:
        return self.isothermal_material.conformation_of(branch)

    @property
    def distortions(self) -> dict[str, tuple[str, ...]]:
        return self.isothermal_material.distortions

    @property
    def continued(self) -> frozenset[str]:
        return self.isothermal_material.continued

    @property
    def lagged(self) -> frozenset[str]:
        return self.isothermal_material.lagged

    def domain(self, z: Values) -> Values:
        return self.isothermal_material.domain(
            {v.name: z[v.name] for v in self.isothermal_material.variables}
        )

    def energy(self, z: Values) -> Tensor:
        return self.of_heat(z) + self.isothermal_material.energy(
            {v.name: z[v.name] for v in self.isothermal_material.variables}
        )

    def of_heat(self, z: Values) -> Tensor:
        """The thermal part of the energy, Pa: the energy minus the energy of ``isothermal_material``."""
        A, heat, J = z["A"], self.c * self.theta_R, 1 / z["A"]
        unit = self.entropy.unit / self.c
        if self.coupling and self.isothermal_material.lagged:
            degraded, clamped = self.taken(z)
            damaged: Any = self.isothermal_material
            return heat * A * expm1(unit * z["s"] * J) - clamped + damaged.degradation(z["damage"]) * degraded
        phi = heat * A * expm1(unit * z["s"] * J - self.g(J))
        if self.coupling and not self.is_absolute:
            phi = phi + heat * self._Gamma * (1 - A)
        return phi

    def taken(self, z: Values) -> tuple[Tensor, Tensor]:
        """Two parts of the degraded thermal energy, Pa: A (h + e) and A e, with h and e of the module's
        docstring."""
        A, heat, J = z["A"], self.c * self.theta_R, 1 / z["A"]
        ratio = exp(self.entropy.unit / self.c * z["s"] * J)
        bulk = self.coupling / self.expansion if self.expansion else 1.0
        warm = self.coupling * self.theta_R * (ratio - 1)
        clamped = 0.5 * A * warm * warm / (bulk + self._Gamma * self.coupling * self.theta_R * ratio)
        h = heat * (ratio * expm1(-self.g(J)) + self.g(J))
        return A * h + clamped, clamped

    @property
    def isothermal_material(self) -> Material:
        """The material without heat."""
        return self.material or _Stiffening(self.p_infinity)

    @property
    def is_absolute(self) -> bool:
        """Whether the thermal pressure is c Gamma theta/J, as in a gas, and not c Gamma (theta - theta_R)."""
        return self.gruneisen is not None

    @property
    def coupling(self) -> float:
        """The coupling c Gamma, Pa/K."""
        return self.c * self._Gamma

    def g(self, J: Any) -> Any:
        """The function g(J) of the module's docstring."""
        return self._Gamma * (log(J) if self.is_absolute else J - 1)

    def entropy_of(self, log_theta: Any, J: Any) -> Any:
        """The entropy S, J/(m^3 K), from the logarithm of the temperature in K and J."""
        return self.c * (log_theta - math.log(self.theta_R) + self.g(J))

    def start(self, theta: Any, A: Any) -> Tensor:
        """The carried entropy at a temperature theta, K, and A = 1/J."""
        return 1 / self.entropy.unit * A * self.entropy_of(log(theta), 1 / A)

    def pressure(self, theta: Any, J: Any = 1.0) -> Any:
        """The thermal pressure, Pa, which is the whole pressure of a gas."""
        return self.coupling * (theta / J if self.is_absolute else theta - self.theta_R) - self.p_infinity

    @property
    def stiffness(self) -> float:
        """The thermal bulk modulus -J d pressure/d J at rest, Pa."""
        return self.coupling * self.theta_R if self.is_absolute else 0.0


@dataclass(frozen=True)
class _Stiffening(Material):
    """A stiffened gas without heat, with the energy p_infinity (J - 1) per reference volume."""

    p_infinity: float

    @property
    def variables(self) -> tuple[Variable, ...]:
        return (ReciprocalJacobian(),)

    def energy(self, z: Values) -> Tensor:
        return self.p_infinity * (1 - z["A"])


def temperature(material: Material, zeta: Values) -> Tensor | None:
    """The temperature theta, K, from the conjugates' values; None for a material without heat."""
    entropy = entropy_in(material)
    return None if entropy is None else zeta[entropy.name] / entropy.unit


def warming(material: Material, entropy: Entropy) -> float:
    """The derivative d theta/d s near rest, K, for the parameters' typical values."""
    typical = substituted(material, lambda expression: expression.typical)
    s = CF(1e-6).MakeVariable()  # NGSolve would treat a zero as a constant
    z = {v.name: v.from_distortion(Id(3)) for v in material.variables} | {entropy.name: s}
    slope = conjugates_along(typical.energy(z), {entropy.name: s}, {entropy.name: CF(1.0)})
    return float(np.mean(sampled(slope[entropy.name]))) / entropy.unit

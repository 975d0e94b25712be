"""Flow rules and viscosities that depend on temperature and pressure by the factors of Arrhenius and WLF."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any

from ngvisco.errors import Quantity
from ngvisco.physics.flow_rules.rule import FlowRule, Hardening
from ngvisco.physics.parameters import Checked, Modulus, value_at
from ngvisco.physics.rheology import ValueOfModulus, Viscosity
from ngvisco.physics.tensors import Tensor, exp, if_positive
from ngvisco.physics.variables import PRESSURE, TEMPERATURE, Values

GAS_CONSTANT = 8.31446261815324
"""The gas constant R, J/(mol K)."""


@dataclass(frozen=True, kw_only=True)
class _Activation(Checked):
    """The factor a = exp(E/(R theta_R) - (E + p V)/(R theta)), 1 at theta_R and p = 0."""

    E: Annotated[float, Quantity("J/mol", example=2e5)]
    theta_R: Annotated[float, Quantity("K", "> 0", 300.0)]
    V: Annotated[float, Quantity("m^3/mol")] = 0.0
    temperature: Annotated[Modulus | None, Quantity("K", "> 0", 300.0, "arithmetic")] = None

    @property
    def _reads(self) -> set[str]:
        """Names of the values that the factor depends on. The names are those of the material's temperature,
        if ``temperature`` is None, and of the pressure, if V is not 0."""
        return ({TEMPERATURE} if self.temperature is None else set()) | ({PRESSURE} if self.V else set())

    def factor(self, z: Values) -> Any:
        """The factor a at a point with the values ``z``."""
        theta = z[TEMPERATURE] if self.temperature is None else value_at(self.temperature, z)
        barrier = self.E + self.V * z[PRESSURE] if self.V else self.E
        return exp(self.E / (GAS_CONSTANT * self.theta_R) - barrier / (GAS_CONSTANT * theta))


@dataclass(frozen=True, kw_only=True)
class _Faster(FlowRule):
    """A flow rule whose rate is ``factor`` times the rate of another rule.

    Parameters
    ----------
    rule : FlowRule
        The rule at theta_R and p = 0.
    """

    rule: FlowRule

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("nu", "q", "floor", "rate_floor", "reads_conjugate", "has_trace"):
            object.__setattr__(self, name, getattr(self.rule, name))

        # the factor is not a polynomial, so that only a rule that is linear in M keeps its degree
        object.__setattr__(self, "degree", 1.0 if self.rule.degree == 1 else math.inf)

    @property
    @abstractmethod
    def _reads(self) -> set[str]:
        """The names of the variables that the factor reads."""

    @abstractmethod
    def factor(self, z: Values) -> Any:
        """The ratio of the rate to the rate of ``rule``, at a point with the values ``z``."""

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return self.rule.reads | self._reads

    @property
    def flows(self) -> bool:
        return self.rule.flows

    @property
    def hardening(self) -> Hardening | None:
        return self.rule.hardening

    def rate(self, M: Tensor, zeta: Tensor | None, z: Values) -> Tensor:
        return self.factor(z) * self.rule.rate(M, zeta, z)

    def psi(self, Pi: Tensor, z: Values) -> Tensor:
        """a psi_rule(Pi/a), W/m^3."""
        a = self.factor(z)
        return a * self.rule.psi((1 / a) * Pi, z)


@dataclass(frozen=True, kw_only=True)
class Activated(_Activation, _Faster):
    """A flow rule's rate times a = exp(E/(R theta_R) - (E + p V)/(R theta)) (Arrhenius 1889).

    Example::

        import ngvisco as nv

        dislocation = nv.Activated(rule=nv.Norton(A=1e-16, n=3.5), E=5.3e5, theta_R=1600.0, V=1.4e-5)
        diffusion = nv.Activated(rule=nv.Creep(G_m=1e21), E=3.75e5, theta_R=1600.0)
        rule = nv.Composite(rules=(dislocation, diffusion))
        print(sorted(rule.reads))

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    rule : FlowRule
        The rule at theta_R and p = 0.
    E : float
        Activation energy.
    theta_R : float
        Temperature at which creep follows the given rule.
    V : float
        Activation volume; where it is > 0, pressure slows creep down.
    temperature : float, optional
        A number; a function of the initial place, which is carried; or an expression of parameters. None
        stands for the temperature of a material with heat.
    """


@dataclass(frozen=True, kw_only=True)
class WLF(_Faster):
    """A flow rule's rate times 1/a_T = 10^{C_1 (theta - theta_R)/(C_2 + theta - theta_R)}.

    Williams, Landel and Ferry (1955) describe polymers near the glass transition in this way: all relaxation
    times are multiplied by a_T. The rate vanishes as theta falls to theta_R - C_2, and is zero at lower
    temperatures. Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    rule : FlowRule
        The rule at theta_R.
    C_1 : float
        Decades of the shift far above theta_R.
    C_2 : float
        Difference between theta_R and the temperature at which creep stops.
    theta_R : float
        Temperature at which creep follows the given rule.
    temperature : float, optional
        As for ``Activated``.
    """

    C_1: Annotated[float, Quantity("1", "> 0", 17.4)]
    C_2: Annotated[float, Quantity("K", "> 0", 51.6)]
    theta_R: Annotated[float, Quantity("K", "> 0", 293.0)]
    temperature: Annotated[Modulus | None, Quantity("K", "> 0", 300.0)] = None

    @property
    def _reads(self) -> set[str]:
        return {TEMPERATURE} if self.temperature is None else set()

    def factor(self, z: Values) -> Any:
        """1/a_T."""
        theta = z[TEMPERATURE] if self.temperature is None else value_at(self.temperature, z)
        least = 1e-2 * self.C_2  # at this distance from theta_R - C_2 the shift is 100 C_1 decades
        above = theta + (self.C_2 - self.theta_R)
        if isinstance(above, (int, float)):
            above = max(above, least)
        else:
            above = least + if_positive(above - least, above - least, 0 * (above - least))
        return exp(math.log(10) * self.C_1 * (1 - self.C_2 / above))


@dataclass(frozen=True, kw_only=True)
class ActivatedViscosity(_Activation, Viscosity):
    """A viscosity divided by a = exp(E/(R theta_R) - (E + p V)/(R theta)) (Arrhenius, Andrade).

    With V the viscosity grows with the pressure like exp(V p/(R theta)), which is the law of Barus (1893).
    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    viscosity : Viscosity
        The viscosity at theta_R and p = 0.
    E : float
        Activation energy.
    theta_R : float
        Temperature at which the viscosity is as given.
    V : float
        Activation volume.
    temperature : float, optional
        As for ``Activated``.
    """

    viscosity: Viscosity

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        return self.viscosity.reads | self._reads

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        return self.viscosity.is_linear

    def stress(self, eps: Tensor, z: Values) -> Tensor:
        return (1 / self.factor(z)) * self.viscosity.stress(eps, z)

    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        return (1 / self.factor(z)) * self.viscosity.shear_viscosity(z)

    def require_dimension(self, dim: int) -> None:
        self.viscosity.require_dimension(dim)

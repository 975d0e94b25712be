"""Rates of the transported variables and their power, as the terms of a step ask for them.

``Rates`` writes them with coefficient functions.  ``TabulatedRates`` (``ngvisco.forms.tabulated_rates``) has
the same methods for arrays of values, with the constant tensors that the rates are made of: a term asks
``u.context.rates`` and need not know which of them it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.material import mandel_stress, rate_power
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.model import Model
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import identity_like, inner, square, trace_free_tensors
from ngvisco.physics.variables import PRESSURE, TEMPERATURE, Values

Conjugate: TypeAlias = Literal["z", "zeta"]
"""Whether a rate is taken with tests of z or with conjugates."""


class Rates:
    """rate(z; L, Pi) : G for one model."""

    def __init__(self, model: Model, dim: int) -> None:
        self.model, self.material, self.dim = model, model.material, dim

    def power(self, z: Fields, along: Fields, G: Fields, name: Conjugate) -> Sequence[CoefficientFunction]:
        """rate(z; grad w, 0) : G in summands, w the velocity of ``along``, G the part ``name`` of ``G``.

        Without conserved variables: theirs is within their flux.
        """
        zero, tensors = 0 * along.L, _tensors(G, name)
        return [
            inner(variable.rate(z.z_tensors, along.L, zero), tensors[variable.name])
            for variable in self.material.variables
            if not variable.is_conserved
        ]

    def creep_power(
        self, z: Fields, Pi: CoefficientFunction, G: Fields, name: Conjugate
    ) -> Sequence[CoefficientFunction]:
        """rate(z; 0, Pi) : G in summands, Pi 3x3; the affine parts of a rate vanish at L = 0."""
        tensors = _tensors(G, name)
        return [
            inner(variable.rate(z.z_tensors, 0 * Pi, Pi), tensors[variable.name])
            for variable in self.material.variables
            if variable.creeps
        ]

    def mandel(self, u: Fields) -> CoefficientFunction:
        """Mandel stress of the projected conjugates, 3x3, Pa."""
        return mandel_stress(self.material, u.z_tensors, u.zeta_tensors, self.dim)

    def mandel_components(self, u: Fields) -> CoefficientFunction:
        """The same in the components that a creep rate field has."""
        return trace_free_tensors(self.dim).components(self.mandel(u))

    @property
    def rule(self) -> FlowRule | None:
        """The model's flow rule; None where nothing creeps."""
        rule = self.model.creep
        return None if rule is None or not rule.flows else rule

    def creep(self, u: Fields) -> CoefficientFunction | None:
        """Pi, 3x3, 1/s: of a local rule, or the field of its own; None without creep."""
        if self.rule is None:
            return None
        return self.local_creep(self.rule, u) if self.rule.is_local else u.Pi

    def local_creep(self, rule: FlowRule, u: Fields) -> CoefficientFunction:
        """Pi by a rule at the values at the point, 3x3, 1/s."""
        return rule.rate(self.mandel(u), self.read_conjugate(u), self.read_values(rule, u))

    def read_conjugate(self, u: Fields) -> CoefficientFunction | None:
        """The zeta that a rule may read; None where the material has no conformation tensor."""
        conformation = self.material.conformation
        return None if conformation is None else u.zeta_tensors[conformation]

    def read_values(self, law: FlowRule | Viscosity, u: Fields) -> Values:
        """The values z that a law may read, with pressure and temperature where it asks for them."""
        if not law.reads:
            return u.z_tensors
        made = {PRESSURE: self.pressure, TEMPERATURE: self.temperature}
        return {**u.z_tensors, **{name: made[name](u) for name in sorted(law.reads)}}

    def temperature(self, u: Fields) -> CoefficientFunction:
        """theta by the projected conjugates, K, of a material with heat."""
        return temperature(self.material, u.zeta_tensors)

    def pressure(self, u: Fields) -> CoefficientFunction:
        """-tr T/3 by the projected conjugates, Pa."""
        identity = identity_like(u.L) + 0 * u.L
        power = rate_power(self.material, u.z_tensors, u.zeta_tensors, identity, 0 * u.L)
        return (-1 / 3) * power - self.stored(u)

    def stored(self, u: Fields) -> CoefficientFunction:
        """phi(z), Pa."""
        return u.context.energy.density(u)

    def dissipation(self, u: Fields) -> CoefficientFunction | None:
        """The power of creep, W/m^3, without that of its gradient term; None without creep."""
        Pi = self.creep(u)
        if self.rule is None or Pi is None:
            return None
        if not self.rule.is_local:
            return inner(self.rule.force(Pi, self.read_values(self.rule, u)), Pi)
        if not self.rule.has_trace:
            return inner(Pi, self.mandel(u))
        return -rate_power(self.material, u.z_tensors, u.zeta_tensors, 0 * Pi, Pi)

    def gradient_dissipation(self, u: Fields) -> CoefficientFunction | None:
        """nu |grad Pi|^q, W/m^3; None where creep has no gradient term."""
        if self.rule is None or self.rule.is_local:
            return None
        size = square(u.grad_Pi)
        return self.rule.gradient_coefficient(size) * size


def _tensors(G: Fields, name: Conjugate) -> Values:
    return G.z_tensors if name == "z" else G.zeta_tensors

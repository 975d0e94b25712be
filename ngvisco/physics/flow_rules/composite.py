"""Mechanisms of creep side by side."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.physics.flow_rules.rule import FlowRule
from ngvisco.physics.variables import Values


@dataclass(frozen=True, kw_only=True)
class Composite(FlowRule):
    """Pi = sum of the rates of several rules under one stress, such as diffusion and dislocation creep.

    Its potential of M is the sum of theirs; that of Pi has no closed form, so that it is local.  Raises
    ParameterError if a parameter is out of its range.

    Parameters
    ----------
    rules : sequence of FlowRule
        At least one, each local (nu = 0).
    """

    rules: tuple[FlowRule, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.rules, (tuple, list)) or not self.rules:
            raise ParameterError("Composite.rules", self.rules, "a sequence of flow rules")
        object.__setattr__(self, "rules", tuple(self.rules))
        for i, rule in enumerate(self.rules):
            if not isinstance(rule, FlowRule):
                raise ParameterError("Composite.rules", rule, "flow rules")
            if not rule.is_local:
                raise ParameterError(f"Composite.rules[{i}].nu", rule.nu, "0 within a sum")
            if rule.hardening is not None:
                expected = "a rule without hardening: of a sum's rate no part is that of its plastic strain"
                name = "Q" if rule.hardening.H == 0 else "H"
                value = getattr(rule.hardening, name)
                raise ParameterError(f"Composite.rules[{i}].{name}", value, expected)

    def rate(
        self, M: CoefficientFunction, zeta: CoefficientFunction | None, z: Values
    ) -> CoefficientFunction:
        return reduce(add, (rule.rate(M, zeta, z) for rule in self.rules if rule.flows))

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

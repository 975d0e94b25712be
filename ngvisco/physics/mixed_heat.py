"""Heat of bodies that share a point: one temperature, as there is one pressure.

Body i has the internal energy eps_i(S, J) = U_i(J) + u_i(S, J) per reference volume (``Thermal``), and all
share the entropy s per actual volume.  What is not of shear is

    W(n, s) = min over J_i, S_i with sum n_i J_i = 1 and sum n_i S_i = s of  sum n_i eps_i(S_i, J_i),

jointly convex in (n, s), as a least value of a sum of perspectives.  By the envelope theorem dW/ds is the
temperature that all have in common.  S_i = c_i (ln(theta/theta_R,i) + g_i(J_i)), so that at known volumes

    ln theta = (s + sum n_i c_i (ln theta_R,i - g_i(J_i)))/sum n_i c_i.

Where all thermal pressures are one function of (J, theta), and all U_i' one of J, all J_i are 1/N and W has
an expression; else ``ngvisco.physics.equilibrium`` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.physics.bodies import Body
from ngvisco.physics.heat import Function, Heat
from ngvisco.physics.materials.thermal import Entropy, Thermal, entropy_in
from ngvisco.physics.variables import Values

_SAME = 1e-9
"""Relative difference of thermal pressures that are one function."""


@dataclass(frozen=True)
class MixedHeat:
    """The thermal energies of bodies.

    Parameters
    ----------
    parts : mapping of names to Thermal
        The materials of the bodies, which all count their entropies in one unit.
    """

    parts: Mapping[str, Thermal]

    @property
    def entropy(self) -> Entropy:
        """The carried one."""
        return next(iter(self.parts.values())).entropy

    @cached_property
    def has_one_pressure(self) -> bool:
        """Whether the thermal pressure is one function of J and theta."""
        J, theta = np.meshgrid([0.5, 1.0, 2.0], [1.0, 300.0])
        first, *others = (each.pressure(theta, J) for each in self.parts.values())
        return all(abs(other - first).max() <= _SAME * abs(first).max() for other in others)

    @property
    def reference_temperature(self) -> float | None:
        """theta_R, K, where it is that of all."""
        found = {each.theta_R for each in self.parts.values()}
        return found.pop() if len(found) == 1 else None

    def capacity(self, n: Mapping[str, Any]) -> Any:
        """sum n_i c_i, J/(m^3 K)."""
        return reduce(add, (each.c * n[name] for name, each in self.parts.items()))

    def total(self, n: Mapping[str, Any], log_theta: Any, J: Any) -> Any:
        """The carried entropy where all bodies have the volume J and a temperature, by its logarithm."""
        parts = (n[name] * each.entropy_of(log_theta, J) for name, each in self.parts.items())
        return 1 / self.entropy.unit * reduce(add, parts)

    def entropies(self, n: Mapping[str, Any], s: Any, J: Any) -> dict[str, Any]:
        """S_i in the carried one's unit, by name, of which s is the sum where all have the volume J."""
        unit = self.entropy.unit
        log_theta = unit / self.capacity(n) * (s - self.total(n, 0.0, J))
        return {name: 1 / unit * each.entropy_of(log_theta, J) for name, each in self.parts.items()}

    def energy(self, body: str, S: Any, J: Any) -> Any:
        """u_i(S, J) of a body, Pa."""
        return J * self.parts[body].of_heat({"A": 1 / J, "s": S / J})


def heat_of(bodies: Sequence[Body]) -> MixedHeat | None:
    """Of bodies with heat; None of such without.

    The entropy counts in the first of the units that are given, else in the largest heat capacity.
    """
    parts = {body.name: body.material for body in bodies if isinstance(body.material, Thermal)}
    units = [each.entropy_unit for each in parts.values() if each.entropy_unit]
    unit = units[0] if units else max((each.c for each in parts.values()), default=None)
    return MixedHeat({n: replace(each, entropy_unit=unit) for n, each in parts.items()}) if parts else None


def require_heat_of_all(bodies: Sequence[Body]) -> None:
    """Raise ParameterError where bodies cannot have one temperature, or what one knows of heat is no use."""
    warm = [body for body in bodies if entropy_in(body.material) is not None]
    thermal = [body.material for body in warm if isinstance(body.material, Thermal)]
    units = {each.entropy_unit for each in thermal if each.entropy_unit is not None}
    for body in bodies:
        owner, expected = f"bodies[{body.name!r}].material", ""
        if warm and body not in warm:
            expected = f"nv.Thermal(material=...), as {warm[0].name!r} has: all have one temperature"
        elif body in warm and not isinstance(body.material, Thermal):
            expected = "nv.Thermal(material=...) itself: of no other energy is a body's entropy known"
        elif len(units) > 1:
            expected = f"one entropy_unit for all bodies, not {sorted(units)}: they share one entropy"
        if expected:
            raise ParameterError(owner, body.material, expected)
        if body.heat is None:
            continue
        if not warm:
            expected = "None for a material without a temperature; nv.Thermal(material=...) gives it one"
            raise ParameterError(f"bodies[{body.name!r}].heat", body.heat, expected)
        if body.heat.numerical_heating:
            expected = "False: what the scheme dissipates is of all bodies, Model(heat=...)"
            raise ParameterError(f"bodies[{body.name!r}].heat.numerical_heating", True, expected)


@dataclass(frozen=True)
class HeatLaw:
    """What a model says of heat and, by its fraction, each body: kappa = kappa_0 + sum theta_i kappa_i."""

    parts: Mapping[str | None, Heat]
    """By the bodies' names; None for all matter."""
    fractions: Any = None
    """``ngvisco.physics.mixture.Fractions`` of bodies."""

    @property
    def conducts(self) -> bool:
        """Whether heat is conducted at all."""
        return any(law.conducts for law in self.parts.values())

    @property
    def numerical_heating(self) -> bool:
        return any(law.numerical_heating for law in self.parts.values())

    @property
    def sources(self) -> list[tuple[str | None, Function]]:
        """Heat that is produced, W/m^3, and by which body; None for all."""
        return [(name, law.source) for name, law in self.parts.items() if law.source is not None]

    def share(self, body: str | None, z: Values) -> Any:
        """How much of a point with the values ``z`` is a body's."""
        return 1.0 if body is None else self.fractions.not_negative(z)[body]

    def size(self, theta: Any, z: Values) -> Any:
        """kappa, of a matrix its largest eigenvalue, W/(m K)."""
        return self._sum(z, lambda law: law.size(theta))

    def flux(self, theta: Any, slope: Any, z: Values, dim: int) -> Any:
        """kappa grad theta, W/m^2."""
        return self._sum(z, lambda law: law.flux(theta, slope, dim))

    def _sum(self, z: Values, of: Callable[[Heat], Any]) -> Any:
        conducting = {name: law for name, law in self.parts.items() if law.conducts or name is None}
        return reduce(add, (self.share(name, z) * of(law) for name, law in conducting.items()))

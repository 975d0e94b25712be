"""Viscosity of bodies that share a point."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import add
from typing import Any

from ngvisco.physics.bodies import Body, Fractions, Interface, Parting
from ngvisco.physics.parameters import typical_value, value_at
from ngvisco.physics.rheology import StokesViscosity, ValueOfModulus, Viscosity
from ngvisco.physics.tensors import Tensor, dev, opening, opening_stress, shear_across
from ngvisco.physics.variables import INTERFACE, Values


@dataclass(frozen=True, kw_only=True)
class MixedViscosity(Viscosity):
    """The stress sum theta_i D_i eps; shear across an interface of Stokes fluids has the mean fluidity.

    In a cell with an interface of normal n, the shear across the interface acts on layers in series.  This
    shear is the part

        S(eps) = P eps + P eps^T - 2 P eps P,   P = n x n,

    of dev eps. Its viscosity is H, 1/H = sum theta_i/G_i. Both sides share the rest of dev eps, whose
    viscosity is A = sum theta_i G_i.  D = 2 A dev eps - 2 (A - H) S(dev eps) is symmetric, and D : eps >= 0.
    n is the normal at the step's start.  All parts have the viscosity A if a body has no shear viscosity, or
    a nonlinear one.

    If bodies part, D_i acts on the body's own strain rate instead (``Parting``), and the transpose maps the
    stress.
    """

    parts: tuple[tuple[str, Viscosity], ...]
    """Pairs of a body's name and its viscosity, for the bodies that have one."""
    fractions: Fractions
    parting: Parting | None = None

    @property
    def reads(self) -> frozenset[str]:  # type: ignore[override]
        interface = set() if self.interface is None else {INTERFACE}
        return frozenset[str](interface).union(*(part.reads for _, part in self.parts))

    @cached_property
    def in_series(self) -> dict[str, float]:
        """Typical shear viscosities, Pa s, by the bodies' names; empty unless layers act in series."""
        if self.parting is not None:
            return {}
        stokes = {name: part for name, part in self.parts if isinstance(part, StokesViscosity)}
        viscosities = {name: typical_value(part.G_v) for name, part in stokes.items()}
        all_are = len(viscosities) == len(self.fractions.bodies) > 1 and min(viscosities.values()) > 0
        return viscosities if all_are and max(viscosities.values()) > min(viscosities.values()) else {}

    @property
    def interface(self) -> Interface | None:
        """The interface: of bodies that part, or else of the logarithms of viscosities in series. None if
        there are no such bodies."""
        if self.parting is not None:
            return self.parting.interface
        logarithms = tuple((name, math.log(G_v)) for name, G_v in self.in_series.items())
        return Interface(logarithms, self.fractions) if logarithms else None

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        return all(part.is_linear for _, part in self.parts)

    def _mean(self, z: Values, quantity: Callable[[Viscosity], Any]) -> Any:
        theta = self.fractions.not_negative(z)
        return reduce(add, (theta[name] * quantity(part) for name, part in self.parts))

    def stress(self, eps: Tensor, z: Values) -> Tensor:
        if self.parting is not None:
            return self._parted_stress(eps, z, self.parting.shares(z))
        mean = self._mean(z, lambda part: part.stress(eps, z))
        if not self.in_series:
            return mean
        theta, P, shear = self.fractions.not_negative(z), z[INTERFACE], dev(eps)
        values = {
            name: value_at(part.G_v, z) for name, part in self.parts if isinstance(part, StokesViscosity)
        }
        along = reduce(add, (theta[name] * G_v for name, G_v in values.items()))
        total = reduce(add, theta.values())
        across = total * total / reduce(add, (theta[name] / G_v for name, G_v in values.items()))
        return mean - (2 * (along - across)) * dev(shear_across(shear, P))

    def _parted_stress(self, eps: Tensor, z: Values, shares: Mapping[str, Any]) -> Tensor:
        theta, P, parts = self.fractions.not_negative(z), z[INTERFACE], []
        for name, part in self.parts:
            if name not in shares:
                parts.append(theta[name] * part.stress(eps, z))
                continue
            stress = part.stress(eps - shares[name] * opening(eps, P), z)
            parts.append(theta[name] * (stress - shares[name] * opening_stress(stress, P)))
        return reduce(add, parts)

    def shear_viscosity(self, z: Values) -> ValueOfModulus:
        return self._mean(z, lambda part: part.shear_viscosity(z))

    def require_dimension(self, dim: int) -> None:
        for _, part in self.parts:
            part.require_dimension(dim)


def mixed_viscosity(bodies: Sequence[Body], parting: Parting | None = None) -> Viscosity | None:
    """The common viscosity of bodies; None if no body has one."""
    parts = tuple((b.name, b.viscosity) for b in bodies if b.viscosity is not None)
    fractions = Fractions(tuple(b.name for b in bodies))
    return MixedViscosity(parts=parts, fractions=fractions, parting=parting) if parts else None

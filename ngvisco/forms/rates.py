"""Rates of the transported variables and their power, as the terms of a step ask for them.

``Rates`` writes them with coefficient functions, ``TabulatedRates`` (``ngvisco.forms.rate_tensors``) with
the constant tensors that these are made of, for arrays of values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.physics.material import creep_tensors, mandel_stress
from ngvisco.physics.model import Model
from ngvisco.physics.rheology import Creep
from ngvisco.physics.tensors import inner, trace_free_tensors
from ngvisco.physics.variables import Values

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
        """rate(z; 0, Pi) : G in summands; the affine parts of a rate vanish at L = 0."""
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

    def creep(self, u: Fields) -> CoefficientFunction | None:
        """Pi, 3x3, 1/s: local, R M or by another law, or the field of its own; None without creep."""
        law = self.model.creep
        if law is None or law.R == 0:
            return None
        return self.local_creep(law, u) if law.is_local else u.Pi

    def local_creep(self, law: Creep, u: Fields) -> CoefficientFunction:
        """Pi by a local law, 3x3, 1/s."""
        M = zeta = None
        if law.weights[0]:
            M = self.mandel(u)
        if law.weights[1]:
            assert self.material.conformation is not None
            space = creep_tensors(law, self.dim)
            zeta = space.tensor(space.components(u.zeta_tensors[self.material.conformation]))
        return law.rate(M, zeta, u.z_tensors)


def _tensors(G: Fields, name: Conjugate) -> Values:
    return G.z_tensors if name == "z" else G.zeta_tensors

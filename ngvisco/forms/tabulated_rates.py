"""The rates of a material's variables and their power for arrays of values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Conjugate, Rates
from ngvisco.physics.arrays import Array, Linear
from ngvisco.physics.material import creep_tensors
from ngvisco.physics.model import Model
from ngvisco.physics.rate_tensors import RateTensors
from ngvisco.physics.tensors import dev, trace_free_tensors


class TabulatedRates(Rates):
    """What ``Rates`` is for coefficient functions, for arrays of values and tests of them."""

    def __init__(self, model: Model, dim: int) -> None:
        super().__init__(model, dim)
        self.creep_space = creep_tensors(self.rule, dim)
        """The tensors among which Pi is, and the forces that drive it."""
        trace = self.rule is not None and self.rule.has_trace
        self.tensors = RateTensors.of(tuple(model.material.variables), dim, trace)
        states = model.material.states(dim)
        kept = ~states.conserved
        self._without_flux = self.tensors
        """Those of what is not conserved: theirs is within their flux."""
        if not kept.all():
            of_kept = self.tensors.constant * kept, self.tensors.linear * kept[:, None]
            self._without_flux = RateTensors(*of_kept, self.tensors.gradients)

    def power(self, z: Fields, along: Fields, G: Fields, name: Conjugate) -> Sequence[Linear]:
        """rate(z; grad w, 0) : G with either w or G a test."""
        t, tests = self._without_flux, G.parts[name]
        if isinstance(tests, Linear):
            L = along.grad_v.value
            rate = t.rate(z.z.value, L.reshape(t.gradients, -1))
            return [tests.InnerProduct(Array(rate, None))]
        stress = t.stress(z.z.value, tests.value, 0, t.gradients)
        shape = (*along.grad_v.shape, -1)
        return [along.grad_v.InnerProduct(Array(stress.reshape(shape), None))]

    def creep_power(self, z: Fields, Pi: Array, G: Fields, name: Conjugate) -> Sequence[Linear]:
        """rate(z; 0, Pi) : G, with G a test."""
        components = self.creep_space.components(Pi).value
        rate = self.tensors.rate(z.z.value, components, first=self.tensors.gradients)
        return [G.parts[name].InnerProduct(Array(rate, None))]

    def mandel(self, u: Fields) -> Array:
        """Mandel stress of the projected conjugates, 3x3, Pa."""
        t = self.tensors
        M = Array(t.stress(u.z.value, u.zeta.value, t.gradients, len(t.constant)), None)
        tensor = -self.creep_space.tensor(M)
        return dev(tensor) if self.rule is not None and self.rule.has_trace else tensor

    def mandel_components(self, u: Fields) -> Array:
        """The same in the components that a creep rate field has."""
        return trace_free_tensors(self.dim).components(self.mandel(u))

    def stored(self, u: Fields) -> Array:
        """phi(z), Pa."""
        return self.material.energy(u.z_tensors)

    def creep_components(self, u: Fields) -> np.ndarray:
        """Pi of a local rule in components, (p, points)."""
        return self.creep_space.components(self.creep(u)).value

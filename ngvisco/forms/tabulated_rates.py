"""The rates of a material's variables and their power for arrays of values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Conjugate, Rates
from ngvisco.physics.arrays import Array, Linear
from ngvisco.physics.flows import Flow
from ngvisco.physics.model import Model
from ngvisco.physics.rate_tensors import RateTensors
from ngvisco.physics.state_space import StateSpace
from ngvisco.physics.tensors import dev, symmetric_tensors, trace_free_tensors


class TabulatedRates(Rates):
    """What ``Rates`` is for coefficient functions, for arrays of values and tests of them."""

    def __init__(self, model: Model, dim: int) -> None:
        super().__init__(model, dim)
        trace = any(flow.rule.has_trace for flow in self.flows)
        self.creep_space = symmetric_tensors(dim) if trace else trace_free_tensors(dim)
        """The tensors among which each Pi is, and the forces that drive it."""
        variables = tuple(model.material.variables)
        self.tensors = RateTensors.of(variables, dim, trace)
        if len(self.flows) > 1 or any(flow.body is not None for flow in self.flows):
            names = (flow.names for flow in self.flows)
            self.tensors = self.tensors.by_groups(tuple(names), StateSpace.of(variables, dim))
        states = model.material.states(dim)
        self._without_flux = self.tensors
        """Of densities their production alone: the rest is within their flux."""
        if states.by_flux.any():
            linear, of_flux = self.tensors.linear.copy(), np.flatnonzero(states.by_flux)
            for i in range(dim):
                linear[i * (dim + 1), of_flux, of_flux] += 1.0
            linear[abs(linear) < 1e-12] = 0.0
            self._without_flux = replace(self.tensors, linear=linear)

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

    def creep_power(self, z: Fields, Pi: Sequence[Array], G: Fields, name: Conjugate) -> Sequence[Linear]:
        """rate(z; 0, Pi) : G, with G a test, Pi one a flow."""
        rate = self.tensors.rate(z.z.value, self._components(Pi), first=self.tensors.gradients)
        return [G.parts[name].InnerProduct(Array(rate, None))]

    def mandel(self, u: Fields, flow: Flow | None = None) -> Array:
        """Mandel stress of the projected conjugates, 3x3, Pa, that drives a flow, by default the first."""
        t, size = self.tensors, self.creep_space.size
        first = t.gradients + size * (0 if flow is None else self.flows.index(flow))
        M = Array(t.stress(u.z.value, u.zeta.value, first, first + size), None)
        tensor = -self.creep_space.tensor(M)
        return dev(tensor) if flow is not None and flow.rule.has_trace else tensor

    def stored(self, u: Fields) -> Array:
        """phi(z), Pa."""
        return self.material.energy(u.z_tensors)

    def creep_components(self, u: Fields) -> np.ndarray:
        """Pi of all local rules in components, (flows p, points)."""
        return self._components(self.creep(u))

    def _components(self, Pi: Sequence[Array]) -> np.ndarray:
        return np.concatenate([self.creep_space.components(each).value for each in Pi])

"""The rates of a material's variables and their power for arrays of values."""

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

_ROUNDING = 1e-12


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
        flux = np.zeros_like(self.tensors.linear)
        for i in range(dim):
            flux[i * (dim + 1)][np.diag_indices(states.size)] = -1.0 * states.by_flux
        production = self.tensors.linear - flux
        production[abs(production) < _ROUNDING] = 0.0
        self.production = replace(self.tensors, linear=production)
        """Of densities without what is within their flux."""
        shared = model.material.taking_part(states.tensors(lambda: Array(np.ones((states.size, 1)), None)))
        self._shared = {name: states.slices[name] for name in shared}
        self.weighed: RateTensors | None = None
        """What of the rates is times how far a variable takes part (``Material.taking_part``)."""
        if shared:
            self.weighed = self.production - self.production.turning()
            self.tensors, self.production = self.tensors - self.weighed, self.production.turning()

    def weights(self, z: Fields) -> np.ndarray:
        """How far each component takes part, (n, points)."""
        values = self.material.taking_part(z.z_tensors)
        weights = np.ones(z.z.value.shape, z.z.value.dtype)
        for name, own in self._shared.items():
            weights[own] = values[name].value
        return weights

    def rate(self, z: Fields, X: np.ndarray, first: int = 0) -> np.ndarray:
        """rate(z; X), (n, points), for the X from ``first`` on, of densities their production."""
        found = self.production.rate(z.z.value, X, first)
        if self.weighed is not None:
            found = found + self.weights(z) * self.weighed.rate(z.z.value, X, first)
        return found

    def stress(self, z: Fields, zeta: np.ndarray, first: int, stop: int) -> np.ndarray:
        """d(zeta : rate)/dX for X = first ... stop - 1, (X, points)."""
        found = self.production.stress(z.z.value, zeta, first, stop)
        if self.weighed is not None:
            found = found + self.weighed.stress(z.z.value, self.weights(z) * zeta, first, stop)
        return found

    def power(self, z: Fields, along: Fields, G: Fields, name: Conjugate) -> Sequence[Linear]:
        """rate(z; grad w, 0) : G with either w or G a test."""
        gradients, tests = self.tensors.gradients, G.parts[name]
        if isinstance(tests, Linear):
            rate = self.rate(z, along.grad_v.value.reshape(gradients, -1))
            return [tests.InnerProduct(Array(rate, None))]
        stress = self.stress(z, tests.value, 0, gradients)
        shape = (*along.grad_v.shape, -1)
        return [along.grad_v.InnerProduct(Array(stress.reshape(shape), None))]

    def creep_power(self, z: Fields, Pi: Sequence[Array], G: Fields, name: Conjugate) -> Sequence[Linear]:
        """rate(z; 0, Pi) : G, with G a test, Pi one a flow."""
        rate = self.rate(z, self._components(Pi), self.tensors.gradients)
        return [G.parts[name].InnerProduct(Array(rate, None))]

    def mandel(self, u: Fields, flow: Flow | None = None) -> Array:
        """Mandel stress of the projected conjugates, 3x3, Pa, that drives a flow, by default the first."""
        size = self.creep_space.size
        first = self.tensors.gradients + size * (0 if flow is None else self.flows.index(flow))
        M = Array(self.stress(u, u.zeta.value, first, first + size), None)
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

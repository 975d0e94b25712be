"""The rates of a material's variables as constant tensors.

Every rate is affine in z and linear in L and Pi (ngvisco.physics.variables), so that for X = (L, Pi)

    rate(z; X)_n = sum_x X_x (C_xn + sum_m T_xnm z_m)

in components, with constants that are read off here by evaluating the rates at unit arguments.  L has the
dim^2 entries L_ij, row by row, and Pi the components of the trace-free tensors (of the symmetric ones by a
law of creep with a trace).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import L2, GridFunction, VectorValued

from ngvisco.forms.fields import Fields
from ngvisco.forms.rates import Conjugate, Rates
from ngvisco.physics.arrays import Array, Linear
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.material import Material, creep_tensors
from ngvisco.physics.model import Model
from ngvisco.physics.pointwise import squares
from ngvisco.physics.tensors import constant, dev, embed_gradient, trace_free_tensors


@dataclass(frozen=True)
class RateTensors:
    """C (X, n) and T (X, n, n) of the module's docstring, and T's non-zero entries one by one."""

    constant: np.ndarray
    linear: np.ndarray
    gradients: int
    """How many of the X are entries of L; the others are components of Pi."""

    @classmethod
    def of(cls, material: Material, dim: int, creep: FlowRule | None = None) -> RateTensors:
        """Read off from ``material.variables`` at z = 0 and at unit vectors of the components."""
        n, space = material.states(dim).size, creep_tensors(creep, dim)
        zero = constant(np.zeros((3, 3)))
        directions = []
        for unit in np.eye(dim * dim):
            directions.append((embed_gradient(constant(unit.reshape(dim, dim)), dim), zero))
        directions += [(zero, constant(np.array(P))) for P in space.basis]

        mesh, points = squares(1 + int(np.sqrt(n)))  # a square each for z = 0 and the unit vectors
        z = GridFunction(VectorValued(L2(mesh, order=0), n))
        z.vec.FV().NumPy().reshape(n, -1)[:, 1 : n + 1] = np.eye(n)
        tensors = material.states(dim).tensors(lambda: z)
        at_zero = np.zeros((len(directions), n))
        linear = np.zeros((len(directions), n, n))
        for x, (L, Pi) in enumerate(directions):
            of_variables = {v.name: v.rate(tensors, L, Pi) for v in material.variables}
            rates = np.asarray(material.states(dim).components(of_variables)(points)).reshape(-1, n).T
            at_zero[x] = rates[:, 0]
            linear[x] = rates[:, 1 : n + 1] - rates[:, :1]
        return cls(at_zero, linear, dim * dim)

    @property
    def creep_size(self) -> int:
        """Components of Pi."""
        return len(self.constant) - self.gradients

    def columns(self, z: np.ndarray) -> np.ndarray:
        """d rate/dX at values z (n, points): (points, n, X)."""
        columns = np.einsum("xnm,mp->pnx", self.linear, z, optimize=True)
        columns += self.constant.T[None]
        return columns

    def rate(self, z: np.ndarray, X: np.ndarray, first: int = 0) -> np.ndarray:
        """rate(z; X), (n, points), of the X (X, points) from ``first`` on."""
        out = np.zeros((self.linear.shape[1], z.shape[1]), np.result_type(z, X))
        stop = first + len(X)
        for x, n in np.argwhere(self.constant[first:stop]):
            out[n] += self.constant[first + x, n] * X[x]
        product = np.empty(z.shape[1], out.dtype)
        for x, n, m in np.argwhere(self.linear[first:stop]):
            _add_product(out[n], X[x], z[m], self.linear[first + x, n, m], product)
        return out

    def stress(self, z: np.ndarray, zeta: np.ndarray, first: int, stop: int) -> np.ndarray:
        """d(zeta : rate)/dX for X = first ... stop - 1, (X, points)."""
        out = np.zeros((stop - first, z.shape[1]), np.result_type(z, zeta))
        for x, n in np.argwhere(self.constant[first:stop]):
            out[x] += self.constant[first + x, n] * zeta[n]
        product = np.empty(z.shape[1], out.dtype)
        for x, n, m in np.argwhere(self.linear[first:stop]):
            _add_product(out[x], zeta[n], z[m], self.linear[first + x, n, m], product)
        return out


def _add_product(
    target: np.ndarray, a: np.ndarray, b: np.ndarray, factor: float, product: np.ndarray
) -> None:
    """target += factor a b; ``product`` is overwritten."""
    np.multiply(a, b, out=product)
    if factor == 1.0:
        target += product
    elif factor == -1.0:
        target -= product
    else:
        product *= factor
        target += product


class TabulatedRates(Rates):
    """What ``Rates`` is for coefficient functions, for arrays of values and tests of them."""

    def __init__(self, model: Model, dim: int) -> None:
        super().__init__(model, dim)
        self.tensors = RateTensors.of(model.material, dim, model.creep)
        states = model.material.states(dim)
        kept = ~states.conserved
        self._without_flux = self.tensors
        """Those of what is not conserved: theirs is within their flux."""
        if not kept.all():
            of_kept = self.tensors.constant * kept, self.tensors.linear * kept[:, None]
            self._without_flux = RateTensors(*of_kept, self.tensors.gradients)
        self._space = creep_tensors(self.rule, dim)
        """The tensors among which Pi is, and the forces that drive it."""

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
        components = self._space.components(Pi).value
        rate = self.tensors.rate(z.z.value, components, first=self.tensors.gradients)
        return [G.parts[name].InnerProduct(Array(rate, None))]

    def mandel(self, u: Fields) -> Array:
        """Mandel stress of the projected conjugates, 3x3, Pa."""
        t = self.tensors
        M = Array(t.stress(u.z.value, u.zeta.value, t.gradients, len(t.constant)), None)
        tensor = -self._space.tensor(M)
        return dev(tensor) if self.rule is not None and self.rule.has_trace else tensor

    def mandel_components(self, u: Fields) -> Array:
        """The same in the components that a creep rate field has."""
        return trace_free_tensors(self.dim).components(self.mandel(u))

    def stored(self, u: Fields) -> Array:
        """phi(z), Pa."""
        return self.material.energy(u.z_tensors)

    def creep_components(self, u: Fields) -> np.ndarray:
        """Pi of a local rule in components, (p, points)."""
        return self._space.components(self.creep(u)).value

"""The rates of a material's variables as constant tensors.

Every rate is affine in z and linear in L and Pi (ngvisco.physics.variables), so that for X = (L, Pi)

    rate(z; X)_n = sum_x X_x (C_xn + sum_m T_xnm z_m)

in components, with constants that are read off here by evaluating the rates at unit arguments.  L has the
dim^2 entries L_ij, row by row, and Pi the components of the trace-free tensors (of the symmetric ones by a
law of creep with a trace).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve import CF, L2, CoefficientFunction, GridFunction, VectorValued

from ngvisco.physics.material import (
    Material,
    component_count,
    component_slices,
    components_of,
    creep_tensors,
    tensors_of,
)
from ngvisco.physics.pointwise import squares
from ngvisco.physics.rheology import Creep
from ngvisco.physics.tensors import embed_gradient, tensor_space


@dataclass(frozen=True)
class RateTensors:
    """C (X, n) and T (X, n, n) of the module's docstring, and T's non-zero entries one by one."""

    constant: np.ndarray
    linear: np.ndarray
    gradients: int
    """How many of the X are entries of L; the others are components of Pi."""

    @classmethod
    def of(cls, material: Material, dim: int, creep: Creep | None = None) -> RateTensors:
        """Read off from ``material.variables`` at z = 0 and at unit vectors of the components."""
        n, space = component_count(material, dim), creep_tensors(creep, dim)
        zero = _constant(np.zeros((3, 3)))
        directions = []
        for unit in np.eye(dim * dim):
            directions.append((embed_gradient(_constant(unit.reshape(dim, dim)), dim), zero))
        directions += [(zero, _constant(np.array(P))) for P in space.basis]

        mesh, points = squares(1 + int(np.sqrt(n)))  # a square each for z = 0 and the unit vectors
        z = GridFunction(VectorValued(L2(mesh, order=0), n))
        z.vec.FV().NumPy().reshape(n, -1)[:, 1 : n + 1] = np.eye(n)
        tensors = tensors_of(material, z, dim)
        constant = np.zeros((len(directions), n))
        linear = np.zeros((len(directions), n, n))
        for x, (L, Pi) in enumerate(directions):
            of_variables = {v.name: v.rate(tensors, L, Pi) for v in material.variables}
            rates = np.asarray(components_of(material, of_variables, dim)(points)).reshape(-1, n).T
            constant[x] = rates[:, 0]
            linear[x] = rates[:, 1 : n + 1] - rates[:, :1]
        return cls(constant, linear, dim * dim)

    def columns(self, z: np.ndarray) -> np.ndarray:
        """d rate/dX at values z (n, points): (points, n, X)."""
        columns = np.einsum("xnm,mp->pnx", self.linear, z, optimize=True)
        columns += self.constant.T[None]
        return columns

    def rate(self, z: np.ndarray, X: np.ndarray, out: np.ndarray, constant: bool = True) -> None:
        """Add rate(z; X) to ``out`` (n, points); X is (X, points).

        Without ``constant`` only what is linear in z: the derivative in the direction z.
        """
        for x, n in np.argwhere(self.constant[: len(X)]) if constant else ():
            out[n] += self.constant[x, n] * X[x]
        self._accumulate(lambda x, n, m: (out[n], X[x], z[m]), len(X))

    def stress(
        self, z: np.ndarray, zeta: np.ndarray, out: np.ndarray, first: int = 0, constant: bool = True
    ) -> None:
        """Add d(zeta : rate)/dX for X = first ... first + len(out) - 1 to ``out`` (X, points).

        Without ``constant`` only what is linear in z, as above.
        """
        stop = first + len(out)
        for x, n in np.argwhere(self.constant[first:stop]) if constant else ():
            out[x] += self.constant[first + x, n] * zeta[n]
        self._accumulate(lambda x, n, m: (out[x - first], zeta[n], z[m]), stop, first)

    def _accumulate(self, arrays, stop: int, first: int = 0) -> None:  # type: ignore[no-untyped-def]
        product: np.ndarray | None = None
        for x, n, m in np.argwhere(self.linear[first:stop]):
            target, a, b = arrays(x + first, n, m)
            product = np.multiply(a, b, out=product)
            factor = self.linear[x + first, n, m]
            if factor == 1.0:
                target += product
            elif factor == -1.0:
                target -= product
            else:
                product *= factor
                target += product


@dataclass(frozen=True)
class Mobility:
    """Local creep in components, Pi = a M + D zeta, with M of ``RateTensors``: a = R by the paper's law."""

    of_mandel: float
    of_conjugates: np.ndarray | None
    """D, (components of Pi, n), 1/(Pa s); None for zero."""

    @classmethod
    def of(cls, material: Material, dim: int, creep: Creep) -> Mobility:
        """Of a law of creep whose rate is local."""
        a, b = creep.weights
        if b == 0:
            return cls(creep.R * a, None)
        assert material.conformation is not None
        space = creep_tensors(creep, dim)
        direct = np.zeros((space.size, component_count(material, dim)))
        where = component_slices(material, dim)[material.conformation]
        direct[:, where] = creep.R * b * space.columns.T @ tensor_space("symmetric", dim).columns
        return cls(creep.R * a, direct)

    def __call__(self, against: np.ndarray, zeta: np.ndarray) -> np.ndarray:
        """Pi at points, (components, points), of -M, which is overwritten, and zeta (n, points)."""
        against *= -self.of_mandel
        if self.of_conjugates is not None:
            against += self.of_conjugates @ zeta
        return against


def _constant(array: np.ndarray) -> CoefficientFunction:
    return CF(tuple(float(a) for a in array.ravel()), dims=array.shape)

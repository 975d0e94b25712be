"""The rates of a material's variables as constant tensors.

Rates are affine in z and linear in L and Pi (ngvisco.physics.variables), so that for X = (L, Pi)

    rate(z; X)_n = sum_x X_x (C_xn + sum_m T_xnm z_m)

in components.  The constants are found by evaluating the rates at unit arguments.  L has the dim^2 entries
L_ij, row by row, and L_33 about an axis.  Pi is given by its components in a basis of the trace-free tensors,
or of the symmetric tensors if Pi may have a trace.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import CF

from ngvisco.errors import ParameterError
from ngvisco.physics.material import StateSpace
from ngvisco.physics.pointwise import evaluated
from ngvisco.physics.recording import called
from ngvisco.physics.tensors import (
    IDENTITY,
    Tensor,
    constant,
    embed_gradient,
    symmetric_tensors,
    trace_free_tensors,
)
from ngvisco.physics.variables import Variable

_ROUNDING = 1e-10


@dataclass(frozen=True)
class Openings:
    """A motion at interfaces, linear in L, that strains the bodies in part only (``Material.parted``)."""

    matrix: np.ndarray
    """Map from the entries of L to the velocity gradient of this motion, (dim^2, entries of L, points)."""
    shares: np.ndarray
    """Share of this motion that does not strain each component, (n, points)."""

    def motion(self, X: np.ndarray) -> np.ndarray:
        """The part of a motion X that is this motion at interfaces, (X, points)."""
        motion = np.zeros_like(X)
        motion[: len(self.matrix)] = np.einsum("xyp,yp->xp", self.matrix, X[: self.matrix.shape[1]])
        return motion

    def stress(self, stress: np.ndarray) -> np.ndarray:
        """Derivatives by X, (X, ..., points), of a function; ``stress`` is its slope by this motion."""
        by_X = np.zeros_like(stress)
        by_X[: self.matrix.shape[1]] = np.einsum("x...p,xyp->y...p", stress[: len(self.matrix)], self.matrix)
        return by_X


@dataclass(frozen=True)
class RateTensors:
    """The tensors C (X, n) and T (X, n, n) of the module's docstring, and lists of their non-zero entries."""

    constant: np.ndarray
    linear: np.ndarray
    gradients: int
    """Number of the X that are entries of L; the others are components of Pi."""
    dim: int
    nonlinear_variables: tuple[str, ...] = ()
    """Names of variables whose rates are not affine in z; the tensors do not describe these rates."""

    @staticmethod
    @cache
    def of(
        variables: tuple[Variable, ...], dim: int, has_trace: bool = False, hoop: bool = False
    ) -> RateTensors:
        """The tensors C and T of the rates of ``variables``, from the rates at z = 0 and at unit vectors z.

        ``has_trace`` says whether Pi may have a trace; ``hoop`` says whether L_33 may be nonzero in two
        dimensions. Raises ParameterError, with the variable's name, for a rate that is not linear in L and
        Pi, because such a rate has no stress.
        """
        states, space = StateSpace.of(variables, dim), (trace_free_tensors, symmetric_tensors)[has_trace](dim)
        n, plane = states.size, dim * dim
        g = plane + hoop
        random = np.random.default_rng(0)
        mixed = random.standard_normal(g + space.size)
        at_rest = states.components({v.name: v.from_distortion(IDENTITY) for v in variables})
        count = (2 + int(np.sqrt(n))) ** 2  # z = 0, the unit vectors, and random states
        values = evaluated(lambda z: at_rest, np.zeros((count, n))).T
        values = values + 0.1 * random.standard_normal(values.shape)
        values[:, : n + 1] = np.eye(n, n + 1, 1)

        def rates_by(X: np.ndarray) -> np.ndarray:
            about = CF(float(X[plane])) if hoop else None
            L = embed_gradient(constant(X[:plane].reshape(dim, dim)), dim, about)
            Pi = constant(np.tensordot(X[g:], np.array(space.basis), 1))

            def components(z: Tensor) -> Tensor:
                tensors = states.tensors(lambda: z)
                return states.components({v.name: v.rate(tensors, L, Pi) for v in variables})

            return evaluated(components, values.T).T

        rates, of_mixed = np.array([rates_by(X) for X in np.eye(len(mixed))]), rates_by(mixed)
        result = RateTensors(rates[:, :, 0], rates[:, :, 1 : n + 1] - rates[:, :, :1], g, dim)
        samples, nonlinear = slice(n + 1, None), []
        for v in variables:
            part = states.slices[v.name]
            if _differ(np.tensordot(mixed, rates[:, part], 1), of_mixed[part]):
                expected = (
                    "a rate that is linear in L and Pi together; write any other part of the rate as a term"
                )
                raise ParameterError(f"{type(v).__name__}.rate", v.name, expected)
            if _differ(result.rate(values[:, samples], mixed[:, None])[part], of_mixed[part, samples]):
                nonlinear.append(v.name)
        return replace(result, nonlinear_variables=tuple(nonlinear))

    def by_groups(self, groups: Sequence[Sequence[str]], states: StateSpace) -> RateTensors:
        """The tensors if each group of variables creeps by its own Pi; ``groups`` has names of variables."""
        g, size = self.gradients, len(self.constant) - self.gradients
        masks = np.zeros((len(groups), states.size))
        for mask, names in zip(masks, groups, strict=True):
            for name in names:
                mask[states.slices[name]] = 1.0
        constant = [self.constant[:g], *(self.constant[g : g + size] * mask for mask in masks)]
        linear = [self.linear[:g], *(self.linear[g : g + size] * mask[:, None] for mask in masks)]
        return replace(self, constant=np.concatenate(constant), linear=np.concatenate(linear))

    @property
    def trace(self) -> tuple[int, ...]:
        """Indices of the X that are diagonal entries of L."""
        return (*range(0, self.dim**2, self.dim + 1), *range(self.dim**2, self.gradients))

    def turning(self) -> RateTensors:
        """The part of the rates that the antisymmetric part of L causes."""
        dim = self.dim
        g = dim * dim
        constant, linear = np.zeros_like(self.constant), np.zeros_like(self.linear)
        for whole, part in ((self.constant, constant), (self.linear, linear)):
            of_L = whole[:g].reshape(dim, dim, *whole.shape[1:])
            part[:g] = (0.5 * (of_L - of_L.swapaxes(0, 1))).reshape(whole[:g].shape)
        return replace(self, constant=constant, linear=linear)

    def __sub__(self, other: RateTensors) -> RateTensors:
        return replace(self, constant=self.constant - other.constant, linear=self.linear - other.linear)

    def columns(self, z: np.ndarray) -> np.ndarray:
        """d rate/dX, (points, n, X), at values z, (n, points)."""
        with_one = np.concatenate([z, np.ones((1, z.shape[1]), z.dtype)])
        return self._scattered(2, with_one, self.constant.T.shape)

    def rate(self, z: np.ndarray, X: np.ndarray, first: int = 0) -> np.ndarray:
        """The rate rate(z; X), (n, points), for X (X, points); ``first`` is the index of its first entry."""
        return called(self._rate, z, X, first)

    def _rate(self, z: np.ndarray, X: np.ndarray, first: int) -> np.ndarray:
        out = np.zeros((self.linear.shape[1], z.shape[1]), np.result_type(z, X))
        self._sum(z, first, first + len(X), lambda x, n: (out[n], X[x]))
        return out

    def stress(self, z: np.ndarray, zeta: np.ndarray, first: int, stop: int) -> np.ndarray:
        """d(zeta : rate)/dX for X = first ... stop - 1, (X, points)."""
        return called(self._stress, z, zeta, first, stop)

    def rate_beside(self, openings: Openings | None, z: np.ndarray, X: np.ndarray, first: int) -> np.ndarray:
        """The rate as by ``rate``, without the shares of the openings, for all X."""
        rate = self.rate(z, X, first)
        return rate if openings is None else rate - openings.shares * self.rate(z, openings.motion(X))

    def stress_beside(
        self, openings: Openings | None, z: np.ndarray, zeta: np.ndarray, first: int, stop: int
    ) -> np.ndarray:
        """The stress as by ``stress``, without the shares of the openings, for all X."""
        stress = self.stress(z, zeta, first, stop)
        if openings is None:
            return stress
        return stress - openings.stress(self.stress(z, openings.shares * zeta, first, stop))

    def _stress(self, z: np.ndarray, zeta: np.ndarray, first: int, stop: int) -> np.ndarray:
        out = np.zeros((stop - first, z.shape[1]), np.result_type(z, zeta))
        self._sum(z, first, stop, lambda x, n: (out[x], zeta[n]))
        return out

    def _sum(
        self,
        z: np.ndarray,
        first: int,
        stop: int,
        places: Callable[[int, int], tuple[np.ndarray, np.ndarray]],
    ) -> None:
        """Add (C_xn + sum_m T_xnm z_m) times a factor to a target, for all x and n; ``places(x, n)`` returns
        target and factor."""
        of_constant, of_linear = self._entries_within(first, stop)
        for (x, n), C in of_constant:
            target, factor = places(x - first, n)
            target += C * factor
        product: np.ndarray | None = None
        for (x, n, m), T in of_linear:
            target, factor = places(x - first, n)
            product = np.multiply(factor, z[m], out=product)
            product *= T
            target += product

    def rate_slope(self, X: np.ndarray) -> np.ndarray:
        """d rate(z; X)/dz, (points, n, n), for X (X, points)."""
        return self._scattered(0, X, self.linear.shape[1:])

    def stress_slope(self, zeta: np.ndarray) -> np.ndarray:
        """d^2(zeta : rate)/dX dz, (points, X, n), for zeta (n, points)."""
        return self._scattered(1, zeta, self.linear.shape[:2])

    def _scattered(self, number: int, values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """The product of one of ``_slopes`` with values, (., points), as matrices, (points, *shape)."""
        rows, matrix = self._slopes[number]
        result = np.zeros((values.shape[1], shape[0] * shape[1]), values.dtype)
        result[:, rows] = (matrix @ values).T
        return result.reshape(values.shape[1], *shape)

    def _entries_within(self, first: int, stop: int) -> list[list[tuple[tuple[int, ...], float]]]:
        """Indices and values of the non-zero entries of C and of T with x in first ... stop - 1."""
        if (first, stop) not in self._within:
            self._within[first, stop] = [
                [(tuple(i), float(A[tuple(i)])) for i in np.argwhere(A).tolist() if first <= i[0] < stop]
                for A in (self.constant, self.linear)
            ]
        return self._within[first, stop]

    @cached_property
    def _within(self) -> dict[tuple[int, int], list[list[tuple[tuple[int, ...], float]]]]:
        """The results of ``_entries_within``."""
        return {}

    @cached_property
    def _slopes(self) -> tuple[tuple[np.ndarray, sp.csr_matrix], ...]:
        """T as sparse matrices: from X to (n, m), from n to (X, m), and with C from (m, 1) to (n, X).

        Each matrix is given by the numbers of its non-zero rows, and by these rows.
        """
        by_X, by_zeta = (self.linear.transpose(axes) for axes in ((1, 2, 0), (0, 2, 1)))
        by_z = np.concatenate([self.linear.transpose(1, 0, 2), self.constant.T[:, :, None]], axis=2)
        result = []
        for A in (by_X, by_zeta, by_z):
            flat = A.reshape(-1, A.shape[2])
            rows = np.flatnonzero(flat.any(axis=1))
            result.append((rows, sp.csr_matrix(flat[rows])))
        return tuple(result)


def _differ(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether values differ by more than rounding; pairs without a finite value are not compared."""
    is_finite = np.isfinite(a) | np.isfinite(b)
    return bool((~(abs(a - b) <= _ROUNDING * (1 + abs(a) + abs(b))) & is_finite).any())

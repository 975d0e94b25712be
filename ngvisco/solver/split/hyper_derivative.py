"""The derivative of the hyperviscosity's rows in a direction of (v, a), for the flow's linear system.

Of x = (v, a) a cell sees the coefficients of Hs and the jumps at its sides' points: B x in one small dense
product with all components of v side by side, (cells, rows, dim).  The rows are B^T of what the law makes of
these.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.forms.side_points import SidePoints
from ngvisco.solver.split import precision
from ngvisco.solver.split.hyper import MatrixHyperviscosity, SideJumps
from ngvisco.solver.split.local import LocalMatrix
from ngvisco.threads import product

SIDES = 4
"""Degree of the penalty's rule for k = 2 on straight cells: right for p = 4, where it takes (P_1 jumps)^4.

Means over the sides left an eigenvalue of 0.38 of the preconditioned error on 762 triangles, a rule of
degree 2 one of 0.5 on Netgen's tetrahedra once refined (21 iterations instead of 11 on 1,440 of them).  For
k = 3 a rule with as many points as P_2 has functions leaves 0.5, and steps on curved cells failed with
one: there the rule is that of the forms.
"""


class HyperDerivative:
    """The derivative at the state of the last ``update``."""

    def __init__(self, hyper: MatrixHyperviscosity, exact: bool = False) -> None:
        """``exact`` is by the rule of the forms, whatever the exponent."""
        step = hyper.step
        self.h = hyper
        self.cells = step.mesh.ne
        coarse = not exact and step.discretisation.k == 2 and step.mesh.GetCurveOrder() <= 1
        self.sides = SideJumps(hyper, SidePoints(step.mesh, SIDES)) if coarse else hyper.sides
        self._weights = hyper.points.weights.reshape(self.cells, 1, -1, 1)
        self._volume = hyper.points.weights.max()
        self._side_weights = self.sides.weights.reshape(self.cells, -1)
        self.dtype = np.float64 if exact else precision.SINGLE
        self._values = self._together()
        self._at_points = hyper.h_values.blocks.astype(self.dtype)
        if not hyper.law.is_linear:
            squares = (hyper.s_values.blocks, self.sides.scalar.blocks)
            self._s_points, self._s_sides = (each.astype(self.dtype) for each in squares)
        self._of_hessian = hyper.lift.per_cell

    def _together(self) -> LocalMatrix:
        """B: a cell's coefficients of Hs, components after each other, then its jumps."""
        lift, jump, cells = self.h.lift.matrix, self.sides.matrix, self.cells
        jumps = lift.shape[0] + np.arange(jump.shape[0]).reshape(cells, -1)
        rows = np.concatenate([np.arange(lift.shape[0]).reshape(cells, -1), jumps], axis=1)
        both = sp.vstack([lift, jump], format="csr")
        return LocalMatrix(both[rows.ravel()], cells, keep=False, dtype=self.dtype)

    def update(self) -> None:
        """Linearise at the present state."""
        h, law, sides, cells = self.h, self.h.law, self.sides, self.cells
        if law.is_linear:
            self._c = self._weights * (law.mu + law.mu_1)
            self._penalty = self._side_weights * (sides.penalty * (law.mu + law.mu_1)).reshape(cells, -1)
            self._normalise()
            return
        self._hessian, self._j = self._state()
        q = np.einsum("cpi,cpi->cp", self._j, self._j).ravel()
        self._size = size = sides.scalar(h.s) + q / sides.h**2 + h.term.context.curvature.Get() ** 2
        slope = law.slope(size)
        bend = 0.5 * (law.p - 4) * slope / size * q  # c'' |j|^2
        squared = sides.h**2
        self._c = self._weights * h.s_values(h.c).reshape(self._weights.shape)
        penalty = sides.penalty * (law.coefficient(size) + slope * q / squared)
        self._penalty = self._side_weights * penalty.reshape(cells, -1)
        # second derivatives by s = P |Hs|^2 and q = |j|^2, tested with these: the same both ways
        weighted = self._side_weights * sides.penalty.reshape(cells, -1)
        self._s_slope = self._weights[:, 0] * law.slope(h.s_values(h.s)).reshape(cells, -1, 1)
        self._ss = weighted * bend.reshape(cells, -1)
        self._sq = weighted * (slope + bend / squared).reshape(cells, -1)
        self._qq = weighted * ((2 * slope + bend / squared) / squared).reshape(cells, -1)
        self._normalise()

    def _normalise(self) -> None:
        """Measure all in units of its own and round it: in SI units numbers may leave single precision."""
        self._unit = unit = _largest(self._c)
        units = {"_c": unit, "_penalty": unit}
        if not self.h.law.is_linear:
            H, j = _largest(self._hessian), _largest(self._j)
            units |= {"_hessian": H, "_j": j}
            units |= {"_s_slope": unit / H**2, "_ss": unit / H**2, "_sq": unit / (H * j), "_qq": unit / j**2}
        for name, size in units.items():
            setattr(self, name, (getattr(self, name) / size).astype(self.dtype))

    def _state(self) -> tuple[np.ndarray, np.ndarray]:
        """The present Hs and jumps as ``_parts`` has them."""
        h, dim = self.h, self.h.dim
        values = h.h_values(h.hess).reshape(dim, h.size, self.cells, -1)
        jumps = h.j if self.sides is h.sides else self.sides.jump(np.concatenate([h.v, h.a], axis=1))
        return values.transpose(2, 1, 3, 0), jumps.reshape(dim, self.cells, -1).transpose(1, 2, 0)

    def _parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of B x: Hs at the points, (cells, components, points, dim), and jumps, (cells, points, dim)."""
        split, shape = self._of_hessian, (self.cells, self.h.size, -1, values.shape[2])
        return _at_each(self._at_points, values[:, :split].reshape(shape)), values[:, split:]

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The rows' derivative in the direction x = (v, a) side by side, (dim, unknowns)."""
        length = _largest(x)
        values = self._values.by_cells(x.T / length)
        dH, dj = self._parts(values)
        of_H, of_j = self._c * dH, self._penalty[..., None] * dj
        if not self.h.law.is_linear:
            self._bend(dH, dj, of_H, of_j)
        loads, split = np.empty_like(values), self._of_hessian
        tested = _at_each(self._at_points.transpose(0, 2, 1), of_H)
        loads[:, :split] = tested.reshape(self.cells, split, -1)
        loads[:, split:] = of_j
        return np.float64(self._unit * length) * self._values.tested(loads).T

    def _bend(self, dH: np.ndarray, dj: np.ndarray, of_H: np.ndarray, of_j: np.ndarray) -> None:
        """Add what the changes of s = P |Hs|^2 and of q = |j|^2 make, to the loads of Hs and j."""
        at_points, at_sides = self._s_points, self._s_sides
        w = (self._weights[:, 0, :, 0] / self._volume).astype(self.dtype)
        dq = 2 * np.einsum("cpi,cpi->cp", self._j, dj)
        tested = (2 * w) * np.einsum("cbpi,cbpi->cp", self._hessian, dH)
        ds = self._projected(_transposed(at_points, tested))
        ds_sides = product(at_sides, ds)[..., 0]
        of_j += (self._sq * ds_sides + self._qq * dq)[..., None] * self._j
        # the coefficient's change: c_s = P c(s) + facets
        dc = _transposed(at_points, (self._s_slope * product(at_points, ds))[..., 0])
        dc += _transposed(at_sides, self._ss * ds_sides + self._sq * dq)
        change = product(at_points, self._projected(dc))[..., 0] * w
        of_H += self._hessian * change[:, None, :, None]

    def _projected(self, loads: np.ndarray) -> np.ndarray:
        """Coefficients of a projection from its loads, (cells, functions, 1), over the largest weight."""
        return (self.h.s_inverse(loads.ravel()) * self._volume).reshape(loads.shape).astype(self.dtype)

    def tangent_coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of |Hs|^2, (cells,), and of the penalty, (sides' points,), for ``HyperTangent``."""
        h, law, sides = self.h, self.h.law, self.sides
        if law.is_linear:
            return np.full(h.step.mesh.ne, law.mu + law.mu_1), sides.penalty * (law.mu + law.mu_1)
        weights = h.points.weights.reshape(h.step.mesh.ne, -1)
        c = (h.s_values(h.c).reshape(weights.shape) * weights).sum(axis=1) / weights.sum(axis=1)
        c_penalty = law.coefficient(np.maximum(self._size, 0))
        stretch = 0.5 * law.p
        c, c_penalty = (law.mu_1 + stretch * (np.maximum(each, 0) - law.mu_1) for each in (c, c_penalty))
        return c, sides.penalty * c_penalty


def _largest(values: np.ndarray) -> float:
    """The largest modulus, 1 where all are zero."""
    return float(abs(values).max(initial=0.0)) or 1.0


def _transposed(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Transposes of stacked matrices (cells, i, j) times values (cells, i): (cells, j, 1)."""
    return product(matrices.transpose(0, 2, 1), values[..., None])


def _at_each(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Matrices (cells, i, j) times values of each component, (cells, components, j, dim)."""
    if matrices.shape[1:] == (1, 1):
        return matrices[..., None] * values
    return matrices[:, None] @ values

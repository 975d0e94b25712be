"""The hyperviscosity's derivative in a direction of (v, a), for the flow's linear system, and its tangent.

Of x = (v, a) a cell sees the coefficients of Hs and the jumps at its sides' points: B x in one small dense
product with all components of v at once, (cells, dim, rows): with points last, sums are as fast as memory.
The rows are B^T of what the law makes of these.  In the velocity tangent a is eliminated; on facets between
ranks, of which each sees one side, a stays an unknown of it: its matrix is then the sum of what the ranks'
cells make of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.local import LocalMatrix
from ngvisco.algebra.sparse import ElementAssembly, Rounded, largest
from ngvisco.forms.mesh.side_points import SidePoints
from ngvisco.physics.arrays import Array
from ngvisco.reduced.hyperviscosity import HyperValues, MatrixHyperviscosity, SideJumps, value_of
from ngvisco.threads import product


class HyperDerivative:
    """The derivative at the state of the last ``update``."""

    def __init__(self, hyper: MatrixHyperviscosity, penalty_degree: int) -> None:
        step = hyper.step
        self.hyper = hyper
        self.cells = step.mesh.ne
        coarse = step.discretisation.k == 2 and step.mesh.GetCurveOrder() <= 1
        self.sides = SideJumps(hyper, SidePoints(step.mesh, penalty_degree)) if coarse else hyper.sides
        self._weights = hyper.points.weights.reshape(self.cells, 1, 1, hyper.h_values.per_cell)
        self._volume = hyper.points.weights.max(initial=0.0) or 1.0
        self._side_weights = self.sides.weights.reshape(self.cells, self.sides.jump.per_cell)
        self.dtype = precision.SINGLE
        self.of_component = self._together()
        self._at_points = hyper.h_values.blocks.swapaxes(1, 2).astype(self.dtype)
        if not hyper.law.is_linear:
            squares = (hyper.s_values.blocks, self.sides.scalar.blocks)
            self._s_points, self._s_sides = (each.astype(self.dtype) for each in squares)
        self._of_hessian = hyper.lift.per_cell

    def _together(self) -> LocalMatrix:
        """B: a cell's coefficients of Hs, components after each other, then its jumps."""
        lift, jump, cells = self.hyper.lift.matrix, self.sides.jump.matrix, self.cells
        per_cell = self.hyper.lift.per_cell, self.sides.jump.per_cell
        jumps = lift.shape[0] + np.arange(jump.shape[0]).reshape(cells, per_cell[1])
        rows = np.concatenate([np.arange(lift.shape[0]).reshape(cells, per_cell[0]), jumps], axis=1)
        both = sp.vstack([lift, jump], format="csr")
        return LocalMatrix(both[rows.ravel()], cells, dtype=self.dtype)

    def update(self, at: HyperValues) -> None:
        """Linearise at some values."""
        h, law, sides, cells = self.hyper, self.hyper.law, self.sides, self.cells
        tensors, shape = h.tensors(at.z), self._side_weights.shape
        jumps = at.jumps if sides is h.sides else sides.jump(at.x)
        self._at, self._on_sides = at, sides.values(jumps, at.square, at.z)
        if at.square is None or at.coefficient is None:
            linear = np.broadcast_to(value_of(law.linear(tensors)), h.points.count)
            self._c = self._weights * linear.reshape(self._weights.shape)
            penalty, _ = h.term.penalty(self._on_sides)
            self._penalty = self._side_weights * value_of(penalty).reshape(shape)
            self._normalise()
            return
        hessian = h.h_values(at.hess).reshape(h.dim, h.size, cells, h.h_values.per_cell)
        self._hessian, self._j = hessian.transpose(2, 0, 1, 3), jumps.reshape(h.dim, *shape).swapaxes(0, 1)
        size, z, squared = h.term.size(self._on_sides), self._on_sides.z_tensors, sides.h**2
        weight = law.penalty / sides.h
        q = np.einsum("cip,cip->cp", self._j, self._j).ravel()
        slope = weight * law.slope(size, z).value
        bend = 0.5 * (law.p - 4) * slope / size.value * q  # c'' |j|^2
        self._c = self._weights * h.s_values(at.coefficient).reshape(self._weights.shape)
        self._penalty = self._side_weights * h.term.stiffness(self._on_sides).value.reshape(shape)
        # second derivatives by s = P |Hs|^2 and q = |j|^2, tested with these: the same both ways
        s_slope = law.slope(Array(h.s_values(at.square), None), tensors).value
        self._s_slope = self._weights[:, 0, 0] * s_slope.reshape(cells, h.h_values.per_cell)
        self._ss = self._side_weights * bend.reshape(shape)
        self._sq = self._side_weights * (slope + bend / squared).reshape(shape)
        self._qq = self._side_weights * ((2 * slope + bend / squared) / squared).reshape(shape)
        self._normalise()

    def _normalise(self) -> None:
        """Measure all in units of its own and round it: in SI units numbers may leave single precision."""
        self._unit = unit = largest(self._c)
        units = {"_c": unit, "_penalty": unit}
        if not self.hyper.law.is_linear:
            H, j = largest(self._hessian), largest(self._j)
            units |= {"_hessian": H, "_j": j}
            units |= {"_s_slope": unit / H**2, "_ss": unit / H**2, "_sq": unit / (H * j), "_qq": unit / j**2}
        for name, size in units.items():
            setattr(self, name, (getattr(self, name) / size).astype(self.dtype))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The rows' derivative in the direction x = (v, a) side by side, (dim, unknowns)."""
        length, split, h = largest(x), self._of_hessian, self.hyper
        values = self.of_component.by_cells(x.T / length)
        dj, rows = values[..., split:], (self.cells, h.dim * h.size)
        dH = product(values[..., :split].reshape(*rows, h.h_values.local), self._at_points)
        dH = dH.reshape(self.cells, h.dim, h.size, h.h_values.per_cell)
        of_H, of_j = self._c * dH, self._penalty[:, None] * dj
        if not h.law.is_linear:
            self._bend(dH, dj, of_H, of_j)
        tested = product(of_H.reshape(*rows, h.h_values.per_cell), self._at_points.swapaxes(1, 2))
        loads = np.concatenate([tested.reshape(self.cells, h.dim, split), of_j], axis=2)
        return np.float64(self._unit * length) * self.of_component.tested(loads).T

    def _bend(self, dH: np.ndarray, dj: np.ndarray, of_H: np.ndarray, of_j: np.ndarray) -> None:
        """Add what the changes of s = P |Hs|^2 and of q = |j|^2 make, to the loads of Hs and j."""
        at_points, at_sides = self._s_points, self._s_sides
        w = (self._weights[:, 0, 0] / self._volume).astype(self.dtype)
        dq = 2 * np.einsum("cip,cip->cp", self._j, dj)
        tested = (2 * w) * np.einsum("cibp,cibp->cp", self._hessian, dH)
        ds = self._projected(_transposed(at_points, tested))
        ds_sides = product(at_sides, ds)[..., 0]
        of_j += (self._sq * ds_sides + self._qq * dq)[:, None] * self._j
        # the coefficient's change: c_s = P c(s) + facets
        dc = _transposed(at_points, self._s_slope * product(at_points, ds)[..., 0])
        dc += _transposed(at_sides, self._ss * ds_sides + self._sq * dq)
        change = product(at_points, self._projected(dc))[..., 0] * w
        of_H += self._hessian * change[:, None, None]

    def _projected(self, loads: np.ndarray) -> np.ndarray:
        """Coefficients of a projection from its loads, (cells, functions, 1), over the largest weight."""
        return (self.hyper.s_inverse(loads.ravel()) * self._volume).reshape(loads.shape).astype(self.dtype)

    def tangent_coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of |Hs|^2, (cells,), and of the penalty, (sides' points,), for ``HyperTangent``."""
        h, law, at, sides = self.hyper, self.hyper.law, self._at, self.sides
        weights = h.points.weights.reshape(self.cells, h.h_values.per_cell)

        def mean(values: Any) -> np.ndarray:
            return (np.broadcast_to(value_of(values), h.points.count).reshape(weights.shape) * weights).sum(
                axis=1
            ) / weights.sum(axis=1)

        in_cells, on_sides = h.tensors(at.z), self._on_sides.z_tensors
        if at.coefficient is None:
            penalty, _ = h.term.penalty(self._on_sides)
            return mean(law.linear(in_cells)), np.broadcast_to(value_of(penalty), sides.h.shape)
        c, c_penalty = (
            mean(h.s_values(at.coefficient)),
            law.coefficient(h.term.size(self._on_sides), on_sides),
        )
        mu_1, mu_1_on_sides = mean(law.moduli(in_cells)[1]), value_of(law.moduli(on_sides)[1])
        stretch = 0.5 * law.p
        c = mu_1 + stretch * (np.maximum(c, 0) - mu_1)
        stretched = mu_1_on_sides + stretch * (np.maximum(c_penalty.value, 0) - mu_1_on_sides)
        return c, law.penalty / sides.h * stretched


def _transposed(matrices: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Transposes of stacked matrices (cells, i, j) times values (cells, i): (cells, j, 1)."""
    return product(matrices.transpose(0, 2, 1), values[..., None])


class HyperTangent:
    """The hyperviscosity's second derivative in v and the kept a, with a = E v elsewhere, and facets' blocks.

    The coefficient is c + (c - mu_1)(p - 2)/2: in the middle between the smallest and the largest
    eigenvalue of the second derivative of |.|^p/p, which couples the components of v.
    """

    def __init__(self, derivative: HyperDerivative, kept: np.ndarray) -> None:
        """``kept`` are the unknowns of a component of a that are not eliminated."""
        self.derivative, self.kept = derivative, kept
        values, h = derivative.of_component, derivative.hyper
        count = values.width - h.velocities
        self.eliminated = np.setdiff1d(np.arange(count), kept)
        order = np.concatenate([np.arange(h.velocities), h.velocities + kept, h.velocities + self.eliminated])
        number = np.empty_like(order)
        number[order] = np.arange(len(order))
        self._assembled = ElementAssembly(number[values.unknowns], values.width)
        lifted, self._jump = np.split(values.blocks, [h.lift.per_cell], axis=1)
        lifted = lifted.reshape(values.cells, h.size, h.h_values.local, values.local)
        at_points = h.h_values.blocks[:, None] @ lifted
        of_each = at_points.reshape(values.cells, h.size * h.h_values.per_cell, values.local)
        weights = np.tile(h.points.weights.reshape(values.cells, h.h_values.per_cell), (1, h.size))
        self._of_hessians = _squared(of_each, weights).astype(precision.SINGLE)
        """Cells' matrices of |Hs|^2."""
        pattern = _squared(abs(self._jump), np.ones(self._jump.shape[:2]))
        self._facets = BlockInverse(self._in_parts(pattern)[2])

    def _in_parts(self, elements: np.ndarray) -> tuple[sp.csr_matrix, sp.csr_matrix, sp.csr_matrix]:
        """Of v with the kept a by these and by the other a, and of the others, of a sum over the cells."""
        matrix, n = self._assembled(elements), self._assembled.width - len(self.eliminated)
        return matrix[:n, :n], matrix[:n, n:], matrix[n:, n:]

    def update(self) -> None:
        """Form E, the matrix of v and the facets' blocks where the derivative was last updated."""
        cell, penalty = self.derivative.tangent_coefficients()
        weights = (self.derivative.sides.weights * penalty).reshape(self._jump.shape[:2])
        of_jumps = _squared(self._jump, weights)
        _, coupling, facets = self._in_parts(of_jumps)
        self._facets.update(facets)
        E = -(self._facets.matrix() @ coupling.T).tocsr()
        self.E_t = Rounded(E.T)
        own, coupling, others = self._in_parts(of_jumps + cell[:, None, None] * self._of_hessians)
        cross = (coupling.T + others @ E).tocsr()
        self.matrix = (own + coupling @ E + E.T @ cross).tocsr()
        self._facets.update(others)
        # a = E v + (blocks)^{-1} (r - cross v), v with the kept a
        of_rows = self._facets.matrix()
        self.of_velocity, self.of_rows = Rounded(E - of_rows @ cross), Rounded(of_rows)

    def bordered(self, matrix: sp.csr_matrix, dim: int) -> sp.csr_matrix:
        """A matrix of the flow's unknowns, v's components first, with rows and columns of the kept a."""
        own, each = self.matrix, sp.identity(dim)
        width = own.shape[0] - len(self.kept)
        others, count = matrix.shape[0] - dim * width, dim * len(self.kept)
        right = sp.vstack([sp.kron(each, own[:width, width:]), sp.csr_matrix((others, count))])
        below = sp.hstack([sp.kron(each, own[width:, :width]), sp.csr_matrix((count, others))])
        return sp.bmat([[matrix, right], [below, sp.kron(each, own[width:, width:])]], format="csr")


def _squared(matrices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """B^T W B of stacked matrices B and weights of their rows, (cells, rows)."""
    return product(matrices.transpose(0, 2, 1), weights[:, :, None] * matrices)

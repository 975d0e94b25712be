"""The hyperviscosity's derivative in a direction (dv, da), for the flow's linear system, and its tangent.

The unknowns a are the normal derivatives of v on facets. In a cell the law depends on x = (v, a) through B x:
the coefficients of Hs, and the jumps at the sides' points. One small dense product gives B x for all
components of v, (cells, dim, rows).  Arrays have the points last, so that sums run at the speed of memory.
The rows of (v, a) are B^T times the law's derivative by B x.

On small meshes in 2D, the velocity tangent contains the whole derivative (``hyper_matrix``). On other meshes
(``HyperTangent``), it eliminates the unknowns a, except on facets between ranks. On these facets each rank
has one side, and the unknowns a are kept, so that the matrix is a sum over the ranks' cells.

The derivative is written by hand, since complex increments of the rows take 3 to 5 times as long
(``tests/benchmarks/kernels.py``). ``tests/solver/test_split_solver.py`` compares the derivative with the
rows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.algebra.local import LocalMatrix, squared
from ngvisco.algebra.sparse import Blocks, ElementAssembly, Rounded, largest
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import SidePoints
from ngvisco.physics.arrays import Array
from ngvisco.reduced.hyperviscosity import HyperValues, MatrixHyperviscosity, SideJumps, value_of
from ngvisco.reduced.operators import PointOperators
from ngvisco.reduced.residual import parts_of


class HyperDerivative:
    """Applies the hyperviscosity's derivative at the values of the last ``update``."""

    def __init__(self, hyper: MatrixHyperviscosity, penalty_degree: int) -> None:
        step = hyper.step
        self.hyper, self.cells, self.dtype = hyper, step.mesh.ne, precision.SINGLE
        self.sides = hyper.sides
        if step.discretisation.k == 2 and step.mesh.GetCurveOrder() <= 1:
            points = SidePoints(step.mesh, penalty_degree, step.layout.symmetry)
            sides = PointOperators(step, points, points.per_cell, hyper.sides.op)
            self.sides = SideJumps(hyper, sides, hyper.sides)
        self.weights = hyper.op.weights.reshape(self.cells, hyper.h_values.per_cell)
        self.side_weights = self.sides.weights.reshape(self.cells, self.sides.jump.per_cell)
        self._volume = self.weights.max(initial=0.0) or 1.0
        self.of_component = self._together()
        self._at_points = _Interpolated(hyper.h_values.blocks)
        if not hyper.law.is_linear:
            self._s_points = _Interpolated(hyper.s_values.blocks)
            self._s_sides = _Interpolated(self.sides.scalar.blocks)
            self._shares = (shares := self.weights / self._volume).astype(self.dtype)[:, None]
            self._s_inverse = np.linalg.inv(squared(hyper.s_values.blocks, None, shares)).astype(self.dtype)

    def _together(self) -> LocalMatrix:
        """The matrix B of the module's docstring.

        The rows of a cell are the coefficients of Hs, component by component, then the jumps at the nodes of
        the cell's sides.
        """
        parts = (self.hyper.lift.matrix, self.sides.jump.at_nodes)
        of_parts = np.split(np.arange(sum(part.shape[0] for part in parts)), [parts[0].shape[0]])
        order = [rows.reshape(self.cells, len(rows) // max(self.cells, 1)) for rows in of_parts]
        both = sp.vstack(parts, format="csr")[np.concatenate(order, axis=1).ravel()]
        return LocalMatrix(both, self.cells, dtype=self.dtype)

    def update(self, at: HyperValues) -> None:
        """Linearise at the given values."""
        h, law, sides, weights = self.hyper, self.hyper.law, self.sides, self.weights
        shape, hess_square = self.side_weights.shape, at.local.get("hess_square")
        on_sides = self._on_sides(at)
        c = value_of(law.linear(h.tensors(at.z))) if law.is_linear else self._coefficient(at)
        c = weights * np.broadcast_to(c, h.op.points.count).reshape(weights.shape)
        penalty = np.broadcast_to(value_of(h.term.stiffness(on_sides)), sides.h.shape)
        self._unit = unit = largest(c)

        def rounded(values: np.ndarray, unit: float) -> np.ndarray:
            """Divide by ``unit``, because numbers in SI units may exceed the range of single precision; add
            an axis for components."""
            return (values / unit).astype(self.dtype)[:, None]

        def of_sides(values: np.ndarray, unit: float) -> np.ndarray:
            return rounded(self.side_weights * values.reshape(shape), unit)

        self._c, self._penalty = rounded(c, unit), of_sides(penalty, unit)
        if hess_square is None:
            return
        hessian = h.h_values(at.local["hess"]).reshape(h.dim * h.size, *weights.shape).swapaxes(0, 1)
        j = on_sides.jump.value.reshape(h.dim, *shape).swapaxes(0, 1)
        H, J = largest(hessian), largest(j)
        self._hessian, self._j = ((part / unit).astype(self.dtype) for part, unit in ((hessian, H), (j, J)))
        size, squared_h = h.term.size(on_sides).value, sides.h**2
        slope = h.term.penalty_slope(on_sides).value
        bend = 0.5 * (law.p - 4) * slope / size * np.einsum("cip,cip->cp", j, j).ravel()  # c'' |j|^2
        # second derivatives by s = P |Hs|^2 and q = |j|^2, a symmetric matrix
        s_slope = law.slope(Array(h.s_values(hess_square), None), h.tensors(at.z)).value
        self._s_slope = rounded(weights * s_slope.reshape(weights.shape), unit / H**2)
        of_s = slope + bend / squared_h
        self._ss, self._sq = of_sides(bend, unit / H**2), of_sides(of_s, unit / (H * J))
        self._qq = of_sides((slope + of_s) / squared_h, unit / J**2)

    def _on_sides(self, at: HyperValues) -> Fields:
        jumps = at.jumps if self.sides is self.hyper.sides else self.sides.jump(at.x)
        return self.sides.values(jumps, at.local.get("hess_square"), at.z)

    def _coefficient(self, at: HyperValues) -> np.ndarray:
        """c_s at the cells' points."""
        return self.hyper.s_values(at.local["hyper_coefficient"])

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The rows' derivative in the direction x = (v, a) side by side, (dim, unknowns)."""
        length = largest(x)
        loads = self._loads(self.of_component.by_cells(x.T / length))
        return np.float64(self._unit * length) * self.of_component.tested(loads).T

    def elements(self) -> np.ndarray:
        """The derivative as element matrices, (cells, dim local, dim local). A cell's unknowns (v, a) are
        ordered by components and then functions."""
        nodal, d = self.of_component.nodal, self.hyper.dim
        along = np.eye(d, dtype=self.dtype)[:, None, None, :, None] * nodal.swapaxes(0, 1)[:, :, None]
        columns = np.matmul(self._loads(along), nodal.swapaxes(1, 2))  # (dim, local, cells, dim, local)
        return self._unit * columns.reshape(-1, self.cells, d * nodal.shape[1]).swapaxes(0, 1).astype(float)

    def _loads(self, values: np.ndarray) -> np.ndarray:
        """The law's derivative by B x in the direction ``values``, both (..., cells, dim, rows)."""
        h, split = self.hyper, self.hyper.lift.per_cell
        dj = self.sides.jump.from_nodes(values[..., split:])
        lifted = values[..., :split].reshape(*values.shape[:-2], h.dim * h.size, h.h_values.local)
        dH = self._at_points(lifted)
        of_H, of_j = self._c * dH, self._penalty * dj
        if not h.law.is_linear:
            self._bend(dH, dj, of_H, of_j)
        tested = self._at_points.tested(of_H).reshape(*values.shape[:-1], split)
        return np.concatenate([tested, self.sides.jump.to_nodes(of_j)], axis=-1)

    def _bend(self, dH: np.ndarray, dj: np.ndarray, of_H: np.ndarray, of_j: np.ndarray) -> None:
        """Add to the loads of Hs and j the contributions of changes of s = P |Hs|^2 and q = |j|^2."""
        at_points, at_sides = self._s_points, self._s_sides
        w = self._shares
        dq = 2 * np.einsum("cip,...cip->...cp", self._j, dj)[..., None, :]
        tested = 2 * w * np.einsum("cip,...cip->...cp", self._hessian, dH)[..., None, :]
        ds = np.matmul(at_points.tested(tested), self._s_inverse)
        ds_sides = at_sides(ds)
        of_j += (self._sq * ds_sides + self._qq * dq) * self._j
        # the change of the coefficient c_s = P c(s) + facets
        dc = at_points.tested(self._s_slope * at_points(ds))
        dc += at_sides.tested(self._ss * ds_sides + self._sq * dq)
        of_H += self._hessian * (w * at_points(np.matmul(dc, self._s_inverse)))

    def tangent_coefficients(self, at: HyperValues) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of |Hs|^2, (cells,), and of the penalty, (sides' points,), for ``HyperTangent``.

        The second derivative of |.|^p/p couples the components of v, and the tangent has no such coupling.
        Each coefficient is the mean of the smallest and the largest eigenvalue of this second derivative,
        c + (c - mu_1)(p - 2)/2.
        """
        h, law, sides, values = self.hyper, self.hyper.law, self.sides, self._on_sides(at)
        in_cells, z_on_sides = h.tensors(at.z), values.z_tensors
        if law.is_linear:
            c, on_sides = law.linear(in_cells), value_of(law.linear(z_on_sides))
        else:
            c, on_sides = self._coefficient(at), law.coefficient(h.term.size(values), z_on_sides).value

        def mean(values: Any) -> np.ndarray:
            at_points = np.broadcast_to(value_of(values), h.op.points.count).reshape(self.weights.shape)
            return (at_points * self.weights).sum(axis=1) / self.weights.sum(axis=1)

        def stretched(c: np.ndarray, mu_1: np.ndarray) -> np.ndarray:
            return mu_1 + 0.5 * law.p * (np.maximum(c, 0) - mu_1)

        penalty = law.penalty / sides.h * stretched(on_sides, value_of(law.moduli(z_on_sides)[1]))
        return stretched(mean(c), mean(law.moduli(in_cells)[1])), penalty


class _Interpolated:
    """Maps coefficients to values at points by the matrices ``blocks``, (cells, points, functions).

    ``tested`` is the transpose of the map.
    A single constant function is handled without matrix products.
    """

    def __init__(self, blocks: np.ndarray) -> None:
        self._blocks = None if blocks.shape[2] == 1 and (blocks == 1.0).all() else precision.single(blocks)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Coefficients (..., cells, n, functions) to values (..., cells, n, points), or (..., cells, n, 1) if
        constant."""
        return x if self._blocks is None else np.matmul(x, self._blocks.swapaxes(1, 2))

    def tested(self, values: np.ndarray) -> np.ndarray:
        """Values (..., cells, n, points) to sums (..., cells, n, functions)."""
        return values.sum(axis=-1, keepdims=True) if self._blocks is None else np.matmul(values, self._blocks)


class HyperTangent:
    """The hyperviscosity's tangent in v and the kept unknowns of a. All other unknowns of a are E v."""

    def __init__(self, derivative: HyperDerivative, kept: np.ndarray) -> None:
        """``kept`` are the numbers of the unknowns of one component of a that are not eliminated."""
        self.derivative, self.kept = derivative, kept
        values, h = derivative.of_component, derivative.hyper
        others = np.setdiff1d(np.arange(values.width - h.velocities), kept)
        self.eliminated = others if len(kept) else slice(None)
        number = np.argsort(np.concatenate([np.arange(h.velocities), h.velocities + np.r_[kept, others]]))
        self._assembled = ElementAssembly(number[values.unknowns], values.width)
        self._lifted, self._jump = np.split(values.blocks, [h.lift.per_cell], axis=1)
        pattern = squared(abs(self._jump), None, np.ones(self._jump.shape[:2]))
        self._facets = Blocks(self._in_parts(self._assembled(pattern))[2])

    def _in_parts(self, matrix: sp.csr_matrix) -> tuple[sp.csr_matrix, sp.csr_matrix, sp.csr_matrix]:
        """The block of (v, kept a), its coupling to the eliminated a, and the block of the eliminated a."""
        n = self.derivative.hyper.velocities + len(self.kept)
        return matrix[:n, :n], matrix[:n, n:], matrix[n:, n:]

    def _add_hessians(self, elements: np.ndarray, cell: np.ndarray) -> None:
        """Add the element matrices of the quadratic form |Hs|^2 with coefficients (cells,)."""
        derivative, values = self.derivative, self.derivative.hyper.h_values
        size, width = derivative.hyper.size, self._lifted.shape[2]
        for cells in parts_of(len(cell), size * values.per_cell):
            lifted = self._lifted[cells].reshape(-1, size, values.local, width)
            in_cells = values.part(cells).blocks[:, None] @ lifted
            weights = np.tile(cell[cells, None] * derivative.weights[cells], (1, size))
            elements[cells] += squared(in_cells.reshape(*weights.shape, width), None, weights)

    def update(self, at: HyperValues) -> sp.csr_matrix:
        """Form E and the facets' blocks at some values; return the matrix of v and the kept a."""
        # the last update's maps are freed before new maps take memory
        self.E_t = self.of_velocity = self.of_rows = Rounded(sp.csr_matrix((0, 0)))
        cell, penalty = self.derivative.tangent_coefficients(at)
        weights, jumps = self.derivative.side_weights, self.derivative.sides.jump
        elements = squared(self._jump, jumps.shape, weights * penalty.reshape(weights.shape))
        _, coupling, facets = self._in_parts(self._assembled(elements))
        E = -(self._facets.inverse(facets) @ coupling.T).tocsr()
        self.E_t = Rounded(E.T)
        del coupling, facets
        self._add_hessians(elements, cell)
        assembled = self._assembled(elements)
        del elements
        of_v, coupling, of_rest = self._in_parts(assembled)
        del assembled
        cross = (coupling.T + of_rest @ E).tocsr()
        matrix: sp.csr_matrix = (of_v + coupling @ E + E.T @ cross).tocsr()
        # a = E v + (blocks)^{-1} (r - cross v), where v includes the kept a
        of_rows = self._facets.inverse(of_rest)
        self.of_velocity, self.of_rows = Rounded(E - of_rows @ cross), Rounded(of_rows)
        return matrix

    def bordered(self, matrix: sp.csr_matrix, tangent: sp.csr_matrix, dim: int) -> sp.csr_matrix:
        """Append rows and columns of the kept unknowns a to ``matrix``, whose unknowns are the flow's,
        beginning with the components of v.

        ``tangent`` is the matrix of one component of v and of the kept unknowns a.
        """
        identity = sp.identity(dim)
        width = tangent.shape[0] - len(self.kept)
        beside, count = matrix.shape[0] - dim * width, dim * len(self.kept)
        right = sp.vstack([sp.kron(identity, tangent[:width, width:]), sp.csr_matrix((beside, count))])
        below = sp.hstack([sp.kron(identity, tangent[width:, :width]), sp.csr_matrix((count, beside))])
        return sp.bmat([[matrix, right], [below, sp.kron(identity, tangent[width:, width:])]], format="csr")


def hyper_matrix(derivative: HyperDerivative, count: int) -> Callable[[], sp.csr_matrix]:
    """A function that returns the derivative, at the values of its last update, as a matrix of the flow's
    unknowns and the normal derivatives a; the first ``count`` unknowns are the flow's, beginning with v."""
    values, dim, velocities = derivative.of_component, derivative.hyper.dim, derivative.hyper.velocities
    of_v, of_a = np.arange(dim * velocities), np.arange(count, count + dim * (values.width - velocities))
    number = np.concatenate([of_v.reshape(dim, -1), of_a.reshape(dim, -1)], axis=1)
    unknowns = np.concatenate([of_component[values.unknowns] for of_component in number], axis=1)
    assembled = ElementAssembly(unknowns, count + of_a.size)
    return lambda: assembled(derivative.elements())

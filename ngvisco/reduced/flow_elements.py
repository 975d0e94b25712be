"""Element matrices of the flow's operator: of v, from v to the fields' rows, and back from the fields to v.

A product of the operator is then three small dense products a cell, whatever the number of points.  In a
cell, v's increment is ordered by components and functions, (dim, local), its rows by functions and
components, (local, dim), the fields by functions and components, (q, n): orders in which the matrices come
out of their products.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra import precision
from ngvisco.reduced.operators import Operators
from ngvisco.reduced.point_tangent import PointTangent
from ngvisco.threads import product


class FlowElements:
    """The element matrices at the state of the last ``update``."""

    def __init__(self, points: PointTangent, fine: Operators) -> None:
        """``points`` has the rule of the matrices, ``fine`` that of inertia."""
        self.tangent, self.fine = points, fine
        op = points.op
        self.cells, self.per, self.local, self.functions = op.v.cells, op.v.per_cell, op.v.local, op.z.local
        self.dim, self.components = len(op.dv), points.components
        # of a periodic strip of one cell, which has an unknown twice, by blocks that are filled up with zeros
        self.dofs, count = op.v.unknowns, self.cells * self.per
        shapes = np.stack([each.blocks.reshape(count, self.local) for each in (op.v, *op.dv)], axis=1)
        self.shapes = shapes.astype(precision.SINGLE)  # (points, 1 + d, local)
        tests = (shapes * op.weights[:, None, None]).reshape(
            self.cells, self.per * (1 + self.dim), self.local
        )
        self._tests = _single(tests.transpose(0, 2, 1))  # (cells, local, points (1 + d))
        z_tests = op.z.blocks * op.weights.reshape(self.cells, self.per, 1)
        self._z_tests = _single(z_tests.transpose(0, 2, 1))  # (cells, q, points)
        places = np.arange(self.dofs.size)
        ones = np.ones(places.size)
        self._scatter = sp.csr_matrix(
            (ones.astype(precision.SINGLE), (self.dofs.ravel(), places)), shape=(op.v.width, places.size)
        )

    def update(self, base: np.ndarray, inertia: np.ndarray) -> None:
        """``base`` is dR/d(v, grad v) without the fields, (points, 0 or 1 + j, i, k, 0 or 1 + l).

        ``inertia`` are the coefficients of w . dv at the points of the fine rule, (points,).
        """
        cells, d, n, local, q, p = (
            self.cells,
            self.dim,
            self.components,
            self.local,
            self.functions,
            self.tangent,
        )
        right = product(_single(base).reshape(len(base), (1 + d) * d**2, 1 + d), self.shapes)
        # rows of v and of the fields, one matrix a cell: what an increment of v makes is one product
        self.of_velocity = np.empty((cells, local * d + q * n, d * local), precision.SINGLE)
        own = product(self._tests, right.reshape(cells, self.per * (1 + d), d * d * local))
        own = own.reshape(cells, local, d, d, local)
        mass = self._inertia(inertia)
        for i in range(d):
            own[:, :, i, i] += mass
        self.own[...] = own.reshape(cells, local * d, d * local)
        # z's rows from (v, grad v): - rate(z; grad dv) + (dv . grad) z
        to_z = np.empty((len(base), n, d, 1 + d), precision.SINGLE)
        to_z[..., 0] = p.dz.transpose(2, 0, 1)
        to_z[..., 1:] = -p.columns[:, :, : d * d].reshape(len(base), n, d, d)
        right = product(to_z.reshape(len(base), n * d, 1 + d), self.shapes)
        to_fields = product(self._z_tests, right.reshape(cells, self.per, n * d * local))
        self.to_fields[...] = to_fields.reshape(cells, q * n, d * local)
        # v's rows from z: the elastic force of (1 - tau K)^{-1} dz
        force = product(_single(p.force[:, : d * d]), _single(p.resolvent))
        force = force.reshape(len(base), d, d, n).swapaxes(1, 2)  # (points, j, i, n)
        left = product(self.shapes[:, 1:].transpose(0, 2, 1), force.reshape(len(base), d, d * n))
        back = product(self._z_tests, left.reshape(cells, self.per, local * d * n))
        back = back.reshape(cells, q, local * d, n).transpose(0, 2, 1, 3)
        self.from_fields = _single(back).reshape(cells, local * d, q * n)

    def _inertia(self, density: np.ndarray) -> np.ndarray:
        op = self.fine
        weighted = (density * op.weights).reshape(self.cells, op.v.per_cell, 1)
        shapes = op.v.blocks
        return product(shapes.transpose(0, 2, 1), weighted * shapes)

    @property
    def own(self) -> np.ndarray:
        """Rows of v from v, (cells, local dim, dim local)."""
        return self.of_velocity[:, : self.local * self.dim]

    @property
    def to_fields(self) -> np.ndarray:
        """Rows of the fields from v, (cells, q n, dim local)."""
        return self.of_velocity[:, self.local * self.dim :]

    def gathered(self, dv: np.ndarray) -> np.ndarray:
        """The cells' unknowns of dv (dim, .), (cells, dim local, 1)."""
        local = np.take(_single(dv.T), self.dofs, axis=0)
        return np.ascontiguousarray(local.swapaxes(1, 2)).reshape(self.cells, self.dim * self.local, 1)

    def scattered(self, rows: np.ndarray) -> np.ndarray:
        """Sums over the cells of their rows (cells, local dim, 1), (dim, .)."""
        return (self._scatter @ rows.reshape(self.cells * self.local, self.dim)).T


def _single(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=precision.SINGLE)

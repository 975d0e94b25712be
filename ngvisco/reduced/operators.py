"""Matrices from coefficients to values at the points of cells and sides, and mass matrices of facets.

If two ranks share a facet, each of them has one side, and both sides' contributions are summed
(``Exchange``).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from ngsolve import Grad

from ngvisco.algebra.local import Functions, LocalMatrix, integrals
from ngvisco.algebra.sparse import Blocks
from ngvisco.forms.mesh.points import CellPoints, SidePoints
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange, Halo
from ngvisco.threads import ALONE


class Operators:
    """Evaluates fields at the cells' points of one rule, and integrates against test functions there."""

    def __init__(self, step: Step, order: int) -> None:
        self.layout, self.points = step.layout, CellPoints(step.mesh, order, step.layout.symmetry)
        self.weights, self.cells = self.points.weights, slice(0, step.mesh.ne)
        self._whole: Operators | None = None
        self._made: dict[tuple[str, int], tuple[LocalMatrix, list[LocalMatrix]]] = {}
        self.z, self.dz = self.of("z")
        self.v, self.dv = self.of("v")

    def of(self, name: str) -> tuple[LocalMatrix, list[LocalMatrix]]:
        """Matrices of the values, and of the partial derivatives, of one component of an unknown in cells."""
        unknown = self.layout.unknowns[name]
        key = unknown.place, unknown.order
        if key not in self._made and self._whole is not None:
            with ALONE:
                value, slopes = self._whole.of(name)
            self._made[key] = value.part(self.cells), [D.part(self.cells) for D in slopes]
        elif key not in self._made:
            space, points = self.layout.scalar_space(name), self.points
            value, *slopes = (
                LocalMatrix(matrix, points.mesh.ne, self.weights, pieces=1)
                for matrix in (points.values(space), *points.gradients(space))
            )
            self._made[key] = value, slopes
        return self._made[key]

    @property
    def places(self) -> slice:
        """Range of this part's points among the points of all cells."""
        return slice(self.points.per_cell * self.cells.start, self.points.per_cell * self.cells.stop)

    def part(self, cells: slice) -> Operators:
        """The operators of a range of cells, see ``LocalMatrix.part``."""
        part = copy(self)
        part._whole, part._made, part.cells = self, {}, cells
        part.weights = self.weights[part.places]
        part.z, part.dz = part.of("z")
        part.v, part.dv = part.of("v")
        return part

    def gradients(self, operators: Sequence[LocalMatrix], rows: np.ndarray) -> np.ndarray:
        """Partial derivatives of each of ``rows``, (rows, dim, points)."""
        return np.stack([D(rows) for D in operators], axis=1)


class SideOperators:
    """Evaluates fields at the points of the cells' sides, and integrates against test functions there."""

    def __init__(self, step: Step) -> None:
        context, self.layout = step.context, step.layout
        self.points = points = SidePoints(step.mesh, step.quadrature.facet_degree, step.layout.symmetry)
        self.cells, self.weights, self.normals = slice(0, step.mesh.ne), points.weights, points.normals
        self._whole: SideOperators | None = None
        self._made: dict[tuple[str, int], LocalMatrix] = {}
        self.z, self.v = self.of("z"), self.of("v")
        self.inner = np.round(points.sample(context.inner))
        """The number 1 between two cells, 0 on walls."""
        self.crossed = self.inner
        """The number 1 between two cells and on walls that matter crosses, 0 on other walls."""
        if context.crossed is not context.inner:
            self.crossed = np.round(points.sample(context.crossed))
        self.h = np.repeat(context.h.vec.FV().NumPy(), self.z.per_cell)

    def of(self, name: str) -> LocalMatrix:
        """The matrix of the values of one component of an unknown in cells or on facets."""
        unknown = self.layout.unknowns[name]
        key = unknown.place, unknown.order
        if key not in self._made and self._whole is not None:
            with ALONE:
                self._made[key] = self._whole.of(name).part(self.cells)
        elif key not in self._made:
            self._made[key] = self._local(self.points.values(self.layout.scalar_space(name)))
        return self._made[key]

    @property
    def places(self) -> slice:
        """Range of this part's points among the points of all cells' sides."""
        return slice(self.z.per_cell * self.cells.start, self.z.per_cell * self.cells.stop)

    def part(self, cells: slice) -> SideOperators:
        """The operators of the sides of a range of cells, see ``LocalMatrix.part``."""
        part, where = copy(self), slice(self.z.per_cell * cells.start, self.z.per_cell * cells.stop)
        part.__dict__.pop("dz", None)
        part._whole, part._made, part.cells = self, {}, cells
        part.inner, part.crossed, part.h = self.inner[where], self.crossed[where], self.h[where]
        part.weights, part.normals = self.weights[where], self.normals[:, where]
        part.z, part.v = part.of("z"), part.of("v")
        return part

    @cached_property
    def dz(self) -> list[LocalMatrix]:
        """Matrices of the partial derivatives of one component of z, taken in the side's cell."""
        if self._whole is not None:
            with ALONE:
                return [D.part(self.cells) for D in self._whole.dz]
        space, points = self.layout.scalar_space("z"), self.points

        def slope(j: int) -> sp.csr_matrix:
            return points.operator(space, lambda u: Grad(u)[j])

        return [self._local(slope(j)) for j in range(points.mesh.dim)]

    def _local(self, matrix: sp.csr_matrix) -> LocalMatrix:
        points = self.points
        return LocalMatrix(matrix, points.mesh.ne, points.weights, pieces=points.per_cell)


class FacetMass:
    """The mass matrix of functions u, t on facets: one small block for each facet.

    A block is the sum over the facet's sides of int weight u t."""

    def __init__(self, values: LocalMatrix, exchange: Exchange) -> None:
        """``values`` evaluates functions on facets at the sides' points; ``exchange`` shares their
        unknowns."""
        matrix, self.exchange = values.at_nodes, exchange
        (self.unknowns,) = Blocks(abs(matrix).T @ abs(matrix)).groups or [np.zeros((0, 1), dtype=np.int64)]
        self.of_facets = exchange.part(self.unknowns[:, 0])
        """Exchanges one value for each facet."""
        facet_of, place = np.zeros((2, matrix.shape[1]), dtype=np.int64)
        count, size = self.unknowns.shape
        facet_of[self.unknowns], place[self.unknowns] = np.arange(count)[:, None], np.arange(size)
        sides = max(values.pieces, 1)  # 1 for a rank without cells
        nodes = values.nodal.shape[2] // sides or 1
        self.facet = facet_of[matrix.indices[matrix.indptr[:-1:nodes]]]
        """The facet of each side."""
        cell = np.zeros(count, dtype=np.int64)
        cell[self.facet] = np.arange(len(self.facet)) // sides
        self.halo = Halo(self.of_facets, cell[self.of_facets.places], values.cells)
        """The cells of other ranks across shared facets."""
        entries, nodal = matrix.tocoo(), np.zeros((len(self.facet), size, nodes))
        side, node = np.divmod(entries.row, nodes)
        nodal[side, place[entries.col], node] = entries.data
        self.functions = Functions(nodal, values.shape)
        """The basis functions of each side's facet."""

    def summed_blocks(self, matrix: sp.csr_matrix) -> sp.csr_matrix:
        """The sum over ranks of a matrix of facets' blocks; each rank has the share of its cells."""
        shared = self.unknowns[self.of_facets.places]
        if not len(shared):
            return matrix
        count, size = shared.shape
        rows, columns = np.repeat(shared, size, axis=1).ravel(), np.tile(shared, (1, size)).ravel()
        blocks = np.asarray(matrix[rows, columns]).reshape(count, size, size)
        received = self.of_facets.others(blocks.transpose(1, 2, 0)).transpose(2, 0, 1)
        return (matrix + sp.csr_matrix((received.ravel(), (rows, columns)), shape=matrix.shape)).tocsr()

    def update(self, weights: np.ndarray) -> None:
        """Set ``inverses`` of the blocks, (facets, functions, functions), for ``weights`` (points,)."""
        size, count, sides = self.unknowns.shape[1], len(self.unknowns), len(self.facet)
        by_sides = weights.reshape(sides, len(weights) // max(sides, 1))
        of_sides, blocks = integrals(self.functions, self.functions, by_sides), np.empty((size, size, count))
        for i, j in np.ndindex(size, size):
            blocks[i, j] = np.bincount(self.facet, of_sides[:, i, j], count)
        with self.exchange.communicator.together(np.linalg.LinAlgError):
            # a shared facet's block has a share on the other rank
            self.inverses = np.linalg.inv(self.of_facets.sum(blocks).transpose(2, 0, 1))

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Multiply ``loads`` (..., unknowns) by the inverse."""
        result = np.zeros_like(loads)
        local = loads[..., self.unknowns][..., None]
        result[..., self.unknowns] = (self.inverses @ local)[..., 0]
        return result

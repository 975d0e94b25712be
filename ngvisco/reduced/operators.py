"""Matrices from coefficients to values at the points of cells and sides, and mass matrices of facets.

If two ranks share a facet, each of them has one of its sides. ``Exchange`` sums the contributions of both
sides.
"""

from __future__ import annotations

from copy import copy
from math import prod
from typing import Any, Self

import numpy as np
import scipy.sparse as sp

from ngvisco.algebra.local import Functions, LocalMatrix, integrals
from ngvisco.algebra.sparse import Blocks
from ngvisco.forms.mesh.points import CellPoints, SidePoints
from ngvisco.forms.system import Step
from ngvisco.parallel.exchange import Exchange, Halo
from ngvisco.threads import ALONE


class PointOperators:
    """Evaluates fields at the points of one rule, and integrates against test functions there."""

    def __init__(
        self,
        step: Step,
        points: CellPoints | SidePoints,
        pieces: int = 1,
        other: PointOperators | None = None,
    ) -> None:
        """``pieces`` is the number of equal parts of a cell's points, see ``LocalMatrix``.

        ``other`` are operators at the points of another rule, with the same ``pieces``. They also provide the
        nodes, if all values at the points of this rule follow from values at those nodes.
        """
        self.layout, self.pieces, self._h, self._other = step.layout, pieces, step.context.h, other
        self.points: Any = points
        self.cells, self.weights = slice(0, step.mesh.ne), points.weights
        self._whole: PointOperators | None = None
        self._made: dict[tuple[str, int, bool], list[LocalMatrix]] = {}
        self.z, self.v = self.of("z"), self.of("v")

    def of(self, name: str) -> LocalMatrix:
        """The matrix of the values of one component of an unknown."""
        return self._matrices(name, False)[0]

    def slopes(self, name: str) -> list[LocalMatrix]:
        """Matrices of the partial derivatives of one component of an unknown in cells."""
        return self._matrices(name, True)

    def _matrices(self, name: str, slopes: bool) -> list[LocalMatrix]:
        unknown = self.layout.unknowns[name]
        key = unknown.place, unknown.order, slopes
        if key not in self._made and self._whole is not None:
            with ALONE:
                self._made[key] = [matrix.part(self.cells) for matrix in self._whole._matrices(name, slopes)]
        elif key not in self._made:
            space, points = self.layout.scalar_space(name), self.points
            matrices = points.gradients(space) if slopes else [points.values(space)]
            others = [None] * len(matrices) if self._other is None else self._other._matrices(name, slopes)
            self._made[key] = [
                LocalMatrix(matrix, points.mesh.ne, self.weights, pieces=self.pieces, other=other)
                for matrix, other in zip(matrices, others, strict=True)
            ]
        return self._made[key]

    @property
    def h(self) -> np.ndarray:
        """Sizes of the points' cells, m, (points,)."""
        return np.repeat(self._h.vec.FV().NumPy()[self.cells], self.z.per_cell)

    @property
    def places(self) -> slice:
        """Range of this part's points among the points of all cells."""
        return slice(self.z.per_cell * self.cells.start, self.z.per_cell * self.cells.stop)

    def part(self, cells: slice) -> Self:
        """The operators of a range of cells, see ``LocalMatrix.part``."""
        part = copy(self)
        part._whole, part._made, part.cells = self, {}, cells
        part.z, part.v = part.of("z"), part.of("v")
        part.weights = self.weights[part.places]
        return part


class Operators(PointOperators):
    """Operators at the cells' points of the quadrature rule of degree ``2*order``."""

    def __init__(self, step: Step, order: int, other: Operators | None = None) -> None:
        """``other`` are operators at another rule's points, see ``PointOperators``."""
        super().__init__(step, CellPoints(step.mesh, order, step.layout.symmetry), other=other)

    def tests(self) -> np.ndarray:
        """The functions of z times the points' weights, (cells, functions, points)."""
        return (self.weights.reshape(self.z.cells, self.z.per_cell, 1) * self.z.blocks).swapaxes(1, 2)

    def projection(self) -> np.ndarray:
        """Matrices that project values at the points onto the functions of z, (cells, functions, points)."""
        tests = self.tests()
        return np.linalg.solve(tests @ self.z.blocks, tests)


class SideOperators(PointOperators):
    """Operators at the points of the cells' sides.

    ``inner``, (points,), is 1 between two cells and 0 on walls. ``crossed``, (points,), is 1 between two
    cells and on walls that matter may cross.  Both arrays and the normals are computed at each access.
    """

    def __init__(self, step: Step) -> None:
        points = SidePoints(step.mesh, step.quadrature.facet_degree, step.layout.symmetry)
        super().__init__(step, points, points.per_cell)
        context = step.context
        # a mask takes one byte a point; numbers would take eight
        self._inner = self._crossed = np.round(points.sample(context.inner)) == 1
        if context.crossed is not context.inner:
            self._crossed = np.round(points.sample(context.crossed)) == 1

    @property
    def normals(self) -> np.ndarray:
        """Unit outer normals of the cells at this part's points, (dim, points)."""
        return self.points.normals_of(self.places)

    @property
    def inner(self) -> np.ndarray:
        """``inner`` of the class, at this part's points."""
        return self._inner[self.places].astype(float)

    @property
    def crossed(self) -> np.ndarray:
        """``crossed`` of the class, at this part's points."""
        return self._crossed[self.places].astype(float)


class FacetMass:
    """The mass matrix of functions u, t on facets: one small block for each facet.

    A block is the sum over the facet's sides of int weight u t."""

    def __init__(self, values: LocalMatrix, exchange: Exchange) -> None:
        """``values`` evaluates functions on facets at the sides' points; ``exchange`` belongs to the
        functions' unknowns."""
        matrix, self.exchange = values.at_nodes, exchange
        (self.unknowns,) = Blocks(abs(matrix).T @ abs(matrix)).groups or [np.zeros((0, 1), dtype=np.int64)]
        self.of_facets = exchange.part(self.unknowns[:, 0])
        """Exchanges values of facets, one for each facet."""
        facet_of, place = np.zeros((2, matrix.shape[1]), dtype=np.int64)
        count, size = self.unknowns.shape
        facet_of[self.unknowns], place[self.unknowns] = np.arange(count)[:, None], np.arange(size)
        sides = max(values.pieces, 1)  # a rank without cells has no pieces
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
        """The sum over ranks of ``matrix``, which has a block for each facet.

        On each rank, ``matrix`` is the sum over that rank's cells.
        """
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
            # the block of a shared facet is a sum over both ranks
            self.inverses = np.linalg.inv(self.of_facets.sum(blocks).transpose(2, 0, 1))

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Multiply ``loads`` (..., unknowns) by the inverse mass matrix."""
        columns = loads.reshape(prod(loads.shape[:-1]), loads.shape[-1]).T
        result = np.zeros(columns.shape, loads.dtype)
        result[self.unknowns] = np.matmul(self.inverses, columns[self.unknowns])
        return np.ascontiguousarray(result.T).reshape(loads.shape)

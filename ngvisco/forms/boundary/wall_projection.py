"""The projection onto the velocities that oblique and curved walls admit: C v = 0, (v . n, mu) for all mu.

I - D^-1 C^T (C D^-1 C^T)^-1 C, orthogonal in the inner product of a diagonal matrix D.  C D^-1 C^T is no sum
over ranks: walls of two ranks share vertices and edges.  There y = D^-1 C^T lambda is kept as an unknown, so
that y and lambda with C y = g solve

    D y - C_s^T lambda = 0,   C_s y + C_i D_i^-1 C_i^T lambda = g,

C_s of what ranks share, C_i of the rest: on one process the Schur complement itself.  It is factorised in the
units in which D and the rows of C have length one.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from ngsolve import BilinearForm, FESpace

from ngvisco.algebra.factorised import Direct, DirectSolver
from ngvisco.forms.boundary.wall_terms import Impenetrability
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Quadrature
from ngvisco.forms.spaces import Layout
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import SumInverse


class WallProjection:
    """Projects the free coefficients of v; over ranks vectors of v are summed ones, and all is collective.

    Parameters
    ----------
    layout : Layout
    term : Impenetrability
        The term of the multipliers.  Each of them is of one rank: a wall's facet has one cell.
    quadrature : Quadrature
    free : (unknowns of v,) array of bool
        What is not prescribed.
    """

    def __init__(
        self, layout: Layout, term: Impenetrability, quadrature: Quadrature, free: np.ndarray
    ) -> None:
        names = ("v", "wall_stress")
        space = FESpace([layout.blocks[name] for name in names])
        trial, test = space.TnT()
        u, w = (Fields(layout, dict(zip(names, parts, strict=True))) for parts in (trial, test))
        form = BilinearForm(space)
        for part in term.form(u, w):
            form += part.facets * quadrature.facets
        of_v, multipliers = (np.arange(r.start, r.stop) for r in (space.Range(0), space.Range(1)))
        constraint = csr(form.Assemble().mat)[multipliers][:, of_v].tocsc()
        self.free = free
        self._constraint, self._prescribed = constraint[:, free].tocsr(), constraint[:, ~free].tocsr()
        exchange = Exchange.of(space, Communicator.of(layout.mesh))
        exchange = exchange.part(np.concatenate([of_v[free], multipliers]))
        self._shared = exchange.places
        """Of the free coefficients of v."""
        last = np.count_nonzero(free) + np.arange(len(multipliers))
        exchange = exchange.part(np.concatenate([self._shared, last]))
        self._owned = exchange.owned[: len(self._shared)].astype(float)
        coupled = np.ones(exchange.count)
        coupled[: len(self._shared)] = abs(self._constraint[:, self._shared]).sum(axis=0)
        solved = exchange.sum(coupled) > 0
        self._solver: Direct
        if exchange.is_distributed:
            self._solver = SumInverse(solved, exchange)
        else:
            self._solver = DirectSolver(solved, "umfpack", symmetric=True)

    def update(self, diagonal: np.ndarray) -> None:
        """D, of the free coefficients.

        Raises StepError if C has not full rank.
        """
        self._root = np.sqrt(diagonal)
        scaled = self._constraint @ sp.diags(1 / self._root)
        self._length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
        scaled = (sp.diags(1 / self._length) @ scaled).tocsc()
        across, is_inner = scaled[:, self._shared], np.ones(len(diagonal))
        is_inner[self._shared] = 0.0
        inner = (scaled @ sp.diags(is_inner)).tocsr()
        self._transposed = inner.T.tocsr()
        blocks = [[sp.diags(self._owned), -across.T], [across, inner @ self._transposed]]
        self._solver.factorise(sp.bmat(blocks, format="csr"))

    def _taken(self, g: np.ndarray) -> np.ndarray:
        """D^(1/2) y, of C y = g."""
        count = len(self._shared)
        found = self._solver(np.concatenate([np.zeros(count), g / self._length]))
        result: np.ndarray = self._transposed @ found[count:]
        result[self._shared] = found[:count]
        return result

    def __call__(self, v: np.ndarray) -> np.ndarray:
        """The projection of free coefficients."""
        return v - self._taken(self._constraint @ v) / self._root

    def transposed(self, rows: np.ndarray) -> np.ndarray:
        """The transpose, of rows of free coefficients."""
        return rows - self._root * self._taken(self._constraint @ (rows / self._root**2))

    def completed(self, v: np.ndarray) -> np.ndarray:
        """The free ones of all coefficients of v, such that the walls admit them beside those prescribed."""
        through = self._constraint @ v[self.free] + self._prescribed @ v[~self.free]
        return v[self.free] - self._taken(through) / self._root

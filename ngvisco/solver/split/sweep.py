"""Approximate solution of the transport equations for a given velocity.

One component of z, and rho, have the scalar matrix T = M/tau + convection + facets with the trace
eliminated.  Sweeps over the cells, each for itself with its neighbours' values (block Jacobi), converge
like the Courant number; ``SWEEPS`` of them are taken always, so that the map stays linear.  With diffusion of
z, which cells do not resolve, T is factorised.  A density equation that is not linear has a Jacobian of its
own.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.linear import DirectSolver
from ngvisco.solver.split.operators import pruned
from ngvisco.solver.split.transport import Transport

SWEEPS = 2
"""Block Jacobi sweeps."""


class Sweep:
    """Approximate inverses of the scalar transport of z and of the density equation."""

    def __init__(self, transport: Transport, inverse: str) -> None:
        self.t = transport
        pattern = abs(transport.op.z.matrix).T @ abs(transport.op.z.matrix)
        for D in transport.op.dz:
            pattern = pattern + abs(transport.op.z.matrix).T @ abs(D.matrix)
        self._cells, self._rho_cells = BlockInverse(pattern.tocsr()), BlockInverse(pattern.tocsr())
        self._whole = self._own = None
        if transport.diffusion is not None:
            self._whole = DirectSolver(np.ones(transport.mass.shape[0], dtype=bool), inverse)
        if transport.density is not None:
            self._own = DirectSolver(transport.density.free, inverse)

    def update(self) -> None:
        """Form the matrices and invert at the present state."""
        t, op, tau = self.t, self.t.op, self.t.context.tau.Get()
        z_t = op.z.matrix.T @ sp.diags(op.weights)
        convection = sum(z_t @ sp.diags(t.v_q[j]) @ D.matrix for j, D in enumerate(op.dz))
        T = (t.mass / tau + convection + t.facets.fields_matrix()).tocsr()
        if self._whole is not None:
            self._whole.factorise((T + t.diffusion).tocsr())
            self._cells.update(T)
        else:
            self._carried = self._between(self._cells, T)
        if self._own is None:
            T = (t.mass / tau - convection.T + t.facets.density_matrix()).tocsr()
            self._rho_carried = self._between(self._rho_cells, T)

    @staticmethod
    def _between(cells: BlockInverse, T: sp.csr_matrix) -> sp.csr_matrix:
        """1 - B^{-1} T with the blocks B of cells: what a sweep takes from the neighbours."""
        cells.update(T)
        return pruned((sp.identity(T.shape[0], format="csr") - cells.matrix() @ T).tocsr())

    def linearise(self) -> None:
        """Let a density equation that is not linear follow the present state."""
        if self._own is not None:
            assert self.t.density is not None
            self._own.factorise(self.t.density.jacobian())

    def fields(self, r: np.ndarray) -> np.ndarray:
        """Increments of z before rates and creep, of rows r: both (cells' unknowns, n)."""
        if self._whole is not None:
            return np.stack([self._whole(column) for column in r.T], axis=1)
        return _swept(self._carried, self._cells, r)

    def in_cells(self, rows: np.ndarray) -> np.ndarray:
        """The cells' own inverses times ``rows``, (cells' unknowns, .): no sweep, no diffusion."""
        return self._cells.columns(rows)

    def density(self, r: np.ndarray) -> np.ndarray:
        """Increments of the density's unknowns."""
        if self._own is not None:
            return self._own(r)
        return _swept(self._rho_carried, self._rho_cells, r[:, None])[:, 0]


def _swept(carried: sp.csr_matrix, cells: BlockInverse, r: np.ndarray) -> np.ndarray:
    start = cells.columns(r)
    x = start
    for _ in range(SWEEPS - 1):
        x = carried @ x
        x += start
    return x

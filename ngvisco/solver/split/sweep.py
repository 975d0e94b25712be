"""One sweep of the transport: each cell for itself, with its neighbours' values held (block Jacobi).

The scalar block of a cell is M/tau + convection + what flows in; rates and creep follow at the points of
the coarse rule by (1 - tau K)^{-1} (``PointTangent``).  With diffusion of z the blocks no longer do: its
scalar matrix is factorised as a whole.  A density equation that is not linear has a Jacobian of its own.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.linear import DirectSolver
from ngvisco.solver.split.transport import Transport


class Sweep:
    """Approximate inverses of the scalar transport of z and of the density equation."""

    def __init__(self, transport: Transport, inverse: str) -> None:
        self.t = transport
        op = transport.op
        pattern = abs(transport.mass) + abs(transport.own_trace.matrix)
        for D in op.dz:
            pattern = pattern + abs(op.z).T @ abs(D)
        self._cells, self._density = BlockInverse(pattern.tocsr()), BlockInverse(pattern.tocsr())
        self._whole = self._own = None
        if transport.diffusion is not None:
            self._whole = DirectSolver(np.ones(transport.mass.shape[0], dtype=bool), inverse)
        if transport.density is not None:
            self._own = DirectSolver(transport.density.free, inverse)

    def update(self) -> None:
        """Invert at the present state."""
        t, op, tau = self.t, self.t.op, self.t.context.tau.Get()
        W = sp.diags(op.weights)
        convection = op.z.T @ W @ sum(sp.diags(t.v_q[j]) @ D for j, D in enumerate(op.dz))
        own = t.from_trace.matrix @ t.trace_inverse.matrix() @ t.to_trace.matrix
        inflow = own.multiply(t.own_trace.matrix != 0) - t.own_trace.matrix
        cells = t.mass / tau + convection + inflow
        if self._whole is not None:
            self._whole.factorise((cells + t.diffusion).tocsr())
        else:
            self._cells.update(cells.tocsr())
        self.linearise()
        if self._own is None:
            density = t.mass / tau - convection.T + t.density_out.matrix
            self._density.update(density.tocsr())

    def linearise(self) -> None:
        """Let a density equation that is not linear follow the present state."""
        if self._own is not None:
            assert self.t.density is not None
            self._own.factorise(self.t.density.jacobian())

    def fields(self, r: np.ndarray) -> np.ndarray:
        """Increments of z, (n, cells' unknowns), before rates and creep."""
        return self._cells(r) if self._whole is None else apply_solver(self._whole, r)

    def density(self, r: np.ndarray) -> np.ndarray:
        """Increments of the density's unknowns."""
        return self._density(r) if self._own is None else self._own(r)


def apply_solver(solver: DirectSolver, rows: np.ndarray) -> np.ndarray:
    return np.stack([solver(row) for row in rows])

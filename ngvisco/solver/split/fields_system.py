"""The linear equations of the fields for a given velocity: transport, rates and creep together.

For an increment dz they are  T dz - (K dz, .) = rows,  with the transport T (``TransportSweeps``) and the
derivative K of rates and creep (``PointTangent``); for drho the transport alone.  Sweeps, and (1 - tau
K)^{-1} at every point after them, invert these up to tau^2 (products of T and K) and what the sweeps leave:
well for Courant numbers and strains in a step below a half, and not at all where either is above one.
There they precondition GMRES: near walls that start to move at once, one cell of the first step is enough.
"""

from __future__ import annotations

import numpy as np

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.krylov import Map, improved
from ngvisco.algebra.sparse import mass_matrix
from ngvisco.solver.options import FieldOptions
from ngvisco.solver.split.schur_complement import FlowSchurComplement, at_points


class FieldsSystem:
    """Solves the fields' equations where the operator was last updated."""

    def __init__(self, operator: FlowSchurComplement, options: FieldOptions) -> None:
        self.operator, self.sweep, self.options = operator, operator.sweep, options
        self.points, self.op = operator.points, operator.points.op
        mass = mass_matrix(self.op.z.matrix, self.op.weights)
        self._project = BlockInverse(mass)
        self._project.update(mass)
        self._swept_is_enough: set[str] = set()
        """Fields for which one application of the approximate inverse did, at this operator."""

    def renew(self) -> None:
        """The operator was made anew: whether sweeps are enough is to be seen again."""
        self._swept_is_enough.clear()

    def z(self, rows: np.ndarray) -> np.ndarray:
        """Increments of z, of rows: both (cells' unknowns, n)."""
        return self._solved("z", self._rows, self._approximate, rows)

    def density(self, rows: np.ndarray) -> np.ndarray:
        """Increments of the density's unknowns, of rows."""
        sweep = self.sweep
        if sweep.density_is_factorised:
            return sweep.density(rows)
        return self._solved("rho", sweep.density_rows, sweep.density, rows[:, None])[:, 0]

    def _solved(self, name: str, apply: Map, approximate: Map, rows: np.ndarray) -> np.ndarray:
        if name in self._swept_is_enough:
            return approximate(rows)
        options = self.options
        found, iterations = improved(
            apply,
            approximate,
            rows,
            options.tolerance,
            options.iterations,
            options.enough,
            self.operator.residual.ranks.products,
        )
        if not iterations:
            self._swept_is_enough.add(name)
        return found

    def _approximate(self, rows: np.ndarray) -> np.ndarray:
        dz = self.sweep.fields(rows)
        return self._project(self.op.z.test(self.operator.resolved(dz))).T

    def _rows(self, dz: np.ndarray) -> np.ndarray:
        values = self.op.z(np.ascontiguousarray(dz.T))
        rates = at_points(self.points.rate_slope, values)
        return self.sweep.rows(dz) - self.op.z.test(rates).T

"""The conduction of heat in the transport of the entropy: its matrix at an evaluation.

What dR_s/ds has of a(theta, q/zeta_s) and of walls (``ngvisco.forms.terms.heat``), with theta'(s)/zeta_s and
kappa one number in each cell.
"""

from __future__ import annotations

import numpy as np

from ngvisco.forms.terms.heat import Heating, penalty_weight
from ngvisco.forms.upwinding import mean_share
from ngvisco.physics.arrays import Array
from ngvisco.reduced.facet_coupling import FacetCoupling
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.threads import product


class ConductionBlocks:
    """The blocks of cells, and of those across their sides, as of ``FacetCoupling``."""

    def __init__(self, residual: ReducedResidual, term: Heating, coupling: FacetCoupling) -> None:
        self.residual, self.term, self.coupling = residual, term, coupling
        op, sides = residual.op, residual.side_op
        self.component = residual.step.layout.states.slices[term.entropy.name].start
        weights = op.weights.reshape(coupling.cells, op.z.per_cell, 1)
        self._laplacian = sum(product((weights * D.blocks).transpose(0, 2, 1), D.blocks) for D in op.dz)
        self._outwards = np.zeros((sides.points.count, op.z.blocks.shape[2]))
        for n, D in zip(sides.points.normals, sides.dz, strict=True):
            entries = D.matrix.tocoo()
            functions = entries.col % self._outwards.shape[1]
            np.add.at(self._outwards, (entries.row, functions), n[entries.row] * entries.data)
        self._share = mean_share(sides.inner)

    def __call__(self, at: Evaluation) -> tuple[np.ndarray, np.ndarray]:
        """(cells, q, q) and (cells, sides, q, q)."""
        r, coupling, term = self.residual, self.coupling, self.term
        slope = self._mean(self._slope(at))
        weight = slope * self._mean(self._kappa(at))

        def on_sides(values: np.ndarray) -> np.ndarray:
            return np.repeat(values, r.side_op.points.count // max(coupling.cells, 1))

        inner, of_sides = r.side_op.inner, on_sides(weight)
        penalty = penalty_weight(r.step.discretisation.m) * of_sides / r.side_op.h
        # half of the sum of both sides' penalties times what is missing to the mean
        mean = 0.5 * inner * r.trace_mass.summed(penalty / r.side_op.points.per_side)
        through = sum((each.value for each in term.exchange(at.facets)), 0.0) * on_sides(slope)
        own, across = coupling.blocks(mean + through, self._share, -mean, r.trace_mass)
        flux = inner * of_sides
        more, beyond = coupling.blocks(-flux, self._share * of_sides, inner, r.trace_mass, self._outwards)
        return own + more + weight[:, None, None] * self._laplacian, across + beyond

    def _slope(self, at: Evaluation) -> np.ndarray:
        """theta'(s)/zeta_s at the points, K/Pa."""
        i, z = self.component, at.cells.z.value
        along = np.zeros_like(z)
        along[i] = 1.0
        slope = self.residual.slope.derivative(z)(along)[i] / self.term.entropy.unit
        return slope / at.cells.zeta.value[i]

    def _kappa(self, at: Evaluation) -> np.ndarray:
        """kappa at the points, W/(m K)."""
        kappa = self.term.conductivity(at.cells)
        return kappa.value if isinstance(kappa, Array) else np.full(at.cells.z.value.shape[-1], kappa)

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """Over the points of each cell."""
        per = self.residual.op.z.per_cell  # none on a rank without cells
        return values.reshape(self.coupling.cells, per).sum(axis=1) / max(per, 1)

"""Couplings of cells through facets' traces that are eliminated, in dense blocks, and those of conduction."""

from __future__ import annotations

import numpy as np

from ngvisco.forms.terms.heat import Heating, penalty_weight
from ngvisco.forms.upwinding import mean_share
from ngvisco.physics.arrays import Array
from ngvisco.reduced.operators import FacetMass, SideOperators
from ngvisco.reduced.residual import Evaluation, ReducedResidual
from ngvisco.threads import product


class FacetCoupling:
    """Builds the blocks for weights at the sides' points; the functions there are known once."""

    def __init__(self, sides: SideOperators, mass: FacetMass) -> None:
        z, per = sides.z, sides.points.per_side
        self.cells, self.functions = z.cells, z.local
        self.sides = z.per_cell // per
        count = self.cells * self.sides
        self._weights = sides.points.weights.reshape(count, per, 1)
        self._z = z.blocks.reshape(count, per, self.functions)
        self._z_t = np.ascontiguousarray(self._z.transpose(0, 2, 1))
        self._hat = np.ascontiguousarray(mass.shapes.T).reshape(count, per, len(mass.shapes))
        self._hat_t = np.ascontiguousarray(self._hat.transpose(0, 2, 1))
        self._facet = mass.facet[::per]
        self.across = self._other_sides()
        """The side of the other cell, (sides,); itself on the boundary; beyond all sides on another rank."""
        self.halo = mass.halo
        side_of = np.zeros(len(mass.unknowns), dtype=np.int64)
        side_of[self._facet] = np.arange(count)
        self._border = side_of[mass.of_facets.places]
        self.across[self._border] = count + np.arange(len(self._border))
        self._inner = (self.across != np.arange(len(self._z)))[:, None, None]

    def _other_sides(self) -> np.ndarray:
        order = np.argsort(self._facet, kind="stable")
        same = np.flatnonzero(np.diff(self._facet[order]) == 0)
        across = np.arange(len(order))
        across[order[same]], across[order[same + 1]] = order[same + 1], order[same]
        return across

    def neighbours(self) -> np.ndarray:
        """The cell across each side, (cells, sides)."""
        beyond = self.across - self.cells * self.sides
        cell = np.where(beyond < 0, self.across // max(self.sides, 1), self.cells + beyond)
        return cell.reshape(self.cells, self.sides)

    def blocks(
        self,
        own: np.ndarray,
        to_trace: np.ndarray,
        from_trace: np.ndarray,
        mass: FacetMass,
        values: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of int (own z + from_trace z_hat) q, where mass z_hat = int to_trace z t of both sides.

        Parameters
        ----------
        own, to_trace, from_trace : ndarray, shape (sides' points,)
        mass : FacetMass
            At its last ``update``.
        values : ndarray, shape (cells, points, functions), optional
            Of the functions in the place of z at the sides' points; default their own.

        Returns
        -------
        of the cell's own values, (cells, q, q), and of those across each side, (cells, sides, q, q)
        """
        shape, w = self._weights.shape, self._weights
        z = self._z if values is None else values.reshape(self._z.shape)
        to_hat = product(self._hat_t, (w * to_trace.reshape(shape)) * z)
        from_hat = product(self._z_t, (w * from_trace.reshape(shape)) * self._hat)
        from_hat = product(from_hat, mass.inverses[self._facet])
        here = product(self._z_t, (w * own.reshape(shape)) * z) + product(from_hat, to_hat)
        if len(self._border):
            to_hat = np.concatenate([to_hat, self.halo.swapped(to_hat[self._border])])
        there = product(from_hat, to_hat[self.across]) * self._inner
        by_cells = (self.cells, self.sides, self.functions, self.functions)
        return here.reshape(by_cells).sum(axis=1), there.reshape(by_cells)


class ConductionBlocks:
    """The conduction of heat in the transport of the entropy: its blocks at an evaluation.

    What dR_s/ds has of a(theta, q/zeta_s) and of walls (``ngvisco.forms.terms.heat``), with theta'(s)/zeta_s
    and kappa one number in each cell.
    """

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

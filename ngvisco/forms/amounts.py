"""Amounts of bodies do not fall below zero: their fractions lie in [0, 1].

The amounts n_i (``ngvisco.physics.mixture``) are conserved, and n_i >= 0 is all that the fractions
n_i/N, N = sum n_j, need to lie in [0, 1].  A discontinuous polynomial overshoots where it jumps.  Where an
amount is negative at a point of a cell all of them are drawn towards an even mixture there,

    n_i <- s n_i + (1 - s) (n_i,K/N_K) N,     0 <= s < 1,

K their means, which leaves these and N as they are (Zhang and Shu, J. Comput. Phys. 229, 2010).  A mean below
zero is raised first: the cell swaps what it lacks of the body for as much of the others.  So the mass of each
body is kept to rounding, and N in every cell.  Where N itself is not positive at a point all amounts are
scaled towards their means, by one s, before.  The density follows, by sum rho_i dn_i.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF

from ngvisco.forms.cell_means import SHARE, CellMeans, Near
from ngvisco.forms.mesh.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.bodies import Amount

SLACK = 1e-9
"""By how much an amount, 1 in a body at rest, may be below zero: what an iteration leaves open."""


class Amounts:
    """Keeps the bodies' amounts of a step's present state from falling below zero.

    Parameters
    ----------
    step : Step
    sampler : Sampler
        Its points are those at which amounts are looked at.
    means : CellMeans
    """

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        amounts = [v for v in step.model.material.variables if isinstance(v, Amount)]
        slices = step.layout.states.slices
        self.components = np.array([slices[v.name].start for v in amounts], dtype=int)
        self._density = np.array([v.density for v in amounts])
        if amounts:
            self._values = CF(tuple(step.now.z[int(i)] for i in self.components))

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        if not len(self.components):
            return False
        values = self._at_points()
        outside = (values < -SLACK).any() or (values.sum(axis=1) <= 0).any()
        return self.sampler.ranks.any(outside)

    def limit(self) -> np.ndarray:
        """Mend the present state; gives the numbers of the cells, of this rank, that were out of bounds."""
        if not self.is_exceeded():
            return np.zeros(0, dtype=int)
        scaled = self._keep_total()
        least = self._least()
        self._means.project()
        before = self._means.array("z")[self.components]
        wanted = raised(before, self._means.volumes, self._means.neighbours, self.sampler.ranks)
        outside = (least < -SLACK).any(axis=0)
        cells = outside | (wanted != before).any(axis=0)
        z = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        values = z.reshape(self.step.layout.states.size, -1)
        old = values[self.components]
        dofs = np.flatnonzero(cells[self._means.owner])
        owner = self._means.owner[dofs]
        total = old.sum(axis=0)[dofs]
        even = wanted / wanted.sum(axis=0)
        # the means raised, then the largest s for which nothing is negative at a point
        moved = old[:, dofs] + (wanted - before)[:, owner] * self._means.one[dofs]
        values[np.ix_(self.components, dofs)] = moved
        lowest = self._least()
        values[np.ix_(self.components, dofs)] = even[:, owner] * total
        mixed = self._least()
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(lowest < 0, mixed / (mixed - lowest), 1.0).min(axis=0)
        share = np.clip(np.nan_to_num(share), 0.0, 1.0)[owner]
        values[np.ix_(self.components, dofs)] = share * moved + (1 - share) * even[:, owner] * total
        self._let_density_follow(values[self.components] - old)
        return np.flatnonzero(outside | scaled)

    def _keep_total(self) -> np.ndarray:
        """Scale the amounts towards their means in cells where their sum N is not positive at a point.

        N is then ``SHARE`` of its mean there; cells whose mean of N is not positive stay.  Gives whether a
        cell was scaled, (cells,).
        """
        least = self._least_total()
        self._means.project()
        means = self._means.array("z")[self.components]
        mean = means.sum(axis=0)
        scaled = (least <= 0) & (mean > 0)
        if scaled.any():
            z = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
            values = z.reshape(self.step.layout.states.size, -1)
            dofs = np.flatnonzero(scaled[self._means.owner])
            owner = self._means.owner[dofs]
            part = ((1 - SHARE) * mean[owner] / (mean - least)[owner])[None]
            centre = means[:, owner] * self._means.one[dofs]
            old = values[self.components]
            values[np.ix_(self.components, dofs)] = centre + part * (old[:, dofs] - centre)
            self._let_density_follow(values[self.components] - old)
        return scaled

    def _let_density_follow(self, change: np.ndarray) -> None:
        """rho = sum rho_i n_i also after a change of the amounts, (amounts, functions)."""
        state = self.step.state.vec.FV().NumPy()
        state[self.step.layout.ranges["rho"]] += self._density @ change

    def _least_total(self) -> np.ndarray:
        """Least values of N at the points of every cell, (cells,)."""
        return self._least_of_cells(self._at_points().sum(axis=1, keepdims=True))[0]

    def _least(self) -> np.ndarray:
        """Least values at the points of every cell, (amounts, cells)."""
        return self._least_of_cells(self._at_points())

    def _at_points(self) -> np.ndarray:
        """(points, amounts)."""
        return self.sampler.rows(self._values)

    def _least_of_cells(self, values: np.ndarray) -> np.ndarray:
        least = np.full((self.step.mesh.ne, values.shape[1]), np.inf)
        np.minimum.at(least, np.asarray(self.sampler.points["nr"]), values)
        return least.T


def raised(means: np.ndarray, volumes: np.ndarray, neighbours: Near, ranks: Communicator) -> np.ndarray:
    """Means of amounts, (amounts, cells), with those below zero raised by swaps with other cells.

    Neighbours give first, in proportion to what they have; what they do not have all cells of the body give.
    Sums over the cells, by their volumes, and sums over the amounts are kept.  Collective over ranks.
    """
    slack = -SLACK * volumes
    if not ranks.any((means * volumes < slack).any()):
        return means
    before = means * volumes
    content = before.copy()
    everywhere = _Everywhere(len(volumes), ranks)
    for i in range(len(means)):
        for near in (neighbours, everywhere):
            missing, had = np.where(content[i] < slack, -content[i], 0.0), np.maximum(content[i], 0.0)
            if not ranks.any(missing.any()):
                break
            others = np.maximum(content, 0.0)
            others[i] = 0.0
            given_back = others / np.where(others.sum(axis=0) > 0, others.sum(axis=0), 1.0)
            # a cell asks in proportion to what there is; none gives more than it has
            there = near @ had
            asks = np.where(there > 0, missing, 0.0) / np.where(there > 0, there, 1.0)
            gives = had / np.maximum(near @ asks, 1.0)
            received = asks * (near @ gives)
            content[i] += received - gives * (near @ asks)
            content += (near @ (asks * given_back).T).T * gives - given_back * received
    return np.where(content == before, means, content / volumes)


class _Everywhere:
    """The matrix of ones."""

    def __init__(self, size: int, ranks: Communicator) -> None:
        self.size, self.ranks = size, ranks

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        total = self.ranks.totals(np.atleast_1d(values.sum(axis=0))).reshape(values.shape[1:])
        return np.broadcast_to(total, (self.size, *values.shape[1:]))

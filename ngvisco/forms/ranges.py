"""Parameters stay within the range of their start values, amounts of bodies do not fall below zero.

A parameter is transported, dt theta + (v . grad) theta = 0, so that its exact solution stays within the range
of its start; a discontinuous polynomial overshoots where it jumps.  Where it has left its range at a point of
a cell, its mean there is put back into the range, if need be, and it is scaled towards its mean (Zhang and
Shu, J. Comput. Phys. 229, 2010).

The amount n_i of a body (``ngvisco.physics.mixture``) is conserved, and n_i >= 0 is all that its fraction
needs to lie in [0, 1].  It is scaled in the same way, which leaves its mean.  A mean below zero is raised to
zero by what the neighbouring cells have, so that the body's mass is kept to rounding.  The density changes
with the amounts, by sum rho_i dn_i.

A range is looked at with a slack of ``SLACK`` of its width, that what an iteration leaves open is not taken
for an overshoot.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF

from ngvisco.forms.cell_means import CellMeans
from ngvisco.forms.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.physics.bodies import Amount

SLACK = 1e-9
"""Of a range's width, or of an amount at rest, by which values may be out of their range."""

_RINGS = 20
"""Rings of cells from which a mean below zero is raised, before all cells give a share."""


class Ranges:
    """Keeps the parameters and the bodies' amounts of a step's present state within their ranges.

    Parameters
    ----------
    step : Step
        Its ``ranges`` have, by name, the least and the largest start value of every parameter.
    sampler : Sampler
        Its points are those at which values are looked at.
    means : CellMeans
    """

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        states = step.layout.states
        self.components = np.flatnonzero(~states.strains)
        """Numbers of the components of parameters and amounts."""
        variables = [v for v in step.model.material.variables if not v.is_strain]
        self.names = [v.name for v in variables]
        self._is_amount = np.array([isinstance(v, Amount) for v in variables])
        self._density = np.array([v.density if isinstance(v, Amount) else 0.0 for v in variables])
        if self.names:
            self._values = CF(tuple(step.now.z[int(i)] for i in self.components))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest values, (components,)."""
        ranges = [self.step.ranges.get(name, (-np.inf, np.inf)) for name in self.names]
        least, largest = (np.array(ends, dtype=float) for ends in zip(*ranges, strict=True))
        return np.where(self._is_amount, 0.0, least), np.where(self._is_amount, np.inf, largest)

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return bool(self.names) and bool(self._outside()[0].any())

    def limit(self) -> np.ndarray:
        """Put the present state back into its ranges; gives the numbers of the cells that were changed."""
        if not self.names:
            return np.zeros(0, dtype=int)
        outside, least, largest = self._outside()
        if not outside.any():
            return np.zeros(0, dtype=int)
        self._means.project()
        means = self._means.array("z")[self.components]
        low, high = self.bounds
        changed = np.zeros(outside.shape[0], dtype=bool)
        before = self._coefficients()
        for i in range(len(self.names)):
            wanted = means[i].copy()
            cells = outside[:, i]
            if self._is_amount[i] and cells.any():
                wanted = self._raised(means[i])
                cells = cells | (wanted != means[i])
            elif cells.any():
                wanted[cells] = np.clip(means[i][cells], low[i], high[i])
            below, above = least[:, i] - means[i], largest[:, i] - means[i]
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.fmin(
                    np.where(below < 0, (low[i] - wanted) / below, np.inf),
                    np.where(above > 0, (high[i] - wanted) / above, np.inf),
                )
            share = np.where(cells, np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0), 1.0)
            self._scale(int(self.components[i]), cells, means[i], wanted, share)
            changed |= cells
        moved = self._density @ (self._coefficients() - before)
        self.step.state.vec.FV().NumPy()[self.step.layout.ranges["rho"]] += moved
        return np.flatnonzero(changed)

    def _coefficients(self) -> np.ndarray:
        """Copies of the coefficients, (components, functions)."""
        z = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        return z.reshape(self.step.layout.states.size, -1)[self.components].copy()

    def _scale(
        self, component: int, cells: np.ndarray, mean: np.ndarray, wanted: np.ndarray, share: np.ndarray
    ) -> None:
        """In ``cells`` wanted + share (z - mean) for z."""
        z = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        values = z.reshape(self.step.layout.states.size, -1)[component]
        one, owner = self._means.one, self._means.owner
        of_cells = cells[owner]
        rest = values - mean[owner] * one
        values[of_cells] = (wanted[owner] * one + share[owner] * rest)[of_cells]

    def _raised(self, mean: np.ndarray) -> np.ndarray:
        """The means of an amount with those below zero raised to zero by their neighbours."""
        if mean.min() >= 0:
            return mean
        content, neighbours = mean * self._means.volumes, self._means.neighbours
        for _ in range(_RINGS):
            missing, had = np.maximum(-content, 0.0), np.maximum(content, 0.0)
            if not missing.any():
                break
            # a cell asks its neighbours in proportion to what they have; they give no more than that
            near = neighbours @ had
            served = near > 0
            asks = np.where(served, missing, 0.0) / np.where(served, near, 1.0)
            asked = neighbours @ asks
            share = 1 / np.maximum(asked, 1.0)
            content = content - had * asked * share + asks * (neighbours @ (had * share))
            # where nobody near has anything the next ring owes it
            owed = np.where(served, 0.0, missing)
            content += owed - neighbours @ (owed / np.maximum(neighbours @ np.ones(len(owed)), 1.0))
        if content.min() < 0:  # all cells give the same share of what they have
            missing, had = -content[content < 0].sum(), content[content > 0].sum()
            content = np.maximum(content, 0.0) * max(0.0, 1 - missing / had)
        return np.maximum(content / self._means.volumes, 0.0)

    def _outside(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which are out of their ranges, least and largest values, each (cells, components)."""
        values = np.asarray(self.sampler.values(self._values)).reshape(len(self.sampler.points), -1)
        numbers, cells = np.asarray(self.sampler.points["nr"]), self.step.mesh.ne
        least = np.full((cells, values.shape[1]), np.inf)
        largest = np.full_like(least, -np.inf)
        np.minimum.at(least, numbers, values)
        np.maximum.at(largest, numbers, values)
        low, high = self.bounds
        with np.errstate(invalid="ignore"):
            width = np.where(np.isfinite(high - low), high - low, 1.0)
        slack = SLACK * np.maximum(width, SLACK * np.maximum(abs(low), 1e-300))
        return (least < low - slack) | (largest > high + slack), least, largest

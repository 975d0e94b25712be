"""Parameters stay within the range of their start values.

A parameter is transported, dt theta + (v . grad) theta = 0, so that its exact solution stays within the range
of its start; a discontinuous polynomial overshoots where it jumps.  Where it has left its range at a point of
a cell, its mean there is put back into the range, if need be, and it is scaled towards its mean (Zhang and
Shu, J. Comput. Phys. 229, 2010).
"""

import numpy as np
from ngsolve import CF

from ngvisco.forms.cell_means import CellMeans
from ngvisco.forms.mesh.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.physics.parameters import Parameter

SLACK = 1e-9
"""Of a range's width, by which values may be out of it: what an iteration leaves open."""


class Ranges:
    """Keeps the parameters of a step's present state within their ranges.

    Parameters
    ----------
    step : Step
        Its ``ranges`` have, by name, the least and the largest start value of every parameter.
    sampler : Sampler
        Its points are those at which values are looked at.
    """

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        self.names = [v.name for v in step.model.material.variables if isinstance(v, Parameter)]
        slices = step.layout.states.slices
        self.components = [slices[name].start for name in self.names]
        if self.names:
            self._values = CF(tuple(step.now.z[int(i)] for i in self.components))

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return bool(self.names) and self.sampler.ranks.any(self._outside()[0].any())

    def limit(self) -> np.ndarray:
        """Put the present state back into its ranges; gives the cells of this rank that were changed."""
        if not self.is_exceeded():
            return np.zeros(0, dtype=int)
        outside, least, largest = self._outside()
        self._means.project()
        means, one, owner = self._means.array("z")[self.components], self._means.one, self._means.owner
        z = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]]
        values = z.reshape(self.step.layout.states.size, -1)
        for i, name in enumerate(self.names):
            cells, (low, high) = outside[i], self.step.ranges[name]
            wanted = np.clip(means[i], low, high)
            below, above = means[i] - least[i], largest[i] - means[i]
            with np.errstate(divide="ignore", invalid="ignore"):
                downwards = np.where(below > 0, (wanted - low) / below, np.inf)
                upwards = np.where(above > 0, (high - wanted) / above, np.inf)
            share = np.clip(np.minimum(downwards, upwards), 0.0, 1.0)
            dofs = np.flatnonzero(cells[owner])
            of = owner[dofs]
            own = values[self.components[i]]
            own[dofs] = wanted[of] * one[dofs] + share[of] * (own[dofs] - means[i][of] * one[dofs])
        return np.flatnonzero(outside.any(axis=0))

    def _outside(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which are out of their ranges, least and largest values, each (parameters, cells)."""
        values = self.sampler.rows(self._values)
        numbers, cells = np.asarray(self.sampler.points["nr"]), self.step.mesh.ne
        least = np.full((cells, values.shape[1]), np.inf)
        largest = np.full_like(least, -np.inf)
        np.minimum.at(least, numbers, values)
        np.maximum.at(largest, numbers, values)
        low, high = (np.array(ends) for ends in zip(*(self.step.ranges[n] for n in self.names), strict=True))
        slack = SLACK * np.maximum(high - low, np.maximum(abs(low), abs(high)) * (high == low))
        return ((least < low - slack) | (largest > high + slack)).T, least.T, largest.T

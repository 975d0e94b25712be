"""The tensors of bodies stay positive where their energies, linear in them, do not see to it.

Body i carries n_i and X_i = n_i B, and C : (X_i - n_i I) has no least value where X_i is not positive: such
matter is stretched without end.  Where X_i is not positive at a point of a cell of which the body is a part,
while its mean is, B goes towards that of the means,

    X_i <- s X_i + (1 - s) (n_i/n_iK) X_iK,

with the largest s that leaves ``SHARE`` of the second at each such point.  n_i, the mean of X_i and, with it,
an energy that is linear in X_i are kept, and so are rho and v: the limiter takes nothing by it.
"""

import numpy as np
from ngsolve import CF

from ngvisco.forms.cell_means import SHARE, CellMeans
from ngvisco.forms.mesh.sampling import Sampler
from ngvisco.forms.system import Step

_PART = 0.1
"""Fraction from which on the body takes part (``Mixture.taking_part``)."""


class Stretches:
    """Keeps X_i of a step's present state positive.

    Parameters
    ----------
    step : Step
        With ``linear_contents`` of its material.
    sampler : Sampler
        Its points are those at which values are looked at.
    """

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        z, variables = step.now.z_tensors, {v.name: v for v in step.model.material.variables}
        self._amounts, self._signs = {}, {}
        for X, (amount, theta) in step.model.material.linear_contents(z).items():
            self._amounts[X] = amount
            self._signs[X] = CF((theta - _PART, *variables[X].positive(z[X]).values()))

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return any(self.sampler.ranks.any(len(self._outside(X)[0]) > 0) for X in self._amounts)

    def limit(self) -> np.ndarray:
        """Make X_i of the present state positive; gives the cells of this rank that were changed."""
        changed = [self._limited(X) for X in self._amounts]
        return np.unique(np.concatenate([np.zeros(0, dtype=int), *changed]))

    def _outside(self, content: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points at which X_i of a body that takes part is not positive, cells, B of means, which is."""
        signs = self.sampler.rows(self._signs[content])
        points = np.flatnonzero((signs[:, 0] > 0) & ~(signs[:, 1:] > 0).all(axis=1))
        if self.sampler.ranks.any(len(points) > 0):
            self._means.project()
        states, means = self.step.layout.states, self._means.array("z")
        cells = np.asarray(self.sampler.points["nr"])[points]
        amount = means[states.slices[self._amounts[content]].start][cells]
        mean = (means[states.slices[content]].T[cells] @ states.spaces[content].columns.T).reshape(-1, 3, 3)
        good = (amount > 0) & (np.linalg.eigvalsh(mean)[:, 0] > 0)
        return points[good], cells[good], mean[good] / amount[good, None, None]

    def _limited(self, content: str) -> np.ndarray:
        points, cells, mean = self._outside(content)
        if not len(points):
            return cells
        states, z, means = self.step.layout.states, self.step.now.z_tensors, self._means.array("z")
        amount, at = self._amounts[content], self.sampler.points[points]
        X, n = states.slices[content], states.slices[amount].start
        value = np.asarray(z[content](at)).reshape(-1, 3, 3) / np.asarray(z[amount](at)).reshape(-1, 1, 1)
        inverse = np.linalg.inv(np.linalg.cholesky(mean))
        least = np.linalg.eigvalsh(inverse @ value @ inverse.transpose(0, 2, 1))[:, 0]
        share = np.ones(self.step.mesh.ne)
        np.minimum.at(share, cells, (1 - SHARE) / (1 - np.minimum(least, 0.0)))
        values = self.step.state.vec.FV().NumPy()[self.step.layout.ranges["z"]].reshape(states.size, -1)
        dofs = np.flatnonzero(share[self._means.owner] < 1)
        of = self._means.owner[dofs]
        uniform = means[X][:, of] / means[n][of] * values[n, dofs]
        values[X, dofs] = uniform + share[of] * (values[X, dofs] - uniform)
        return np.unique(cells)

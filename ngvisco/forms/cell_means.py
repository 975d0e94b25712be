"""Cell means of a state's density, variables and momentum density, by the rule of the forms.

``Ranges`` keeps parameters within the range of their start values.

A parameter is transported, dt theta + (v . grad) theta = 0, so that its exact solution stays within the range
of its start values. A discontinuous polynomial overshoots at jumps.  In a cell with a point out of range, the
parameter's mean is clipped to the range, and the parameter is scaled towards its mean (Zhang and Shu, J.
Comput. Phys. 229, 2010).

``Stretches`` keeps tensors of bodies positive if the bodies' energies are linear in the tensors and therefore
do not keep them positive.

Body i carries n_i and X_i = n_i B. Its energy C : (X_i - n_i I) has no minimum where X_i is not positive:
such matter stretches without bound.  In a cell where X_i is not positive at a point but its mean is positive,
B moves towards the B of the means,

    X_i <- s X_i + (1 - s) (n_i/n_iK) X_iK,

with the largest s that leaves ``SHARE`` of the second summand at each such point.  The limiter does not
change n_i, the mean of X_i, rho and v. It does not change an energy linear in X_i either, so that it takes no
energy.
"""

from functools import cached_property

import numpy as np
from ngsolve import CF, L2, BilinearForm, CoefficientFunction, GridFunction, VectorValued, dx

from ngvisco.forms.mesh.points import csr
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.projections import LocalProjection
from ngvisco.forms.system import Step
from ngvisco.forms.term import tested
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import Parameter

SHARE = 1e-2
"""Least value of a bounded quantity at the points of a limited cell, relative to its value for the mean.

A cell is limited only if a bounded quantity is <= 0 at a point. It is not limited if the quantity is only
below this share of the mean: a density that falls to zero along a line stays unchanged.
"""


class CellMeans:
    """Cell means of rho and z of a step's present state, and the state's coefficients by cells."""

    def __init__(self, step: Step) -> None:
        self.step = step
        space, size = L2(step.mesh, order=0), step.layout.states.size
        self.rho, self.z = GridFunction(space), GridFunction(VectorValued(space, size))
        self._projections = [
            LocalProjection(target, step.quadrature, tested(value))
            for target, value in ((self.rho, step.now.rho), (self.z, step.now.z))
        ]
        self._space = step.layout.scalar_space("z")
        one = GridFunction(self._space)
        one.Set(1.0)
        self.one = one.vec.FV().NumPy()
        """Coefficients of the constant 1 in the space of every component of z, and of rho."""

    def project(self) -> None:
        """Compute the means of the present state."""
        for projection in self._projections:
            projection()

    @cached_property
    def _of_momentum(self) -> LocalProjection:
        target = GridFunction(VectorValued(self.rho.space, self.step.mesh.dim))
        return LocalProjection(target, self.step.quadrature, tested(self.step.momentum_old))

    def momentum(self) -> GridFunction:
        """Cell means of the step's start momentum density, kg/(m^2 s)."""
        self._of_momentum()
        return self._of_momentum.target

    def of_cells(self, name: str) -> np.ndarray:
        """Means of ``"rho"`` or ``"z"``, (components, cells)."""
        function = self.rho if name == "rho" else self.z
        return function.vec.FV().NumPy().reshape(function.dim, -1)

    def coefficients(self, name: str) -> np.ndarray:
        """View of the present coefficients of ``"rho"`` or ``"z"``, (components, functions)."""
        state = self.step.state.vec.FV().NumPy()[self.step.layout.ranges[name]]
        # a rank may have no cells
        return state.reshape(1 if name == "rho" else self.step.layout.states.size, -1)

    def functions(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the functions in the cells of a mask, (cells,), and the cell of each function."""
        chosen = np.flatnonzero(cells[self.owner])
        return chosen, self.owner[chosen]

    @cached_property
    def owner(self) -> np.ndarray:
        """Cell of every function of the scalar space of z, (functions,)."""
        of_cells, space = self.rho.space, self._space
        form = BilinearForm(trialspace=of_cells, testspace=space)
        form += of_cells.TrialFunction() * space.TestFunction() * dx
        return csr(form.Assemble().mat).indices.astype(int)  # each column becomes a row


def least_of(values: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """Minimum of every column over the points of every owner, (count, columns); inf for an owner without
    points."""
    least = np.full((count, values.shape[1]), np.inf)
    np.minimum.at(least, owner, values)
    return least


SLACK = 1e-9
"""Tolerated overshoot, relative to the width of a range; it covers the error of an iteration."""


class Ranges:
    """Keeps the parameters of a step's present state within ``Step.ranges``, at the sampler's points."""

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        self.names = [v.name for v in step.model.material.variables if isinstance(v, Parameter)]
        self.components = [step.layout.states.slices[name].start for name in self.names]
        if self.names:
            self._values = CF(tuple(step.now.z[int(i)] for i in self.components))

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return bool(self.names) and self.sampler.ranks.any(self._outside()[0].any())

    def limit(self) -> np.ndarray:
        """Limit the present parameters to their ranges; return the changed cells of this rank."""
        if not self.is_exceeded():
            return np.zeros(0, dtype=int)
        outside, least, largest = self._outside()
        self._means.project()
        means, one = self._means.of_cells("z")[self.components], self._means.one
        values = self._means.coefficients("z")
        for i, name in enumerate(self.names):
            low, high = self.step.ranges[name]
            targets = np.clip(means[i], low, high)
            below, above = means[i] - least[i], largest[i] - means[i]
            with np.errstate(divide="ignore", invalid="ignore"):
                downwards = np.where(below > 0, (targets - low) / below, np.inf)
                upwards = np.where(above > 0, (high - targets) / above, np.inf)
            share = np.clip(np.minimum(downwards, upwards), 0.0, 1.0)
            dofs, cell = self._means.functions(outside[i])
            row = values[self.components[i]]
            row[dofs] = targets[cell] * one[dofs] + share[cell] * (row[dofs] - means[i][cell] * one[dofs])
        return np.flatnonzero(outside.any(axis=0))

    def _outside(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mask of values out of range, least and largest values, each (parameters, cells)."""
        values = self.sampler.rows(self._values)
        cells, count = self.sampler.cells, self.step.mesh.ne
        least, largest = least_of(values, cells, count), -least_of(-values, cells, count)
        low, high = (np.array(ends) for ends in zip(*(self.step.ranges[n] for n in self.names), strict=True))
        slack = SLACK * np.maximum(high - low, np.maximum(abs(low), abs(high)) * (high == low))
        return ((least < low - slack) | (largest > high + slack)).T, least.T, largest.T


_PART = 0.1  # fraction above which a body takes part (``Mixture.taking_part``)


class Stretches:
    """Keeps the ``linear_contents`` X_i of a step's present state positive, at the sampler's points."""

    def __init__(self, step: Step, sampler: Sampler, means: CellMeans) -> None:
        self.step, self.sampler, self._means = step, sampler, means
        self._amounts: dict[str, str] = {}
        self._signs: dict[str, CoefficientFunction] = {}
        material, z = step.model.material, step.now.z_tensors
        if isinstance(material, Mixture):
            theta, variables = material.fractions.at(z), {v.name: v for v in material.variables}
            for X, body in material.linear_contents.items():
                self._amounts[X] = AMOUNT + body
                self._signs[X] = CF((theta[body] - _PART, *variables[X].positive(z[X]).values()))

    def is_exceeded(self) -> bool:
        """Whether ``limit`` would change the present state."""
        return any(self.sampler.ranks.any(len(self._outside(X)[0]) > 0) for X in self._amounts)

    def limit(self) -> np.ndarray:
        """Make the contents X_i of the present state positive; return the numbers of the changed cells of
        this rank."""
        return np.unique(np.concatenate([np.zeros(0, dtype=int), *[self._limited(X) for X in self._amounts]]))

    def _outside(self, content: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three arrays: the points where X_i of a participating body is not positive, the cells of these
        points, and B of the cells' means."""
        signs = self.sampler.rows(self._signs[content])
        points = np.flatnonzero((signs[:, 0] > 0) & ~(signs[:, 1:] > 0).all(axis=1))
        if self.sampler.ranks.any(len(points) > 0):
            self._means.project()
        states, means = self.step.layout.states, self._means.of_cells("z")
        cells = self.sampler.cells[points]
        amount = means[states.slices[self._amounts[content]].start][cells]
        mean = (means[states.slices[content]].T[cells] @ states.spaces[content].columns.T).reshape(-1, 3, 3)
        good = (amount > 0) & (np.linalg.eigvalsh(mean)[:, 0] > 0)
        return points[good], cells[good], mean[good] / amount[good, None, None]

    def _limited(self, content: str) -> np.ndarray:
        points, cells, mean = self._outside(content)
        if not len(points):
            return cells
        states, z, means = self.step.layout.states, self.step.now.z_tensors, self._means.of_cells("z")
        amount, at = self._amounts[content], self.sampler.points[points]
        X, n = states.slices[content], states.slices[amount].start
        value = np.asarray(z[content](at)).reshape(-1, 3, 3) / np.asarray(z[amount](at)).reshape(-1, 1, 1)
        inverse = np.linalg.inv(np.linalg.cholesky(mean))
        least = np.linalg.eigvalsh(inverse @ value @ inverse.transpose(0, 2, 1))[:, 0]
        share = np.ones(self.step.mesh.ne)
        np.minimum.at(share, cells, (1 - SHARE) / (1 - np.minimum(least, 0.0)))
        values, (dofs, cell) = self._means.coefficients("z"), self._means.functions(share < 1)
        uniform = means[X][:, cell] / means[n][cell] * values[n, dofs]
        values[X, dofs] = uniform + share[cell] * (values[X, dofs] - uniform)
        return np.unique(cells)

"""Means over the cells of a state's density and variables, by the rule of the forms."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np
from ngsolve import L2, BilinearForm, FacetFESpace, GridFunction, Periodic, VectorValued, dx
from scipy.sparse import csr_matrix

from ngvisco.forms.elimination import LocalProjection
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.term import tested
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange

SHARE = 1e-2
"""What a limited cell keeps at every point, at least, of the bounded quantities of its mean.

Measured, a neo-Hookean cavity under a lid of full speed near its corners (230 triangles, dt = 0.02 s, until
0.6 s): with 1e-6, 1e-3 and 1e-2 the same cells are limited and energies agree to 3e-3; the step after, in
which the body is being torn at two corners, the split solver does not take with these, and does with 0.1
(until 0.72 s).  Cells are limited where something is <= 0, not where it is below its share of the mean:
a density that falls to zero along a line is no reason to change it.
"""


class Near(Protocol):
    """Which cells are near which, a matrix (cells, cells) of ones and zeros."""

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """Of values (cells,) or (cells, n) the sums over the cells near each cell."""


class CellMeans:
    """Means over the cells of rho and z of a step's present state."""

    def __init__(self, step: Step) -> None:
        self.step = step
        space, size = L2(step.mesh, order=0), step.model.material.states(step.mesh.dim).size
        self.rho = GridFunction(space)
        self.z = GridFunction(VectorValued(space, size))
        self._projections = [
            LocalProjection(target.space, target, step.quadrature, tested(value))
            for target, value in ((self.rho, step.now.rho), (self.z, step.now.z))
        ]
        one = GridFunction(step.layout.blocks["rho"])
        one.Set(1.0)
        self.one = one.vec.FV().NumPy()
        """Coefficients of the constant 1 in the space of rho, and of every component of z."""

    def project(self) -> None:
        """Make them those of the present state."""
        for projection in self._projections:
            projection()

    def array(self, name: str) -> np.ndarray:
        """Means of ``"rho"`` or ``"z"``, (components, cells)."""
        function = self.rho if name == "rho" else self.z
        return function.vec.FV().NumPy().reshape(function.dim, -1)

    @cached_property
    def owner(self) -> np.ndarray:
        """The cell of every function of rho's space, (functions,)."""
        of_cells, space = self.rho.space, self.step.layout.blocks["rho"]
        form = BilinearForm(trialspace=of_cells, testspace=space)
        form += of_cells.TrialFunction() * space.TestFunction() * dx
        return csr(form.Assemble().mat).indices.astype(int)  # one column a row

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volumes of the cells by the same rule, m^dim, (cells,)."""
        space = self.rho.space
        mass = BilinearForm(space, diagonal=True)
        trial, test = space.TnT()
        mass += trial * test * self.step.quadrature.cells
        matrix = mass.Assemble().mat
        return getattr(matrix, "local_mat", matrix).AsVector().FV().NumPy().copy()

    @cached_property
    def neighbours(self) -> Near:
        """1 for two cells with a common facet, also an identified one or of different ranks."""
        facets = FacetFESpace(self.step.mesh, order=0)
        if self.step.layout.periodic:
            facets = Periodic(facets)
        form = BilinearForm(trialspace=self.rho.space, testspace=facets)
        form += self.rho.space.TrialFunction() * facets.TestFunction() * dx(element_boundary=True)
        incidence = csr(form.Assemble().mat)
        shared = (incidence.T @ incidence).tocsr()
        shared.setdiag(0.0)
        shared.eliminate_zeros()
        shared.data[:] = 1.0
        exchange = Exchange.of(facets, Communicator.of(self.step.mesh))
        return _AcrossRanks(shared, incidence, exchange) if exchange.is_distributed else shared


class _AcrossRanks:
    """Neighbours in a distributed mesh: this rank's, and across facets that another one has too."""

    def __init__(self, own: csr_matrix, incidence: csr_matrix, exchange: Exchange) -> None:
        self.own, self.exchange = own, exchange
        self.border = incidence[exchange.places]  # of each such facet this rank has one cell
        self.border.data[:] = 1.0

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        across = self.exchange.others((self.border @ values).T)
        return self.own @ values + self.border.T @ across.T

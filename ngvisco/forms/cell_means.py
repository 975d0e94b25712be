"""Means over the cells of a state's density, variables and momentum density, by the rule of the forms."""

from functools import cached_property

import numpy as np
from ngsolve import L2, BilinearForm, GridFunction, VectorValued, dx

from ngvisco.forms.elimination import LocalProjection
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.term import tested

SHARE = 1e-2
"""What a limited cell keeps at every point, at least, of the bounded quantities of its mean.

Measured, a neo-Hookean cavity under a lid of full speed near its corners (230 triangles, dt = 0.02 s, until
0.6 s): with 1e-6, 1e-3 and 1e-2 the same cells are limited and energies agree to 3e-3; the step after, in
which the body is being torn at two corners, the split solver does not take with these, and does with 0.1
(until 0.72 s).  Cells are limited where something is <= 0, not where it is below its share of the mean:
a density that falls to zero along a line is no reason to change it.
"""


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

    @cached_property
    def momentum(self) -> GridFunction:
        """Of the momentum density that the step starts from, kg/(m^2 s)."""
        return GridFunction(VectorValued(self.rho.space, self.step.mesh.dim))

    @cached_property
    def _momentum_projection(self) -> LocalProjection:
        load = tested(self.step.momentum_old)
        return LocalProjection(self.momentum.space, self.momentum, self.step.quadrature, load)

    def project_momentum(self) -> None:
        """Make ``momentum`` that of the present ``momentum_old``."""
        self._momentum_projection()

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

"""Variations of integrals over a body: slopes of their values by all coefficients of a state."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from ngsolve import (
    VOL,
    BilinearForm,
    CoefficientFunction,
    ElementId,
    FESpace,
    GridFunction,
    LinearForm,
    Variation,
)
from scipy import sparse as sp

from ngvisco.forms.mesh.quadrature import compiled
from ngvisco.forms.projections import inverse_mass
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand
from ngvisco.run.fields import output_fields
from ngvisco.run.frames import Lattice

Slope = Callable[[], np.ndarray]
"""Function that returns a slope at the present state, (unknowns,)."""


class Variations:
    """Slopes of integrals whose integrands are functions of ``trial``, at the present state of a step."""

    def __init__(self, step: Step) -> None:
        self.step, self.space = step, step.layout.space
        self.trial = step.linearised_fields(self.space.TrialFunction())
        """Fields of trial functions of the state."""
        self._vector = step.state.vec.CreateVector()

    def of(self, integrand: Integrand, prepare: Callable[[], None] = lambda: None) -> Slope:
        """Slope of an integral by the step's rules; ``prepare`` updates functions in the integrand first."""
        quadrature, form = self.step.quadrature, BilinearForm(self.space)
        for part, integral in (
            (integrand.cells, quadrature.cells),
            (integrand.facets, quadrature.facets),
            (integrand.collocated, quadrature.collocated),
        ):
            if part is not None:
                form += Variation(integral(compiled(part)))
        return self.applied(form, prepare)

    @cached_property
    def trial_fields(self) -> dict[str, CoefficientFunction]:
        """The run's fields as functions of ``trial``, by their names."""
        return output_fields(self.step, self.trial)

    @cached_property
    def fields(self) -> dict[str, CoefficientFunction]:
        """The run's fields at the present state, by their names."""
        return output_fields(self.step)

    def of_fields(self, density: Callable[[dict[str, CoefficientFunction]], CoefficientFunction]) -> Slope:
        """Slope of the integral over cells of a function of the run's fields.

        The energy of a material without an expression is projected, P phi(z), and its weight w in the
        integral becomes the weight P w of phi(z).
        """
        own, projected = self.of(Integrand(cells=density(self.trial_fields))), self.step.energy.projected
        if projected is None:
            return own
        quadrature, weight = self.step.quadrature, GridFunction(projected.space)
        load = LinearForm(projected.space)
        by_energy = density(self.fields).Diff(projected, projected.space.TestFunction())
        load += quadrature.cells(by_energy)
        inverse = inverse_mass(projected.space, quadrature)

        def project() -> None:
            weight.vec.data = inverse * load.Assemble().vec

        of_energy = self.of(Integrand(cells=weight * self.step.energy.near(self.trial)), project)
        return lambda: own() + of_energy()

    def applied(self, form: BilinearForm, prepare: Callable[[], None]) -> Slope:
        """Slope of the energy of an NGSolve form."""

        def slope() -> np.ndarray:
            prepare()
            form.Apply(self.step.state.vec, self._vector)
            return self._vector.FV().NumPy().copy()

        return slope


def basis_at(space: FESpace, lattice: Lattice) -> sp.csc_matrix:
    """The matrix from coefficients of a scalar space to values at points of cells, (points, unknowns)."""
    of_cells = [space.GetDofNrs(ElementId(VOL, cell)) for cell in range(space.mesh.ne)]
    function, cells = GridFunction(space), lattice.of_points
    coefficients, matrix = function.vec.FV().NumPy(), sp.csc_matrix((len(cells), space.ndof))
    for number in range(max(map(len, of_cells))):
        dofs = np.array([own[number] if number < len(own) else -1 for own in of_cells])
        coefficients[:] = 0.0
        coefficients[dofs[dofs >= 0]] = 1.0
        at = dofs[cells]
        there = np.flatnonzero(at >= 0)
        values = lattice.values(function)[there, 0]
        matrix = matrix + sp.csc_matrix((values, (there, at[there])), matrix.shape)
    return matrix

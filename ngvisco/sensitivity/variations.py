"""Variations of integrals over a body: slopes of their values by all coefficients of a state."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np
from ngsolve import (
    VOL,
    BaseVector,
    BilinearForm,
    CoefficientFunction,
    ElementId,
    FESpace,
    GridFunction,
    LinearForm,
    Parameter,
    Variation,
)
from scipy import sparse as sp

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.quadrature import compiled
from ngvisco.forms.projections import inverse_mass
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand
from ngvisco.run.fields import output_fields
from ngvisco.run.frames import Lattice

Slope = Callable[[], np.ndarray]
"""Function that returns a slope at the present state, (unknowns,)."""


class Variations:
    """Slopes of integrals whose integrands are functions of ``trial``, at one state of a step.

    Parameters
    ----------
    step : Step
    trial : Fields, optional
        Fields whose unknowns are trial functions; by default the fields of the step's present state.
    at : BaseVector, optional
        Coefficients at which the trial functions are evaluated, by default the present state.
    weight : Parameter, optional
        Weight of the trial functions in the step's start, if they are those of a start state.
    """

    def __init__(
        self,
        step: Step,
        trial: Fields | None = None,
        at: BaseVector | None = None,
        weight: Parameter | None = None,
    ) -> None:
        self.step, self.space = step, step.layout.space
        self.trial = step.linearised_fields(self.space.TrialFunction()) if trial is None else trial
        self._at = step.state.vec if at is None else at
        self._vector = step.state.vec.CreateVector()
        self.weight = Parameter(1.0) if weight is None else weight
        changed = step.state if weight is None else step.state_old
        self.coefficients: np.ndarray = changed.vec.FV().NumPy()
        """Coefficients to which the trial functions times ``weight`` are added, (unknowns,), as a view."""

    def of(self, integrand: Integrand, prepare: Callable[[], None] = lambda: None) -> Slope:
        """Slope of an integral by the step's quadrature rules.

        The slope calls ``prepare`` first, which updates functions in the integrand.
        """
        return self.of_sum([integrand], prepare)

    def of_sum(self, integrands: Iterable[Integrand], prepare: Callable[[], None] = lambda: None) -> Slope:
        """Slope of a sum of integrals, whose summands are differentiated one by one."""
        quadrature, form = self.step.quadrature, BilinearForm(self.space)
        for integrand in integrands:
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
        """Slope of the integral over cells of a function of the run's fields."""
        at_trial = [Integrand(density(self.trial_fields))]
        present = [] if self.step.energy.projected is None else [Integrand(density(self.fields))]
        return self._with_energy(at_trial, present)

    def of_integrands(
        self, make: Callable[[Fields], Mapping[str, list[Integrand]]], names: Sequence[str]
    ) -> dict[str, Slope]:
        """Slopes of sums of integrals, by name.  ``make`` returns the summands for the fields of a state."""
        present = {} if self.step.energy.projected is None else make(self.step.now)
        of_trial = make(self.trial)
        return {name: self._with_energy(of_trial[name], present.get(name, [])) for name in names}

    def _with_energy(self, integrands: Sequence[Integrand], present: Sequence[Integrand]) -> Slope:
        """Slope of a sum of integrals, including the dependence through the stored energy.

        The energy of a material without an expression is a projection P phi(z). If P phi(z) has the weight w
        in the integrals at the ``present`` state, phi(z) has the weight P w.
        """
        direct, projected = self.of_sum(integrands), self.step.energy.projected
        if projected is None:
            return direct
        quadrature, weight = self.step.quadrature, GridFunction(projected.space)
        load, test = LinearForm(projected.space), projected.space.TestFunction()
        for integrand in present:
            if integrand.cells is not None:
                load += quadrature.cells(integrand.cells.Diff(projected, test))
            if integrand.facets is not None:
                load += quadrature.facets(integrand.facets.Diff(projected, test))
        inverse = inverse_mass(projected.space, quadrature)

        def project() -> None:
            weight.vec.data = inverse * load.Assemble().vec

        of_energy = self.of(Integrand(cells=weight * self.step.energy.near(self.trial)), project)
        return lambda: direct() + of_energy()

    def applied(self, form: BilinearForm, prepare: Callable[[], None]) -> Slope:
        """Slope of the energy of an NGSolve form."""

        def slope() -> np.ndarray:
            prepare()
            form.Apply(self._at, self._vector)
            return self._vector.FV().NumPy().copy()

        return slope


def basis_at(space: FESpace, lattice: Lattice) -> sp.csc_matrix:
    """The matrix from coefficients of a scalar space to values at points of cells, (points, unknowns)."""
    of_cells = [space.GetDofNrs(ElementId(VOL, cell)) for cell in range(space.mesh.ne)]
    function, cells = GridFunction(space), lattice.of_points
    coefficients, matrix = function.vec.FV().NumPy(), sp.csc_matrix((len(cells), space.ndof))
    for number in range(max(map(len, of_cells))):
        dofs = np.array([of_cell[number] if number < len(of_cell) else -1 for of_cell in of_cells])
        coefficients[:] = 0.0
        coefficients[dofs[dofs >= 0]] = 1.0
        at = dofs[cells]
        there = np.flatnonzero(at >= 0)
        values = lattice.values(function)[there, 0]
        matrix = matrix + sp.csc_matrix((values, (there, at[there])), matrix.shape)
    return matrix

"""What only forms have: terms restricted to some unknowns, and sources that are known beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, BilinearForm, FESpace, Grad, GridFunction, LinearForm
from ngsolve.la import PARALLEL_STATUS

from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.term import GivenParts, Integrand, Term, WithheldError
from ngvisco.reduced.unknowns import Unknowns


class RestrictedForm:
    """Rows and columns of ``names`` of the given terms, by the terms' own forms."""

    def __init__(self, step: Step, names: Sequence[str], terms: Sequence[Term]) -> None:
        layout, self.names, self.step = step.layout, list(names), step
        self.space = FESpace([layout.blocks[name] for name in self.names])
        trial, test = (dict(zip(self.names, parts, strict=True)) for parts in self.space.TnT())
        known = dict(zip(layout.names, step.state.components, strict=True))
        tests = {name: _zero(layout.blocks[name]) for name in layout.names} | test

        def gradient(name: str) -> Any:  # a constant has none for NGSolve
            value = tests[name]
            if name in self.names:
                return Grad(value)
            return CF((0.0,) * (value.dim * layout.mesh.dim), dims=(*value.dims, layout.mesh.dim))

        u, w = Fields(layout, known | trial), Tests(layout, tests, gradient=gradient)
        self.form = BilinearForm(self.space, check_unused=False)
        for term in terms:
            step.quadrature.add(self.form, term.form(u, w))
        self.at = GridFunction(self.space)
        self._rows = self.at.vec.CreateVector()
        self.free = mask_of(self.space.FreeDofs())

    def _load(self) -> None:
        state, ranges = self.step.state.vec.FV().NumPy(), self.step.layout.ranges
        self.at.vec.SetParallelStatus(PARALLEL_STATUS.CUMULATED)
        self.at.vec.FV().NumPy()[:] = np.concatenate([state[ranges[name]] for name in self.names])

    def residual(self) -> np.ndarray:
        """The rows at the present state, block after block; over ranks in parts."""
        self._load()
        self.form.Apply(self.at.vec, self._rows)
        return self._rows.FV().NumPy().copy()

    def jacobian(self) -> sp.csr_matrix:
        """Their derivative in the unknowns of ``names``."""
        self._load()
        self.form.AssembleLinearization(self.at.vec)
        return csr(self.form.mat)


def _zero(space: FESpace) -> Any:
    trial = space.TrialFunction()
    return CF((0.0,) * trial.dim, dims=tuple(trial.dims)) if trial.dims else CF(0.0)


class RightHandSide:
    """The rows of a step's source, packed as the unknowns, added to the residual.

    Raises WithheldError for a source that takes unknowns, or has rows that the split solver has not.
    """

    def __init__(self, step: Step) -> None:
        assert step.sources is not None
        names = Unknowns(step).names
        space = FESpace([step.layout.blocks[name] for name in names])
        u = GivenParts(
            {}, "a source takes the unknown {name}, which the split solver does not know beforehand"
        )
        tests = dict(zip(names, space.TestFunction(), strict=True))
        w = GivenParts(tests, "a source has a row of {name}, which the split solver does not iterate on")
        self._form = LinearForm(space)
        integrands: list[Integrand] = step.sources.form(Fields(step.layout, u), Tests(step.layout, w))
        step.quadrature.add(self._form, integrands)

    def start(self) -> None:
        """Assemble for the present step."""
        self.rows = self._form.Assemble().vec.FV().NumPy().copy()


def source_obstacle(step: Step) -> str | None:
    """Why the step's source cannot be assembled before the iteration, or None."""
    try:
        if step.sources is not None:
            RightHandSide(step)
    except WithheldError as error:
        return str(error)
    return None

"""Terms of the step restricted to some of its unknowns, the others known: residual and Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import CF, BilinearForm, FESpace, Grad, GridFunction
from ngsolve.la import PARALLEL_STATUS

from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.term import Term


class RestrictedForm:
    """Rows and columns of ``names`` of the given terms, by the terms' own forms."""

    def __init__(self, step: Step, names: Sequence[str], terms: Sequence[Term]) -> None:
        layout, self.names, self.step = step.layout, list(names), step
        blocks = [layout.blocks[name] for name in self.names]
        self.space = FESpace(blocks)
        known = dict(zip(layout.names, step.state.components, strict=True))
        trial, test = self.space.TnT()
        zero: dict[str, Any] = {name: _zero(layout.blocks[name]) for name in layout.names}
        u = Fields(layout, known | dict(zip(self.names, trial, strict=True)))
        tests = zero | dict(zip(self.names, test, strict=True))

        def gradient(name: str) -> Any:  # a constant has none for NGSolve
            value = tests[name]
            if name in self.names:
                return Grad(value)
            return CF((0.0,) * (value.dim * layout.mesh.dim), dims=(*value.dims, layout.mesh.dim))

        w = Fields(layout, tests, gradient=gradient)
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

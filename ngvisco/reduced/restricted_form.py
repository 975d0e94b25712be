"""Rows of terms that arrays do not evaluate, in some unknowns, by NGSolve's forms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import BilinearForm, FESpace, Grad, GridFunction, ZeroCF
from ngsolve.la import PARALLEL_STATUS

from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.term import Term


class RestrictedForm:
    """Evaluates rows of some unknowns by the forms of the given terms, and the rows' derivatives by these
    unknowns."""

    def __init__(self, step: Step, names: Sequence[str], terms: Sequence[Term]) -> None:
        layout, self.names, self.step = step.layout, list(names), step
        self.space = FESpace([layout.blocks[name] for name in self.names])
        trial, test = (dict(zip(self.names, parts, strict=True)) for parts in self.space.TnT())
        components = dict(zip(layout.names, step.state.components, strict=True))
        tests = {name: ZeroCF(tuple(components[name].dims)) for name in layout.names} | test

        def gradient(name: str) -> Any:  # NGSolve has no gradient of a constant
            value = tests[name]
            return Grad(value) if name in self.names else ZeroCF((*value.dims, layout.mesh.dim))

        u, w = Fields(layout, components | trial), Tests(layout, tests, gradient=gradient)
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
        """The rows at the present state, block after block.

        On each rank the rows are sums over that rank's cells.
        """
        self._load()
        self.form.Apply(self.at.vec, self._rows)
        return self._rows.FV().NumPy().copy()

    def jacobian(self) -> sp.csr_matrix:
        """The derivative of the rows by the unknowns ``names``."""
        self._load()
        self.form.AssembleLinearization(self.at.vec)
        return csr(self.form.mat)

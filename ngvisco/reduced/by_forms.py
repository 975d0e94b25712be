"""What only forms have: terms restricted to some unknowns, and sources that are known beforehand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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

        w = Tests(layout, tests, gradient=gradient)
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


def source_obstacle(step: Step) -> str | None:
    """Why the step's source cannot be assembled before the iteration, or None."""
    if step.sources is None:
        return None
    try:
        names = receivers(step)
        _integrands(step, joint_space(step, names), names)
    except WithheldError as error:
        return str(error)
    return None


def receivers(step: Step) -> list[str]:
    """Names of the unknowns whose equations may have sources."""
    allowed = Unknowns(step).names
    return [name for name in step.layout.names if name in allowed]


def joint_space(step: Step, names: Iterable[str]) -> FESpace:
    return FESpace([step.layout.blocks[name] for name in names])


def _integrands(step: Step, space: FESpace, names: list[str]) -> list[Integrand]:
    """The source's form, of tests of ``names`` in their joint space and of no unknowns."""
    assert step.sources is not None
    u = GivenParts({}, "a source takes the unknown {name}, which the split solver does not know beforehand")
    tests = dict(zip(names, space.TestFunction(), strict=True))
    w = GivenParts(tests, "a source has a row of {name}, which the split solver does not iterate on")
    return step.sources.form(Fields(step.layout, u), Tests(step.layout, w))


class RightHandSide:
    """The rows of a step's source, added to the residual."""

    def __init__(self, step: Step, unknowns: Unknowns) -> None:
        self.step, self.unknowns = step, unknowns
        self.names = receivers(step)
        self.space = joint_space(step, self.names)
        self.form = LinearForm(self.space)
        step.quadrature.add(self.form, _integrands(step, self.space, self.names))
        self.rows: dict[str, np.ndarray] = {}

    def start(self) -> None:
        """Assemble for the present step."""
        self.form.Assemble()
        values = self.form.vec.FV().NumPy()
        ranges = [self.space.Range(i) for i in range(len(self.names))]
        self.rows = {n: values[r.start : r.stop].copy() for n, r in zip(self.names, ranges, strict=True)}

    def of(self, names: Iterable[str]) -> np.ndarray:
        """The rows of these unknowns, one after the other."""
        return np.concatenate([np.zeros(0), *(self.rows[name] for name in names)])

"""Sources of a step in the split solver: rows that are known before the iteration.

A source is a term of the step that is linear in the tests and takes no unknown (``Simulation``'s
``sources``).  Its rows are assembled once a step.  Those of z_delta_hat, which is eliminated from the
equations of the delta-regularised z, go to z by the same elimination.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from ngsolve import FESpace, LinearForm

from ngvisco.forms.context import Integrand
from ngvisco.forms.spaces import Fields
from ngvisco.forms.system import Step
from ngvisco.solver.split.operators import apply
from ngvisco.solver.split.preconditioner import Residual
from ngvisco.solver.split.transport import Transport
from ngvisco.solver.split.unknowns import Unknowns
from ngvisco.solver.split.withheld import GivenParts, WithheldError

ELIMINATED = "z_delta_hat"
"""The one derived unknown whose equation may have a source: that of the flux through walls."""


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
    allowed = (*Unknowns(step).names, ELIMINATED)
    return [name for name in step.layout.names if name in allowed]


def joint_space(step: Step, names: Iterable[str]) -> FESpace:
    return FESpace([step.layout.blocks[name] for name in names])


def _integrands(step: Step, space: FESpace, names: list[str]) -> list[Integrand]:
    """The source's form, of tests of ``names`` in their joint space and of no unknowns."""
    assert step.sources is not None
    u = GivenParts({}, "a source takes the unknown {name}, which the split solver does not know beforehand")
    tests = dict(zip(names, space.TestFunction(), strict=True))
    w = GivenParts(tests, "a source has a row of {name}, which the split solver does not iterate on")
    return step.sources.form(Fields(step.layout, u), Fields(step.layout, w))


class KnownRows:
    """The rows of a step's source, added to the residual."""

    def __init__(self, step: Step, transport: Transport, unknowns: Unknowns) -> None:
        self.step, self.transport, self.unknowns = step, transport, unknowns
        self.names = receivers(step)
        self.space = joint_space(step, self.names)
        self.form = LinearForm(self.space)
        step.quadrature.add(self.form, _integrands(step, self.space, self.names))
        self._eliminates = ELIMINATED in self.names
        self.rows: dict[str, np.ndarray] = {}
        self._hats = np.zeros(0)

    def start(self) -> None:
        """Assemble for the present step."""
        self.form.Assemble()
        values = self.form.vec.FV().NumPy()
        ranges = [self.space.Range(i) for i in range(len(self.names))]
        self.rows = {n: values[r.start : r.stop].copy() for n, r in zip(self.names, ranges, strict=True)}
        if self._eliminates:
            t = self.transport
            loads = self.rows.pop(ELIMINATED).reshape(t.n, -1)
            self._hats = t.delta_hats(loads)
            self.rows["z"] = self.rows["z"] + apply(t.to_delta_trace.T.tocsr(), loads).ravel()

    def correct_traces(self) -> None:
        """What the source makes of z_delta_hat, into the state."""
        if self._eliminates:
            self.unknowns.state[self.step.layout.ranges[ELIMINATED]] -= self._hats.ravel()

    def add_to(self, residual: Residual) -> None:
        """Add the rows to those of the equations."""
        u = self.unknowns
        parts = [(u.flow, residual.flow), (u.density, residual.density), (["z"], residual.z)]
        if residual.normals is not None:
            parts.append((u.normals, residual.normals))
        for names, target in parts:
            rows = np.concatenate([self.rows[name] for name in names])
            target += rows.reshape(target.shape)

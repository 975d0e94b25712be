"""Sources of a step in the split solver: rows that are known before the iteration.

A source is a term of the step that is linear in the tests and takes no unknown (``Simulation``'s
``sources``).  Its rows are assembled once a step.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from ngsolve import FESpace, LinearForm

from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Step
from ngvisco.forms.term import Integrand
from ngvisco.forms.withheld import GivenParts, WithheldError
from ngvisco.reduced.unknowns import Unknowns


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
    return step.sources.form(Fields(step.layout, u), Fields(step.layout, w))


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
        return np.concatenate([self.rows[name] for name in names])

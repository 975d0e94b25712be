"""The rows of a step's source, assembled before the iteration."""

from __future__ import annotations

from ngsolve import FESpace, LinearForm

from ngvisco.forms.fields import Fields, Tests
from ngvisco.forms.system import Step
from ngvisco.forms.term import GivenParts, WithheldError
from ngvisco.reduced.unknowns import Unknowns


class RightHandSide:
    """Rows of a step's source. They are packed like the unknowns, and added to the residual.

    Raises WithheldError for a source that depends on unknowns, or tests an unknown that is not iterated.
    """

    def __init__(self, step: Step) -> None:
        assert step.sources is not None
        names = Unknowns(step).names
        space = FESpace([step.layout.blocks[name] for name in names])
        u = GivenParts(
            {},
            "a source reads the unknown {name}, but for the split solver a source may depend only on place "
            "and time",
        )
        tests = dict(zip(names, space.TestFunction(), strict=True))
        w = GivenParts(
            tests, "a source has a row of {name}, which is not an iterated unknown of the split solver"
        )
        self._form = LinearForm(space)
        step.quadrature.add(self._form, step.sources.form(Fields(step.layout, u), Tests(step.layout, w)))

    def start(self) -> None:
        """Assemble the rows for the present step."""
        self.rows = self._form.Assemble().vec.FV().NumPy().copy()


def source_obstacle(step: Step) -> str | None:
    """The reason why the step's source cannot be assembled before the iteration, or None."""
    try:
        if step.sources is not None:
            RightHandSide(step)
    except WithheldError as error:
        return str(error)
    return None

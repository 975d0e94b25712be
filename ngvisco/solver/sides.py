"""The velocity v* that says which side of a facet is upstream, chosen before a step is solved.

v* is the velocity extrapolated through the last two solutions, else the last one.  Where it misses the side,
the flow through the facet is slow, and its error is of the scheme's order: but in a start from rest, and in a
step that turns the flow round.  So once the increments are below ``NewtonOptions.sides`` the step's own
velocity is looked at.  Where it carries matter through more than ``COURANT`` of a cell from the wrong side, or
from one that v* leaves open, it becomes v*, and the iteration goes on with equations that are smooth again.
"""

from __future__ import annotations

import numpy as np
from ngsolve import IfPos

from ngvisco.forms.system import Step

COURANT = 0.1
"""|v . n| tau/h from which a wrong side matters."""

CORRECTIONS = 2
"""Of v* in a step, at most."""

_LOST = 0.25
"""Share of the downstream side in the trace from which its side is wrong."""


class Sides:
    """Chooses ``Step.wind``."""

    def __init__(self, step: Step) -> None:
        self.step = step
        self.corrections = 0
        """In the present step."""
        c, (v, h) = step.context, (step.now.v, step.context.h)
        through = c.inner * (v * c.normal)
        fast = IfPos(through * through - (COURANT * h / c.tau) ** 2, 1.0, 0.0)
        downstream = IfPos(through, c.upwinding.inflow, c.upwinding.share)
        self._wrong = (fast * IfPos(downstream - _LOST, 1.0, 0.0)).Compile()

    def choose(self, velocity: np.ndarray) -> None:
        """Take the coefficients ``velocity`` for v*, (unknowns of v,), m/s; a new step begins."""
        self.corrections = 0
        self.step.wind.vec.FV().NumPy()[:] = velocity

    def turn(self) -> bool:
        """Take the velocity of the step's state for v*, if some side is wrong and may be corrected still."""
        if self.corrections >= CORRECTIONS or not self.step.quadrature.integrate_facets(self._wrong) > 0:
            return False
        self.corrections += 1
        v = self.step.layout.ranges["v"]
        self.step.wind.vec.FV().NumPy()[:] = self.step.state.vec.FV().NumPy()[v]
        return True

"""Signed distances from the bodies' outlines at the start, which the flow carries.

    dt phi + (v . grad) phi = 0,     where phi starts as the distance from the outline, m, > 0 in the body.

Distances are discontinuous P_k, with the velocity's order k.  The mean velocity of the run's step carries
them, by a scheme of order 3.  Distances have kinks in slots and at corners. By the midpoint rule the short
waves of these kinks would lag behind.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CoefficientFunction, GridFunction

from ngvisco.errors import StepError
from ngvisco.forms.carrier import Carrier
from ngvisco.forms.system import Step
from ngvisco.shapes.distance import signed_distance
from ngvisco.shapes.shape import as_shape

_G = 0.43586652150845906  # the root of g^3 - 3 g^2 + 3 g/2 - 1/6 between 1/6 and 1/2
_STAGES = ((), ((1 - _G) / 2,), (-1.5 * _G**2 + 4 * _G - 0.25, 1.5 * _G**2 - 5 * _G + 1.25))
"""Rows of the tableau of R. Alexander, SIAM J. Numer. Anal. 14 (1977), left of its diagonal ``_G``: order 3,
L-stable; the last stage is the end of the step."""


class Distances:
    """Distances of bodies with a place; none without ``Discretisation.outlines``."""

    def __init__(self, step: Step) -> None:
        self._step, order = step, step.discretisation.k
        bodies = step.model.bodies if step.discretisation.outlines else ()
        shapes = {
            body.name: as_shape(f"bodies[{body.name!r}].where", body.where)
            for body in bodies
            if body.where is not None
        }
        self.parts = {name: signed_distance(step.mesh, shape, order) for name, shape in shapes.items()}
        """Distances of bodies at the start of the present step, by the bodies' names."""
        self._ends = {name: GridFunction(part.space) for name, part in self.parts.items()}
        self._mean = GridFunction(step.layout.blocks["v"])
        self._carrier = Carrier(step, False, None, self._mean) if shapes else None

    def begin(self) -> None:
        """Begin a step, or repeat it."""
        self._mean.vec[:] = 0.0

    def stage(self, weights: np.ndarray, share: float) -> None:
        """Add the velocity of the present state, times ``share``, to the step's mean velocity."""
        v = self._step.state.vec.FV().NumPy()[self._step.layout.ranges["v"]]
        self._mean.vec.FV().NumPy()[:] += share * v

    def carry(self, tau: float) -> None:
        """Carry the distances over a step of length ``tau``, s, to its end.

        Raises StepError if a linear system is not solved.
        """
        if self._carrier is None:
            return
        self._carrier.tau.Set(_G * tau)
        self._carrier.form.Assemble()
        for name, part in self.parts.items():
            start = end = part.vec.FV().NumPy().copy()
            changes: list[np.ndarray] = []
            for row in _STAGES:
                old = start + sum(a * change for a, change in zip(row, changes, strict=True))
                end, is_solved = self._carrier.carry(old, None)
                if not is_solved:
                    message = f"the outline of {name!r} was not carried: no solution; take a smaller step"
                    raise StepError(message)
                changes.append((end - old) / _G)
            self._ends[name].vec.FV().NumPy()[:] = end

    def of(self, name: str, at_start: bool) -> CoefficientFunction:
        """Distance of a body at the start or at the end of the step, m."""
        return (self.parts if at_start else self._ends)[name]

    def end(self, weights: np.ndarray) -> None:
        """Accept the step."""
        for name, part in self.parts.items():
            part.vec.data = self._ends[name].vec

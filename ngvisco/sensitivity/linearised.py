"""Linear systems for a run's derivatives: the equations of a stage, and the velocity of a momentum."""

from __future__ import annotations

import numpy as np
from ngsolve import BitArray

from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.trajectory import RecordedStep, Stage
from ngvisco.solver.newton import CondensedJacobian

_INVERSE = "umfpack"


class Linearised:
    """Solves systems with the derivative R_u of a stage's equations, with its transpose, and with the
    symmetric mass matrix of a combined end.

    The coupled solver's equations are used also for runs of the split solver, because the solutions satisfy
    equal equations R(u) = 0.
    """

    def __init__(self, follower: Follower) -> None:
        self.follower, step = follower, follower.step
        self._jacobian = CondensedJacobian(step.whole_residual, _INVERSE, follower.simulation.ranks)
        self._rows, self._solution = (step.state.vec.CreateVector() for _ in range(2))
        self.free = np.array(list(step.layout.space.FreeDofs()))
        """Mask of the coefficients that no wall prescribes, (unknowns,)."""

    def at_stage(self, stage: Stage) -> None:
        """Factorise R_u at a stage's solution; the stage has to be posed."""
        self.follower.at(stage.state, stage)
        self._jacobian.factorise(self.follower.step.state.vec)

    def stage(self, rows: np.ndarray, transposed: bool = False) -> np.ndarray:
        """Solve with R_u or its transpose for ``rows``; the result is zero where walls prescribe values."""
        self._rows.FV().NumPy()[:] = np.where(self.free, rows, 0.0)
        solve = self._jacobian.solve_transposed if transposed else self._jacobian.solve
        solve(self._rows, self._solution)
        return np.where(self.free, self._solution.FV().NumPy(), 0.0)

    def at_end(self, recorded: RecordedStep) -> None:
        """Factorise the mass matrix of a combined end, with the walls' multipliers."""
        step = self.follower.step
        step.state.vec.FV().NumPy()[:] = recorded.after
        form, layout = self.follower.momentum, step.layout
        form.AssembleLinearization(step.state.vec)
        kept = BitArray(layout.space.ndof)
        kept.Clear()
        for name in ("v", "wall_stress"):
            if name in layout.ranges:
                for dof in range(layout.ranges[name].start, layout.ranges[name].stop):
                    kept[dof] = True
        kept &= layout.space.FreeDofs()
        self._mass = form.mat.Inverse(kept, inverse=_INVERSE)
        self._velocity = np.zeros(layout.space.ndof, dtype=bool)
        self._velocity[layout.ranges["v"]] = self.free[layout.ranges["v"]]

    def end(self, rows: np.ndarray) -> np.ndarray:
        """Solve with the mass matrix for ``rows`` of the momentum: the change of v, with zeros for all other
        unknowns."""
        self._rows.FV().NumPy()[:] = rows
        self._solution.data = self._mass * self._rows
        return np.where(self._velocity, self._solution.FV().NumPy(), 0.0)

"""The trajectory of a run: the solutions of all its Rothe steps, and the states that each step started
from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.forms.context import time
from ngvisco.physics.variables import PRESSURE
from ngvisco.run.simulation import Simulation
from ngvisco.solver.problem import Interval


@dataclass(frozen=True)
class Stage:
    """A solved Rothe step of a run.

    ``state`` has the coefficients of its solution, ``starts`` the weights of the states y_0, y_1, ... in its
    start value, and ``share`` is the scheme's b_i.  Flow rules are linearised at ``stresses``.
    """

    state: np.ndarray
    starts: np.ndarray
    share: float
    interval: Interval
    stresses: dict[str, np.ndarray]


@dataclass(frozen=True)
class RecordedStep:
    """A step of the scheme, from ``state`` at time ``begin`` to ``after`` at time ``end``, s.

    The end is the sum of the start y_0 and the stages' solutions y_1, ... with ``weights``.  ``is_combined``
    tells whether it differs from the last stage's solution, as for the midpoint rule.
    """

    begin: float
    end: float
    state: np.ndarray
    stages: tuple[Stage, ...]
    weights: np.ndarray
    after: np.ndarray
    is_combined: bool

    @property
    def tau(self) -> float:
        """Length of the step, s."""
        return self.end - self.begin

    @property
    def ends_at_stage(self) -> bool:
        """Whether the end is the last stage's solution, with its velocities of walls, but for the limiter."""
        return bool(np.count_nonzero(self.weights) == 1 and self.weights[-1] == 1.0)


@dataclass
class Trajectory:
    """Records the steps of a run, as one of the integrator's ``carried`` objects.

    Raises ParameterError for a run without derivatives: with growing damage, pistons on oblique walls,
    relaxed steps, sharp interfaces, viscosities in series for constants in cells, or several ranks.
    """

    simulation: Simulation
    steps: list[RecordedStep] = field(default_factory=list)
    limited: int = 0
    """Number of cells that the limiter changed, summed over the steps."""

    def __post_init__(self) -> None:
        run = self.simulation
        refused = {
            "damage": run.rothe_step.damage is not None and "a damage that grows is a minimum under bounds",
            "walls": any(name in run.rothe_step.walls.multiplied for name in run.rothe_step.walls.pistons)
            and "the impulse of a piston on an oblique or curved wall at a step's end has none",
            "relaxation": run.arguments["time"].relaxation
            and "the length of a relaxed step is a function of its solution",
            "discretisation": run.bounds.sharpening is not None
            and "what sharp puts apart at a step's end has none",
            "mesh": run.ranks.is_distributed and "the transposed systems of several ranks are not known",
            "interfaces": bool(run.rothe_step.context.recovered_slopes)
            and "with constants in cells the direction of interfaces between viscosities has none",
            "material": self._lacks_derivatives()
            and "with an energy without an expression diffusion and laws of the pressure have none",
        }
        for part, reason in refused.items():
            if reason:
                raise ParameterError(f"gradient: {part}", str(part), f"a run that has derivatives: {reason}")
        self._begin()

    def _lacks_derivatives(self) -> bool:
        """Whether the energy is known at points only, and the equations need more than its slope."""
        model, step = self.simulation.model, self.simulation.rothe_step
        law = model.regularisation
        if step.energy.projected is None:
            return False
        reads = [mechanism.rule.reads for mechanism in model.mechanisms]
        reads += [] if model.viscosity is None else [model.viscosity.reads]
        return any(PRESSURE in names for names in reads) or (law is not None and law.delta_fields > 0)

    def _begin(self) -> None:
        run = self.simulation
        self._start, self._t = run.rothe_step.state.vec.FV().NumPy().copy(), run.t
        self._stages: list[Stage] = []

    def run(self, until: float) -> None:
        """Run until a time, s, and record the steps."""
        carried = self.simulation.integrator.carried
        carried.append(self)
        try:
            self.simulation.run(until)
        finally:
            carried[:] = [field for field in carried if field is not self]

    # methods that the integrator calls

    def begin(self) -> None:
        """Begin a step, or repeat it."""
        self._begin()

    def stage(self, weights: np.ndarray, share: float) -> None:
        """Record the present state as a stage's solution."""
        step = self.simulation.rothe_step
        c = step.context
        lengths = (c.tau.Get(), self._t, time.Get(), *c.loads_window)
        stresses = {name: f.vec.FV().NumPy().copy() for name, f in step.stresses.functions.items()}
        state = step.state.vec.FV().NumPy().copy()
        stage = Stage(state, np.array(weights), share, Interval(*lengths), stresses)
        self._stages.append(stage)

    def end(self, weights: np.ndarray) -> None:
        """Record the accepted step with the present state as its end."""
        state = self.simulation.rothe_step.state.vec.FV().NumPy().copy()
        is_combined = not np.array_equal(state, self._stages[-1].state)
        row = self.simulation.ledger.rows[-1]
        recorded = RecordedStep(
            self._t, row["time"], self._start, tuple(self._stages), np.array(weights), state, is_combined
        )
        self.steps.append(recorded)
        self.limited += int(row["limited_cells"])

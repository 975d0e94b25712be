"""The trajectory of a run: the solutions of all its Rothe steps, and the states that each step started
from."""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ngvisco.errors import ParameterError, StopRequested
from ngvisco.forms.context import time
from ngvisco.physics.variables import PRESSURE
from ngvisco.run.checkpoint import Checkpoints
from ngvisco.run.simulation import Simulation
from ngvisco.solver.problem import Interval

if TYPE_CHECKING:
    from ngvisco.sensitivity.restart import Restart


@dataclass(frozen=True)
class Stage:
    """A solved Rothe step of a run.

    ``state`` has the coefficients of the solution. ``starts`` are the weights of the states y_0, y_1, ... in
    the step's start value, and ``share`` is the scheme's b_i.  Flow rules are linearised at ``stresses``.
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
    tells whether the end differs from the last stage's solution, as for the midpoint rule.
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
    def distances(self) -> list[tuple[float, int, int]]:
        """Weights c, k, i of the distances c B(y_k, y_i) in the scheme's dissipation.

        Here i is the number of a stage. The number k is 0 for the start y_0, the number of a stage, or, for
        the combined end, one more than the last stage's number.
        """
        of_end = np.zeros(len(self.weights)) if self.ends_at_stage else self.weights
        result, last = [], len(self.stages)
        for i, stage in enumerate(self.stages, start=1):
            weights = stage.share * self.tau / stage.interval.tau * np.array(stage.starts)
            weights = np.pad(weights, (0, last + 1 - len(weights))) + (of_end if i == last else 0.0)
            result += [(float(w), k, i) for k, w in enumerate(weights) if w != 0 and k != i]
        return result if self.ends_at_stage else [*result, (-1.0, last + 1, last)]

    @property
    def change(self) -> np.ndarray:
        """Difference of the end from the sum of the states with ``weights``, (unknowns,).

        For fields that evolve, the difference is the limiter's change.
        """
        states = [self.state, *(stage.state for stage in self.stages)]
        return self.after - sum(w * y for w, y in zip(self.weights, states, strict=True))

    @property
    def ends_at_stage(self) -> bool:
        """Whether the end is the last stage's solution, including the walls' velocities.

        The limiter's change of the end does not count.
        """
        return bool(np.count_nonzero(self.weights) == 1 and self.weights[-1] == 1.0)


@dataclass
class Trajectory:
    """Records the steps of a run, as one of the integrator's ``carried`` objects.

    With a ``restart`` folder each step is stored there too, and ``run`` begins after the steps that the
    folder has.  The folder also keeps parts of the derivatives' state, by name.

    Raises ParameterError for a run without derivatives: with growing damage, pistons on oblique or curved
    walls, relaxed steps, carried distances from outlines, directions of interfaces that are recovered from
    constants in cells or for layered bodies, several ranks; and, with an energy that is no expression, for
    diffusion of fields and laws of the pressure.
    """

    simulation: Simulation
    restart: Restart | None = None
    steps: list[RecordedStep] = field(default_factory=list)
    limited: int = 0
    """Number of cells that the limiter changed, summed over the steps."""
    seconds: float = 0.0
    """Processor time of the run, s."""

    def __post_init__(self) -> None:
        run = self.simulation
        walls = run.rothe_step.walls
        for is_refused, reason in (
            (run.rothe_step.damage is not None, "the growth of damage has no derivative"),
            (
                any(name in walls.multiplied for name in walls.pistons),
                "the impulse of a piston on an oblique or curved wall at a step's end has no derivative",
            ),
            (run.arguments["time"].relaxation, "the lengths of relaxed steps depend on the solution"),
            (
                run.rothe_step.discretisation.outlines,
                "the distances that Discretisation.outlines carries have no derivative",
            ),
            (run.ranks.is_distributed, "derivatives need one process, and this run has several ranks"),
            (
                bool(run.rothe_step.context.recovered_slopes),
                "the direction of interfaces has no derivative with constants in cells or layered bodies",
            ),
            (
                self._lacks_derivatives(),
                "diffusion and laws of the pressure have a derivative only if the energy is an expression",
            ),
        ):
            if is_refused:
                expected = f"a run that has derivatives, but {reason}"
                raise ParameterError("gradient.simulation", "the given run", expected)
        self._begin()

    def _lacks_derivatives(self) -> bool:
        """Whether the energy is no expression, and a law of the pressure or the diffusion of fields needs
        more of the energy than its slope."""
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
        """Run until a time, s, and record the steps.

        Raises StopRequested if the run is asked to stop, and CheckpointError for an invalid restart folder.
        """
        run, checkpoints = self.simulation, []
        if self.restart is not None:
            path = self.restart.path(_RUN)
            if path.exists():
                self._take_up(path)
            checkpoints = [Checkpoints(path, every=_EVERY, keep=1)]
        self.require_going_on()  # the run would forget that a stop was requested
        self._clock = clock.process_time() - self.seconds
        run.integrator.carried.append(self)
        run.observers += checkpoints
        try:
            run.run(until)
        finally:
            run.integrator.carried[:] = [field for field in run.integrator.carried if field is not self]
            run.observers[:] = [observer for observer in run.observers if observer not in checkpoints]
        self.seconds = clock.process_time() - self._clock
        self.require_going_on()

    def require_going_on(self) -> None:
        """Raise StopRequested if the run was asked to stop, also after its last step."""
        if self.simulation.stop_requested:
            after = "" if self.restart is None else f"; a repeated call goes on from {self.restart.folder}"
            raise StopRequested(f"the derivatives of the run were stopped, as requested{after}")

    def keep(self, name: str, number: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Store arrays of the derivatives, and the number of steps to which the arrays belong.

        Without a restart folder nothing is stored.
        """
        if self.restart is not None:
            self.restart.keep(name, {"number": number}, arrays)

    def kept(self, name: str) -> tuple[int, dict[str, np.ndarray]] | None:
        """The number and the arrays that ``keep`` stored last under ``name``; None if nothing is stored."""
        part = None if self.restart is None else self.restart.read(name)
        return None if part is None else (int(part[0]["number"]), part[1])

    def require_kept(self, name: str) -> dict[str, np.ndarray]:
        """The arrays that ``keep`` stored last under ``name``."""
        assert self.restart is not None
        return self.restart.require(name)[1]

    def _take_up(self, path: Path) -> None:
        """Continue after the last checkpoint in the file ``path``, and read the steps before this
        checkpoint."""
        assert self.restart is not None
        before = self.simulation.number
        self.simulation.restore(path)
        for number in range(before + 1, self.simulation.number + 1):
            numbers, arrays = self.restart.require(_name(number))
            self.steps.append(_step_of(numbers, arrays))
            self.limited, self.seconds = int(numbers["limited"]), numbers["seconds"]
        self._begin()

    # methods that the integrator calls

    def begin(self) -> None:
        """Begin a step, or begin it again after a failure."""
        self._begin()

    def stage(self, weights: np.ndarray, share: float) -> None:
        """Record the present state as a stage's solution."""
        step = self.simulation.rothe_step
        c = step.context
        lengths = (c.tau.Get(), self._t, time.Get(), *c.loads_window)
        stresses = {name: f.vec.FV().NumPy().copy() for name, f in step.stresses.functions.items()}
        state = step.state.vec.FV().NumPy().copy()
        self._stages.append(Stage(state, np.array(weights), share, Interval(*lengths), stresses))

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
        if self.restart is not None:
            totals = {"limited": self.limited, "seconds": clock.process_time() - self._clock}
            numbers, arrays = _parts_of(recorded)
            self.restart.keep(_name(int(row["step"])), numbers | totals, arrays)


_RUN, _EVERY = "run", 10
"""Name of the part with the run's checkpoints, and number of steps between two of them."""


def _name(number: int) -> str:
    """Name of the part of the restart folder that holds step ``number``."""
    return f"step-{number:08d}"


def _parts_of(step: RecordedStep) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Numbers and arrays of a step, by name."""
    numbers = {"begin": step.begin, "end": step.end, "is_combined": float(step.is_combined)}
    arrays = {"state": step.state, "weights": step.weights, "after": step.after}
    for i, stage in enumerate(step.stages):
        of_stage = {"state": stage.state, "starts": stage.starts, "share": np.array(stage.share)}
        of_stage["interval"] = np.array(dataclasses.astuple(stage.interval))
        of_stage |= {f"stress {name}": values for name, values in stage.stresses.items()}
        arrays |= {f"stage {i} {name}": values for name, values in of_stage.items()}
    return numbers, arrays


def _step_of(numbers: Mapping[str, float], arrays: Mapping[str, np.ndarray]) -> RecordedStep:
    """The step with these numbers and arrays."""
    stages = []
    for i in range(sum(name.endswith(" interval") for name in arrays)):
        front = f"stage {i} "
        of_stage = {
            name.removeprefix(front): array for name, array in arrays.items() if name.startswith(front)
        }
        stresses = {n.removeprefix("stress "): a for n, a in of_stage.items() if n.startswith("stress ")}
        interval = Interval(*map(float, of_stage["interval"]))
        stages.append(
            Stage(of_stage["state"], of_stage["starts"], float(of_stage["share"]), interval, stresses)
        )
    state, weights, after = (arrays[name] for name in ("state", "weights", "after"))
    is_combined = bool(numbers["is_combined"])
    return RecordedStep(numbers["begin"], numbers["end"], state, tuple(stages), weights, after, is_combined)

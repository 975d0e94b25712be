"""A simulation that repeats the recorded steps of a run, possibly with another parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from ngsolve import BilinearForm, LinearForm

from ngvisco.forms.context import time
from ngvisco.forms.distance import NUMERICAL
from ngvisco.forms.fields import Fields
from ngvisco.forms.system import Evolved
from ngvisco.physics.tensors import inner
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.columns import Columns
from ngvisco.sensitivity.trajectory import RecordedStep, Stage


class Follower:
    """Evaluates the equations of recorded steps, and columns, at given states.

    All vectors are coefficients of the step's space.
    """

    def __init__(self, simulation: Simulation, columns: Columns) -> None:
        self.simulation, self.columns = simulation, columns
        self.step = simulation.rothe_step
        self._residual = self.step.state.vec.CreateVector()

    @property
    def state(self) -> np.ndarray:
        """Coefficients of the present state, as a view."""
        return self.step.state.vec.FV().NumPy()

    def evolved(self, state: np.ndarray) -> Evolved:
        """Quantities of a state that have a time derivative."""
        self.state[:] = state
        return self.step.evolved()

    def pose(self, stage: Stage, states: Sequence[Evolved]) -> None:
        """Pose the equations of a stage: set the stage's times and its old state.

        The old state is a weighted sum of ``states``, y_0, y_1, ...
        """
        step, at = self.step, stage.interval
        step.context.set_step(at.tau, at.end, at.loads_from, at.loads_over, at.loads_tilt)
        step.start_from(list(zip(stage.starts, states, strict=False)))

    def begin(self, state: np.ndarray) -> None:
        """Begin a run: ``state`` becomes the present state and the step's start."""
        self.step.start_from([(1.0, self.evolved(state))])
        self.at(state)

    def finish(self, recorded: RecordedStep, states: Sequence[Evolved]) -> None:
        """Set the step's start for the evaluation of columns at the end of a step.

        If the end of the step is a combination of the stages, this end, the weighted sum of ``states`` y_0,
        y_1, ..., becomes the step's start. If the end is the last stage's solution, the start of that stage
        is kept.
        """
        if recorded.is_combined:
            self.step.start_from(list(zip(recorded.weights, states, strict=True)))

    def at(self, state: np.ndarray, stage: Stage | None = None) -> None:
        """Set the present state, and the stresses at which flow rules are linearised.

        The stresses are those recorded in ``stage``. Without a stage, the stresses follow from the state.
        """
        self.state[:] = state
        self.step.stresses.start()
        if stage is not None:
            self.step.stresses.give(stage.stresses)
        self.step.local_unknowns.update_stored()

    def residual(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual R at ``state`` with this run's velocities of walls, and the state with these
        velocities."""
        self.state[:] = state
        self.step.moving_walls.set_values()
        self.at(self.state.copy())
        self.step.residual.Apply(self.step.state.vec, self._residual)
        return self._residual.FV().NumPy().copy(), self.state.copy()

    @cached_property
    def momentum(self) -> BilinearForm:
        """Nonlinear form int rho v . w, with the multipliers of oblique walls."""
        layout = self.step.layout
        trial, test = (Fields.of(layout, parts) for parts in layout.space.TnT())
        form = BilinearForm(layout.space)
        form += self.step.quadrature.cells(inner(trial.rho * trial.v, test.v).Compile())
        if (walls := self.step.impenetrability) is not None:
            self.step.quadrature.add(form, walls.form(trial, test))
        return form

    @cached_property
    def _functional(self) -> LinearForm:
        layout = self.step.layout
        form = LinearForm(layout.space)
        test = Fields.of(layout, layout.space.TestFunction())
        form += self.step.quadrature.cells(inner(self.step.momentum_old, test.v))
        return form

    def end(
        self, recorded: RecordedStep, states: Sequence[Evolved], last: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State at a combined end with a given velocity, and the momentum equation's residual there.

        ``states`` are y_0, y_1, ..., and ``last`` is the last stage's solution.  ``v`` are coefficients of
        the velocity; coefficients that moving walls prescribe are replaced.  Two changes are added: the
        limiter's change of the recorded state, and the change by this run's own sharpening of interfaces.
        """
        step, ranges = self.step, self.step.layout.ranges
        change = recorded.change + self._sharpened(recorded, [state.values for state in states])
        step.start_from(list(zip(recorded.weights, states, strict=False)))
        self.state[:] = last
        old, walls = step.state_old.vec.FV().NumPy(), self.state[ranges["v"]].copy()
        for name in step.layout.evolving:
            self.state[ranges[name]] = (old + change)[ranges[name]]
        self.state[ranges["v"]] = np.where(~self.free_velocity & recorded.ends_at_stage, walls, v)
        if not recorded.ends_at_stage:
            time.Set(recorded.end)
            step.moving_walls.set_present_values()
        step.stresses.start()
        step.local_unknowns.update()
        return self.state.copy(), self._momentum_rows()

    def _sharpened(self, recorded: RecordedStep, states: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray:
        """Change of the state by this run's sharpening, less the change by sharpening in the recorded step,
        (unknowns,).

        ``states`` are y_0, y_1, ... of this run's step.
        """
        sharpening, ranges = self.simulation.bounds.sharpening, self.step.layout.ranges
        difference = np.zeros_like(self.state)
        if sharpening is None:
            return difference
        of_run = (recorded.state, *(stage.state for stage in recorded.stages))
        at_run = [{name: state[ranges[name]] for name in ("v", "z")} for state in of_run]
        for sign, (start, *stages) in ((1.0, states), (-1.0, at_run)):
            self.state[ranges["z"]] = start["z"]
            sharpening.begin()
            for stage, values in zip(recorded.stages, stages, strict=True):
                for name in ("v", "z"):
                    self.state[ranges[name]] = values[name]
                sharpening.stage(stage.starts, stage.share)
            end = sum(w * y["z"] for w, y in zip(recorded.weights, (start, *stages), strict=True))
            self.state[ranges["z"]] = end
            sharpening.put_apart(recorded.tau)
            difference[ranges["z"]] += sign * (self.state[ranges["z"]] - end)
        return difference

    def completed(self, state: np.ndarray) -> np.ndarray:
        """Set the present state with dependent unknowns updated, and return its coefficients."""
        self.state[:] = state
        self.step.stresses.start()
        self.step.local_unknowns.update()
        return self.state.copy()

    def impulse(
        self, recorded: RecordedStep, states: Sequence[Evolved], end: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """The columns' contributions from the walls' impulse at a combined end, (columns,).

        ``v`` is the velocity of the last stage, which determines the impulse's power.
        """
        rows = self.impulse_rows(recorded, states, end)[self.step.layout.ranges["v"]] / recorded.tau
        return self.columns.impulse(rows, None if recorded.ends_at_stage else v)

    def impulse_rows(self, recorded: RecordedStep, states: Sequence[Evolved], end: np.ndarray) -> np.ndarray:
        """Rows of the momentum equation at a combined end, N s.

        The rows of coefficients that walls prescribe are the walls' impulse.
        """
        self.step.start_from(list(zip(recorded.weights, states, strict=False)))
        self.state[:] = end
        if (multiplier := self.step.layout.ranges.get("wall_stress")) is not None:
            self.state[multiplier] = 0.0
        return self._momentum_rows()

    def distances(self, recorded: RecordedStep, states: Sequence[Evolved]) -> np.ndarray:
        """The columns' contributions from the scheme's dissipation in a step, (columns,).

        ``states`` are y_0, y_1, ..., and the combined end if there is one.
        """
        total = dict.fromkeys(NUMERICAL, 0.0)
        for weight, k, i in recorded.distances if self.columns.has_distances else []:
            for name, distance in self.simulation.integrator.distance(states[k], states[i]).items():
                total[name] += weight * distance
        return np.array([total.get(name, 0.0) / recorded.tau for name in self.columns.names])

    def _momentum_rows(self) -> np.ndarray:
        self.momentum.Apply(self.step.state.vec, self._residual)
        self._functional.Assemble()
        return self._residual.FV().NumPy() - self._functional.vec.FV().NumPy()

    @cached_property
    def free_velocity(self) -> np.ndarray:
        """Mask of the coefficients of v that no wall prescribes."""
        return np.array(list(self.step.layout.space.FreeDofs()))[self.step.layout.ranges["v"]]

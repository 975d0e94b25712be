"""Tangents of a run: derivatives of its states and columns by parameters, forwards through its steps.

A stage's solution U of R(U, y; p) = 0 with start states y changes by

    dU = -R_U^{-1} (R_y dy + R_p dp).

R_U is exact.  The bracket is the derivative of R at fixed U along (dy, dp), computed by differences of fourth
order (or of second order): runs with the parameter at p + o h, o = -+1, -+2, evaluate R with the start states
y + o h dy.  The derivatives of columns are such differences too.  So is, at a combined end, the derivative of
the momentum equation for v, int rho v . w - <m, w> = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ngvisco.forms.system import Evolved
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.columns import Columns
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.linearised import Linearised
from ngvisco.sensitivity.numbers import History
from ngvisco.sensitivity.parameters import OFFSETS, Named, differenced
from ngvisco.sensitivity.trajectory import RecordedStep, Stage, Trajectory


class Neighbours:
    """Followers of a run with one parameter p changed to p + o h, and derivatives by p as differences of the
    followers' results.

    ``base`` has the columns, and ``order`` is the order of the differences, 4 or 2.
    """

    def __init__(self, parameter: Named, simulation: Simulation, base: Columns, order: int = 4) -> None:
        self.parameter, self.steps = parameter, [o * parameter.spacing for o in OFFSETS[order]]
        runs = [parameter.varied(simulation, parameter.value + step) for step in self.steps]
        self.followers = [Follower(run, base.of(run)) for run in runs]
        self.of_start = self.derivative([follower.state.copy() for follower in self.followers])
        """Derivative of the start values, (unknowns,)."""

    def derivative(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Derivative by the parameter: a difference of the followers' ``values``."""
        return differenced(values, self.parameter.spacing)

    def freeze(self, base: Follower, state: np.ndarray, stage: Stage | None = None) -> None:
        """Let the followers read extrema at fixed points: the points at which ``base`` has its extrema in
        ``state``."""
        if base.columns.extrema.names:
            base.at(state, stage)
            for follower in self.followers:
                follower.columns.extrema.places = base.columns.extrema.found()

    def at(self, state: np.ndarray) -> list[Follower]:
        """The followers, after ``state`` has become the present state of each."""
        for follower in self.followers:
            follower.at(state)
        return self.followers

    def moved(self, state: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
        """States at p + o h to first order, from the state at p and its derivative ``along``."""
        return [state + step * along for step in self.steps]


def tangents(
    trajectory: Trajectory,
    base: Follower,
    neighbours: Sequence[Neighbours],
    from_start: bool,
    progress: Callable[[int], None] = lambda number: None,
) -> History:
    """Derivatives of the base's columns along a trajectory, (steps + 1, columns, parameters).

    ``from_start`` tells whether the start values depend on the parameters, as at the start of a run.
    """
    runs = [_Tangent(neighbour, base, from_start) for neighbour in neighbours]
    linearised, times = Linearised(base), [trajectory.steps[0].begin]
    ends, integrals = [np.stack([run.begin(trajectory.steps[0]) for run in runs], axis=-1)], []
    integrals.append(np.zeros_like(ends[0]))
    done = 0
    if (kept := trajectory.kept(_KEPT)) is not None:
        done, arrays = kept
        for run, along in zip(runs, arrays["along"], strict=True):
            run.along = along
    for number, recorded in enumerate(trajectory.steps):
        if number < done:
            row = trajectory.require_kept(_of_step(number))
        else:
            row = _row(recorded, base, linearised, runs, trajectory.require_going_on)
            trajectory.keep(_of_step(number), number, row)
            trajectory.keep(_KEPT, number + 1, {"along": np.array([run.along for run in runs])})
            progress(number + 1)
        ends.append(row["ends"])
        integrals.append(integrals[-1] + recorded.tau * row["means"])
        times.append(recorded.end)
    return History(np.array(times), np.array(ends), np.array(integrals))


def history(trajectory: Trajectory, base: Follower) -> History:
    """Values of the base's columns along a trajectory, (steps + 1, columns)."""
    steps, columns = trajectory.steps, base.columns
    base.begin(steps[0].state)
    ends, integrals = [columns.state()], [np.zeros(len(columns.names))]
    v = base.step.layout.ranges["v"]
    for recorded in steps:
        states, mean = [base.evolved(recorded.state)], np.zeros(len(columns.names))
        for stage in recorded.stages:
            base.pose(stage, states)
            base.at(stage.state, stage)
            mean += columns.stage(stage.share)
            states.append(base.evolved(stage.state))
        if columns.has_distances:
            mean += base.distances(recorded, [*states, base.evolved(recorded.after)])
        if recorded.is_combined and columns.is_of_stages.any():
            mean += base.impulse(recorded, states, recorded.after, recorded.stages[-1].state[v])
        base.finish(recorded, states)
        base.at(recorded.after)
        ends.append(columns.at_end(mean, columns.state(), recorded.tau))
        integrals.append(integrals[-1] + recorded.tau * mean)
    times = [steps[0].begin, *(recorded.end for recorded in steps)]
    return History(np.array(times), np.array(ends), np.array(integrals))


_KEPT = "tangent"
"""Part of the restart folder: derivatives of the state after a number of steps."""


def _of_step(number: int) -> str:
    """Name of the part of the restart folder that has the derivatives of the columns in a step."""
    return f"{_KEPT}-{number + 1:08d}"


def _row(
    recorded: RecordedStep,
    base: Follower,
    linearised: Linearised,
    runs: Sequence[_Tangent],
    require_going_on: Callable[[], None],
) -> dict[str, np.ndarray]:
    """Derivatives of the columns at the end of a step, and of their means over the step, (columns,
    parameters) each."""
    states = [base.evolved(recorded.state)]
    for run in runs:
        run.start(recorded.state)
    for stage in recorded.stages:
        require_going_on()
        base.pose(stage, states)
        linearised.at_stage(stage)
        for run in runs:
            is_read = recorded.is_combined or base.columns.has_distances
            run.stage(stage, linearised, is_read or stage is not recorded.stages[-1])
        states.append(base.evolved(stage.state))
    if recorded.is_combined:
        linearised.at_end(recorded)
    derivatives = zip(*(run.end(recorded, linearised) for run in runs), strict=True)
    return {
        name: np.stack(of_runs, axis=-1) for name, of_runs in zip(("ends", "means"), derivatives, strict=True)
    }


class _Tangent:
    """The tangent for one parameter."""

    def __init__(self, neighbours: Neighbours, base: Follower, from_start: bool) -> None:
        self.near, self._base = neighbours, base
        self.along = neighbours.of_start if from_start else np.zeros_like(base.state)
        """Derivative of the present state by the parameter."""
        self._states: list[list[Evolved]] = []

    def _differenced(self, function: Callable[[int, Follower], np.ndarray]) -> np.ndarray:
        return self.near.derivative([function(i, follower) for i, follower in enumerate(self.near.followers)])

    def begin(self, first: RecordedStep) -> np.ndarray:
        """Derivatives of the columns at the start of the first step."""
        for follower, moved in zip(
            self.near.followers, self.near.moved(first.state, self.along), strict=True
        ):
            follower.begin(moved)
        return self._columns_at(first.state)

    def _columns_at(self, state: np.ndarray) -> np.ndarray:
        """Derivatives of the columns at a state.  The start of each follower's step has to be set before."""
        if not self.near.followers[0].columns.has_ends:
            return np.zeros(len(self.near.followers[0].columns.names))
        moved = self.near.moved(state, self.along)
        self.near.freeze(self._base, state)

        def columns(i: int, follower: Follower) -> np.ndarray:
            follower.at(moved[i])
            return follower.columns.state()

        return self._differenced(columns)

    def start(self, state: np.ndarray) -> None:
        """Begin a step from a state."""
        moved = self.near.moved(state, self.along)
        self._states = [[follower.evolved(u)] for follower, u in zip(self.near.followers, moved, strict=True)]
        self._mean = np.zeros(len(self.near.followers[0].columns.names))

    def stage(self, stage: Stage, linearised: Linearised, is_read: bool) -> None:
        """Advance by a stage, for which ``linearised`` has factorised R_u.

        ``is_read`` tells whether a later stage or the end reads the solution of this stage.
        """
        residuals = []
        for follower, states in zip(self.near.followers, self._states, strict=True):
            follower.pose(stage, states)
            residuals.append(follower.residual(stage.state))
        rows, prescribed = (self.near.derivative(values) for values in zip(*residuals, strict=True))
        self.along = prescribed - linearised.stage(rows)
        self._last = moved = self.near.moved(stage.state, self.along)
        self.near.freeze(self._base, stage.state, stage)

        def columns(i: int, follower: Follower) -> np.ndarray:
            follower.at(moved[i])
            return follower.columns.stage(stage.share)

        if self.near.followers[0].columns.has_means:
            self._mean += self._differenced(columns)
        for follower, states, u in zip(
            self.near.followers, self._states, moved if is_read else [], strict=False
        ):
            states.append(follower.evolved(u))

    def end(self, recorded: RecordedStep, linearised: Linearised) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the columns at the step's end, and of their means over its stages."""
        if recorded.is_combined:
            self._combine(recorded, linearised)
        columns = self.near.followers[0].columns
        if columns.has_distances:
            moved = self.near.moved(recorded.after, self.along)
            self._mean += self._differenced(
                lambda i, follower: follower.distances(
                    recorded, [*self._states[i], follower.evolved(moved[i])]
                )
            )
        return columns.at_end(self._mean, self._columns_at(recorded.after), recorded.tau), self._mean

    def _combine(self, recorded: RecordedStep, linearised: Linearised) -> None:
        v = self.near.followers[0].step.layout.ranges["v"]
        ends = [
            follower.end(recorded, states, last, recorded.after[v])
            for follower, states, last in zip(self.near.followers, self._states, self._last, strict=True)
        ]
        along, rows = (self.near.derivative(values) for values in zip(*ends, strict=True))
        moved = self.near.moved(recorded.after, along - linearised.end(rows))
        # unknowns that are functions of v follow v
        self.along = self._differenced(lambda i, follower: follower.completed(moved[i]))
        moved = self.near.moved(recorded.after, self.along)
        if self.near.followers[0].columns.is_of_stages.any():
            last = self._last
            self._mean += self._differenced(
                lambda i, follower: follower.impulse(recorded, self._states[i], moved[i], last[i][v])
            )

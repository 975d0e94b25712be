"""Adjoints of a run: slopes of its numbers, carried backwards through its steps.

Let g_i be the slope of a number J by the solution U_i of a stage.  From the last stage to the first,

    R_U^T lambda_i = g_i,     g_k <- g_k - R_{y_k}^T lambda_i for the start states y_k of the stage.

If J contains rows of R at walls, c . R, as a force on a wall does, then g_i contains R_U^T c, and lambda_i -
c replaces lambda_i in the products with R_{y_k}^T and R_p.  Then dJ/dp is - sum_i lambda_i . R_p, plus the
slope by the start times the derivative of the start, plus the explicit dependence of J on p.  Derivatives by
p at fixed states are differences of fourth order, as in the tangent.  One adjoint gives the derivatives by
all parameters, and by the start values of all fields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ngvisco.forms.distance import NUMERICAL
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.linearised import Linearised
from ngvisco.sensitivity.slopes import Slopes
from ngvisco.sensitivity.tangent import Neighbours
from ngvisco.sensitivity.trajectory import RecordedStep, Trajectory

_KEPT = "adjoint"
"""Part of the restart folder: the adjoint's state, and the number of steps that are still to be taken
backwards."""


class Adjoint:
    """The adjoints of some numbers of a run.

    Parameters
    ----------
    trajectory : Trajectory
    base : Follower
        Follower with the run's parameters.
    slopes : Slopes
        Slopes of the follower's columns.
    neighbours : sequence of Neighbours
        For each parameter its neighbours, runs with other values of the parameter. A parameter of start
        values changes the start alone.
    ends : array, (numbers, steps + 1, columns)
        Derivatives of the numbers by the columns at the start and at the ends of steps.
    means : array, (numbers, steps + 1, columns)
        Derivatives of the numbers by the columns' means over a step's stages, in the row of the step's end.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        base: Follower,
        slopes: Slopes,
        neighbours: Sequence[Neighbours],
        ends: np.ndarray,
        means: np.ndarray,
    ) -> None:
        self.trajectory, self.base, self.slopes, self.near = trajectory, base, slopes, neighbours
        self.ends, self.means = ends, means
        self.linearised, self.starts = Linearised(base), slopes.starts
        self.free = self.linearised.free
        self.jacobian = np.zeros((len(ends), len(neighbours)))
        """Derivatives by the parameters, (numbers, parameters)."""
        self.of_start = np.zeros((len(ends), len(base.state)))
        """Slopes by the independent coefficients of the start, (numbers, unknowns)."""

    def run(self, from_start: bool, progress: Callable[[int], None] = lambda number: None) -> None:
        """Go backwards through the steps. ``from_start`` tells whether start values depend on parameters."""
        steps = self.trajectory.steps
        slopes, left = np.zeros_like(self.of_start), len(steps)
        if (kept := self.trajectory.kept(_KEPT)) is not None:
            left, arrays = kept
            slopes, self.jacobian = arrays["slopes"], arrays["jacobian"]
        for number in range(left, 0, -1):
            slopes = self._step(number, steps[number - 1], slopes)
            self.trajectory.keep(_KEPT, number - 1, {"slopes": slopes, "jacobian": self.jacobian})
            progress(len(steps) - number + 1)
        weights, state = self.ends[:, 0], steps[0].state
        self._put_start(weights, lambda follower: follower.begin(state))
        self._read_at(state, weights)
        slopes += self._seeds(weights) + self._seeds_of_start(weights, np.ones(1), [state], 0)
        if from_start:
            for j, near in enumerate(self.near):
                self.jacobian[:, j] += slopes @ near.of_start
        self.of_start = np.array([self.starts.through_functions(slope) for slope in slopes])

    def _seeds(self, weights: np.ndarray) -> np.ndarray:
        """Slopes of the numbers by the present state, (numbers, unknowns), for weights of the columns."""
        result = np.zeros((len(weights), len(self.base.state)))
        for column, name in enumerate(self.base.columns.names):
            if weights[:, column].any():
                result += np.outer(weights[:, column], self.slopes(name))
        return result

    def _seeds_of_start(
        self, weights: np.ndarray, of_starts: np.ndarray, states: list[np.ndarray], number: int
    ) -> np.ndarray:
        """Slopes of the numbers by one start state, (numbers, unknowns).

        Only columns at the present state that read the step's start contribute to the slopes.
        """
        result = np.zeros((len(weights), len(self.base.state)))
        for name in self.slopes.reading_start:
            if (of_column := weights[:, self.base.columns.names.index(name)]).any():
                self.starts.put(of_starts, states, number)
                result += np.outer(of_column, self.slopes.of_start(name))
        return result

    def _put_start(self, weights: np.ndarray, put: Callable[[Follower], None]) -> None:
        """Set the step's start for all followers, if columns with ``weights`` read this start."""
        if any(weights[:, self.base.columns.names.index(name)].any() for name in self.slopes.reading_start):
            for follower in (self.base, *(f for near in self.near for f in near.followers)):
                put(follower)

    def _read_at(self, state: np.ndarray, weights: np.ndarray) -> None:
        """Set the present state, and add the derivatives of the numbers by the parameters at this fixed
        state to ``jacobian``."""
        if weights.any():
            for j, near in enumerate(self.near):
                near.freeze(self.base, state)
                values = [follower.columns.state() for follower in near.at(state)]
                self.jacobian[:, j] += weights @ near.derivative(values)
        self.base.at(state)

    def _step(self, number: int, recorded: RecordedStep, slopes: np.ndarray) -> np.ndarray:
        """Slopes of the numbers by the state at a step's start; ``slopes`` are those by the state at its
        end."""
        solutions = [recorded.state, *(stage.state for stage in recorded.stages)]
        loads, weights = np.zeros((len(solutions), *slopes.shape)), self.ends[:, number]

        def start(follower: Follower) -> None:
            states = [follower.evolved(y) for y in solutions]
            follower.pose(recorded.stages[-1], states[:-1])
            follower.finish(recorded, states)

        self._put_start(weights, start)
        self._read_at(recorded.after, weights)
        of_starts = recorded.weights if recorded.is_combined else recorded.stages[-1].starts
        for k in np.flatnonzero(of_starts):
            loads[k] += self._seeds_of_start(weights, of_starts, solutions, int(k))
        whole = slopes + self._seeds(weights)
        whole += self._dissipation(number, recorded, [*solutions, recorded.after], loads)
        if recorded.is_combined:
            self._end(number, recorded, solutions, whole, loads)
        else:
            loads[-1] += whole
        for i in range(len(recorded.stages), 0, -1):
            self._stage(number, recorded, i, solutions, loads)
        return loads[0]

    def _dissipation(
        self, number: int, recorded: RecordedStep, states: list[np.ndarray], loads: np.ndarray
    ) -> np.ndarray:
        """Add the slopes of the scheme's dissipation by the states to ``loads``, and its derivatives by the
        parameters to ``jacobian``.

        Returns the slopes by the end of the step. The end is the last of ``states`` and the present state.
        """
        weights, base = self.means[:, number], self.base
        result = np.zeros((len(states), *loads.shape[1:]))
        names = [name for name in NUMERICAL if name in base.columns.names]
        of_columns = {name: weights[:, base.columns.names.index(name)] / recorded.tau for name in names}
        of_columns = {name: values for name, values in of_columns.items() if values.any()}
        if not of_columns or self.slopes.distances is None:
            return result[-1]
        for weight, k, i in recorded.distances:
            for name, values in of_columns.items():
                by_a, by_b = self.slopes.distances(name, states[k], states[i])
                result[k] += weight * np.outer(values, by_a)
                result[i] += weight * np.outer(values, by_b)
        for j, near in enumerate(self.near):
            parts = [f.distances(recorded, [f.evolved(y) for y in states]) for f in near.followers]
            self.jacobian[:, j] += weights @ near.derivative(parts)
        base.at(recorded.after)
        loads += result[:-1]
        return result[-1]

    def _stage(
        self, number: int, recorded: RecordedStep, i: int, solutions: list[np.ndarray], loads: np.ndarray
    ) -> None:
        self.trajectory.require_going_on()
        stage, weights = recorded.stages[i - 1], self.means[:, number]
        base = self.base
        base.pose(stage, [base.evolved(y) for y in solutions[:i]])
        self.linearised.at_stage(stage)  # this also sets the present state
        c = self.slopes.rows.weights(stage.share * weights, stage.state)
        loads[i] += self._seeds(stage.share * weights) + self.slopes.rows.slopes(stage.share * weights, c)
        adjoints = np.array([self.linearised.stage(slope, transposed=True) for slope in loads[i]])
        for j, near in enumerate(self.near):
            if near.parameter.is_of_start:
                continue
            residuals, columns = [], []
            near.freeze(base, stage.state, stage)
            for follower in near.followers:
                follower.pose(stage, [follower.evolved(y) for y in solutions[:i]])
                residuals.append(follower.residual(stage.state))
                if weights.any():
                    follower.at(stage.state)
                    columns.append(follower.columns.stage(stage.share))
            rows, prescribed = (near.derivative(values) for values in zip(*residuals, strict=True))
            self.jacobian[:, j] += loads[i] @ prescribed - adjoints @ rows
            if columns:
                self.jacobian[:, j] += weights @ near.derivative(columns)
        for k in np.flatnonzero(stage.starts[:i]):
            self.starts.put(stage.starts, solutions[:i], int(k))
            loads[k] -= self.starts.transposed(adjoints - c)
            loads[k] += self._seeds_of_start(stage.share * weights, stage.starts, solutions[:i], int(k))

    def _end(
        self,
        number: int,
        recorded: RecordedStep,
        solutions: list[np.ndarray],
        whole: np.ndarray,
        loads: np.ndarray,
    ) -> None:
        """Add the contributions of a combined end to ``loads``.

        The combined end is the present state. ``loads`` are the slopes by the stages' solutions, and
        ``whole`` are the slopes by the combined end.
        """
        base, starts = self.base, self.starts
        ranges = base.step.layout.ranges
        is_v = np.zeros(len(base.state), dtype=bool)
        is_v[ranges["v"]] = True
        c = self._impulses(number, recorded, solutions, loads)
        of_rows = starts.momentum_transposed(recorded.after, c)
        slopes = np.array([starts.through_functions(slope) for slope in whole + of_rows])
        self.linearised.at_end(recorded)
        adjoints = np.array([self.linearised.end(np.where(is_v & self.free, slope, 0.0)) for slope in slopes])
        for j, near in enumerate(self.near):
            ends = []
            for follower in near.followers:
                states = [follower.evolved(y) for y in solutions]
                ends.append(follower.end(recorded, states, solutions[-1], recorded.after[ranges["v"]]))
            state, rows = (near.derivative(values) for values in zip(*ends, strict=True))
            self.jacobian[:, j] += whole @ state - (adjoints - c) @ rows
        combined = slopes - starts.momentum_transposed(recorded.after, adjoints)
        loads[-1] += np.where(starts.evolving, 0.0, slopes)
        if recorded.ends_at_stage:
            loads[-1] += np.where(is_v & ~self.free, combined, 0.0)
        kept = np.where(starts.evolving & ~is_v, combined, 0.0)
        for k in np.flatnonzero(recorded.weights):
            loads[k] += recorded.weights[k] * (kept + starts.momentum_transposed(solutions[k], adjoints - c))

    def _impulses(
        self, number: int, recorded: RecordedStep, solutions: list[np.ndarray], loads: np.ndarray
    ) -> np.ndarray:
        """Weights, (numbers, unknowns), that the momentum's rows at a combined end have in the numbers.

        The slopes of the rows' power by the last stage's velocity are added to ``loads``.
        """
        weights, rows = self.means[:, number] / recorded.tau, self.slopes.rows
        if recorded.ends_at_stage:
            return rows.weights(weights, None, at_end=True)
        if rows.powers:
            states = [self.base.evolved(y) for y in solutions]
            loads[-1] += rows.of_velocity(weights, self.base.impulse_rows(recorded, states, recorded.after))
            self.base.at(recorded.after)
        return rows.weights(weights, solutions[-1], at_end=True)

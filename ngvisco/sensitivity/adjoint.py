"""Adjoints of a run: the slopes of what it gives, carried backwards through its steps.

Of a number J of the run let g_i be its slope by the solution U_i of a stage.  From the last stage to the
first,

    R_U^T lambda_i = g_i,     g_k <- g_k - R_{y_k}^T lambda_i for the states y_k that the stage starts from,

so that dJ/dp = - sum_i lambda_i . R_p + the slope by the start times its derivative + what J reads of p
itself.  Derivatives by p at fixed states are differences of fourth order, as in the tangent.  One adjoint
gives the derivatives by all parameters, and by the start values of all fields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.linearised import Linearised
from ngvisco.sensitivity.slopes import Slopes
from ngvisco.sensitivity.starts import Starts
from ngvisco.sensitivity.tangent import Neighbours
from ngvisco.sensitivity.trajectory import RecordedStep, Trajectory


class Adjoint:
    """The adjoints of some numbers of a run.

    Parameters
    ----------
    trajectory : Trajectory
    base : Follower
        With the run's own parameters.
    slopes : Slopes
        Of its columns.
    neighbours : sequence of Neighbours
        Of the parameters; of those of start values alone the start is differenced.
    ends, means : arrays, (numbers, steps + 1, columns)
        What each number is of the columns at the ends of steps, the start first, and of their means over the
        stages of the step that leads there.
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
        self.linearised, self.starts = Linearised(base), Starts(base)
        self.free = self.linearised.free
        self.jacobian = np.zeros((len(ends), len(neighbours)))
        """The derivatives by the parameters, (numbers, parameters)."""
        self.of_start = np.zeros((len(ends), len(base.state)))
        """The slopes by the coefficients of the start, (numbers, unknowns), where unknowns that are
        functions of others follow them."""

    def run(self, from_start: bool, progress: Callable[[int], None] = lambda number: None) -> None:
        """Go backwards; ``from_start`` says whether start values depend on the parameters."""
        steps = self.trajectory.steps
        slopes = np.zeros_like(self.of_start)
        for number in range(len(steps), 0, -1):
            slopes = self._step(number, steps[number - 1], slopes)
            progress(len(steps) - number + 1)
        self._read_at(steps[0].state, self.ends[:, 0])
        slopes += self._seeds(self.ends[:, 0])
        if from_start:
            for j, near in enumerate(self.near):
                self.jacobian[:, j] += slopes @ near.of_start
        self.of_start = np.array([self.starts.through_functions(one) for one in slopes])

    def _seeds(self, weights: np.ndarray) -> np.ndarray:
        """The slopes of the numbers by the present state, (numbers, unknowns), of weights of the columns."""
        result = np.zeros((len(weights), len(self.base.state)))
        for column, name in enumerate(self.base.columns.names):
            if weights[:, column].any():
                result += np.outer(weights[:, column], self.slopes(name))
        return result

    def _read_at(self, state: np.ndarray, weights: np.ndarray) -> None:
        """Make a state the present one, and add what the numbers read there of the parameters themselves."""
        if weights.any():
            for j, near in enumerate(self.near):
                values = [one.columns.state() for one in near.at(state)]
                self.jacobian[:, j] += weights @ near.derivative(values)
        self.base.at(state)

    def _step(self, number: int, taken: RecordedStep, slopes: np.ndarray) -> np.ndarray:
        """The slopes by the start of a step, from those by its end."""
        solutions = [taken.state, *(stage.state for stage in taken.stages)]
        of = np.zeros((len(solutions), *slopes.shape))
        if taken.is_combined:
            self._end(number, taken, solutions, slopes, of)
        else:
            self._read_at(taken.after, self.ends[:, number])
            of[-1] = slopes + self._seeds(self.ends[:, number])
        for i in range(len(taken.stages), 0, -1):
            self._stage(number, taken, i, solutions, of)
        return of[0]

    def _stage(
        self, number: int, taken: RecordedStep, i: int, solutions: list[np.ndarray], of: np.ndarray
    ) -> None:
        stage, weights = taken.stages[i - 1], self.means[:, number]
        base = self.base
        base.pose(stage, [base.evolved(y) for y in solutions[:i]])
        self.linearised.at_stage(stage)  # which is the present state then
        of[i] += self._seeds(stage.share * weights)
        adjoints = np.array([self.linearised.stage(slope, transposed=True) for slope in of[i]])
        for j, near in enumerate(self.near):
            if near.parameter.is_of_start:
                continue
            found, columns = [], []
            for one in near.followers:
                one.pose(stage, [one.evolved(y) for y in solutions[:i]])
                found.append(one.residual(stage.state))
                if weights.any():
                    one.at(stage.state)
                    columns.append(one.columns.stage(stage.share))
            rows, prescribed = (near.derivative(values) for values in zip(*found, strict=True))
            self.jacobian[:, j] += of[i] @ prescribed - adjoints @ rows
            if columns:
                self.jacobian[:, j] += weights @ near.derivative(columns)
        for k in np.flatnonzero(stage.starts[:i]):
            for n, adjoint in enumerate(adjoints):
                of[k][n] -= self.starts.transposed(stage, solutions[:i], int(k), adjoint)

    def _end(
        self,
        number: int,
        taken: RecordedStep,
        solutions: list[np.ndarray],
        slopes: np.ndarray,
        of: np.ndarray,
    ) -> None:
        """The slopes by the stages of a combined end, from those by the end."""
        base, starts = self.base, self.starts
        ranges = base.step.layout.ranges
        is_v = np.zeros(len(base.state), dtype=bool)
        is_v[ranges["v"]] = True
        self._read_at(taken.after, self.ends[:, number])
        whole = slopes + self._seeds(self.ends[:, number])
        slopes = np.array([starts.through_functions(one) for one in whole])
        self.linearised.at_end(taken)
        adjoints = np.array([self.linearised.end(np.where(is_v & self.free, one, 0.0)) for one in slopes])
        for j, near in enumerate(self.near):
            found = []
            for one in near.followers:
                states = [one.evolved(y) for y in solutions]
                found.append(one.end(taken, states, solutions[-1], taken.after[ranges["v"]]))
            state, rows = (near.derivative(values) for values in zip(*found, strict=True))
            self.jacobian[:, j] += whole @ state - adjoints @ rows
        for n, (slope, adjoint) in enumerate(zip(slopes, adjoints, strict=True)):
            combined = slope - starts.momentum_transposed(taken.after, adjoint)
            of[-1][n] += np.where(starts.evolving, 0.0, slope)
            if taken.ends_at_stage:
                of[-1][n] += np.where(is_v & ~self.free, combined, 0.0)
            kept = np.where(starts.evolving & ~is_v, combined, 0.0)
            for k in np.flatnonzero(taken.weights):
                moved = starts.momentum_transposed(solutions[k], adjoint)
                of[k][n] += taken.weights[k] * (kept + moved)

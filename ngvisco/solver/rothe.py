"""One Rothe step: from (rho, m, z)_old to the state that a step of length tau leads to, or an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import BaseVector

from ngvisco.errors import StepError
from ngvisco.forms.context import time
from ngvisco.forms.system import Step
from ngvisco.solver.choice import chosen_method, is_affordable
from ngvisco.solver.continuation import Way, follow
from ngvisco.solver.extrapolation import Extrapolation
from ngvisco.solver.newton import Newton
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonIteration, NewtonOptions
from ngvisco.solver.split.solver import Split

WIDE, WIDEST = 1e2, 1e4
"""Widths of the smoothed upwinding, in units of the scheme's, from which it is narrowed for start values.

Where v.n changes sign on a facet within the step, the elastic force jumps by [z]:[zeta] across that
width: the sharp problem can have a fold between the old state and the solution, the soft one has none.
The widest is about the run's velocity: the upwinding is then nearly central, and steps of growing
length lead from the old state to tau also where creep is stiff and z jumps from cell to cell.
"""

SPLIT_TRIES = 6
"""Widths tried by the split solver before the coupled one is asked."""

FULL_STEPS = 12
"""Undamped Newton steps tried from a soft solution to the sharp one, where the way between them folds.

Across a fold the sign of v.n changes on a facet: the sharp equation is nearly piecewise smooth, and full
steps change such signs as damped ones cannot.
"""


@dataclass(frozen=True)
class Interval:
    """A Rothe step in time, s: its length, where it begins and ends, and over what its loads are averaged.

    For the paper's scheme ``tau`` = end - begin, and loads are averaged over the same.  A stage of another
    scheme may start from a combination of states, which belongs to no time: ``begin`` is then that of the
    state which is its start value.
    """

    tau: float
    begin: float
    end: float
    loads_from: float
    loads_over: float

    def shortened(self, fraction: float) -> Interval:
        """The step with a part of the length, as a start value of the whole one."""
        end = self.end if fraction == 1.0 else self.begin + fraction * (self.end - self.begin)
        loads_from = self.loads_from if self.loads_over > 0 else end
        return Interval(fraction * self.tau, self.begin, end, loads_from, fraction * self.loads_over)


class RotheSolver:
    """Solves a Step, the implicit Euler formula (paper: Euler-large-viscoelastodyn+disc)."""

    def __init__(
        self, step: Step, options: NewtonOptions, defect: Callable[[], str | None] | None = None
    ) -> None:
        """``defect`` says what is wrong with a solution (rho <= 0, J <= 0), or None if nothing is.

        The equations of a long step have solutions of negative density too; they are not accepted.
        """
        self.step, self.options = step, options
        self.defect = defect or (lambda: None)
        self.h_min = min(step.context.h.vec)
        self.norm = BlockNorm(step.layout.ranges, {"v": 0.0, "rho": 0.0, "z": 1.0})
        self.newton: Newton | Split
        if chosen_method(step, options.method) == "split":
            self.newton = Split(step, self.norm, options, self._remember)
        else:
            self.newton = self._coupled(self._remember)
        self.retried = 0
        """Steps that the split solver gave up and the coupled one was asked for."""
        self._last_tau: float | None = None
        self._factorised = {name: step.state.vec.CreateVector() for name in ("state", "state_old")}
        self._factorised_at = {"tau": 0.0, "end": 0.0, "loads_from": 0.0, "loads_over": 0.0}
        self._start = step.state.vec.CreateVector()
        self.extrapolation = Extrapolation(step)

    def solve(self, interval: Interval, with_continuation: bool = True) -> list[NewtonIteration]:
        """Solve the step from ``step.old``; ``step.state``, the start value, becomes its solution.

        ``with_continuation`` False gives up where Newton fails from the start value, as is cheaper for
        a caller that tries a shorter step.

        Raises
        ------
        StepError
            When Newton or the positivity of rho and J fails, with both continuations too; the state is then
            the start value again.  A step that the split solver fails is retried with wide upwinding, then
            by the coupled one where the mesh is small enough for that.
        """
        step = self.step
        self._start.data = step.state.vec
        if interval.tau != self._last_tau:
            self.forget()
            self._last_tau = interval.tau
        history: list[NewtonIteration] = []
        split = self.newton
        try:
            if isinstance(split, Split):
                if self._solved_split(interval, history, with_continuation):
                    return history
                self._restore(self._start)
                self.newton = self._coupled(lambda: None)
                self.retried += 1
            for solve in (self._solve_directly, self._soften):
                try:
                    solve(interval, history)
                    return history
                except StepError:
                    if not with_continuation:
                        raise
                    self._restore(self._start)
            self._lengthen(interval, history)
            return history
        except BaseException as error:  # also an interrupt: never leave an iterate behind
            self.extrapolation.drop()
            self._restore(self._start)
            if isinstance(error, StepError):
                raise StepError(str(error), history) from error
            raise
        finally:
            self.newton = split

    def _solved_split(
        self, interval: Interval, history: list[NewtonIteration], with_continuation: bool
    ) -> bool:
        """Solve the step by the split solver; False where the coupled one is to be asked instead."""
        try:
            self._solve_split(interval, history)
            return True
        except StepError:
            if not with_continuation:
                raise
        self._restore(self._start)
        try:
            self._soften(interval, history)
            return True
        except StepError:
            if not is_affordable(self.step.mesh):
                raise
        return False

    def _solve_split(self, interval: Interval, history: list[NewtonIteration]) -> None:
        """Solve from extrapolated values where there are such, from the start value where that fails."""
        if self.extrapolation.is_empty:
            self.extrapolation.keep(interval.begin)
        extrapolated = self.extrapolation.start(interval.end)
        try:
            self._solve_directly(interval, history)
        except StepError:
            self.extrapolation.drop()
            if not extrapolated:
                raise
            self._restore(self._start)
            self._solve_directly(interval, history)
        self.extrapolation.keep(interval.end)

    def _coupled(self, on_factorise: Callable[[], None]) -> Newton:
        step = self.step
        return Newton(
            step.residual,
            step.state.vec,
            self.norm,
            step.eliminate,
            self.options,
            on_factorise,
            step.eliminate.refresh,
        )

    def _solve_directly(
        self, interval: Interval, history: list[NewtonIteration], full_steps: int | None = None
    ) -> None:
        """Solve the step from the present state, and record the iterations, also failed ones."""
        try:
            history += self._solve(interval, full_steps)
        except StepError as error:
            history += error.history
            raise

    def _soften(self, interval: Interval, history: list[NewtonIteration]) -> None:
        """Solve the step with wide upwinding and narrow it to the scheme's."""
        eta = self.step.context.eta
        width = eta.Get()

        def solve(factor: float) -> None:
            eta.Set(factor * width)
            try:
                self._solve_directly(interval, history)
            except StepError:
                if factor < WIDEST or isinstance(self.newton, Split):
                    raise
                self._restore(self._start)
                self._lengthen(interval, history)

        def leap() -> None:
            eta.Set(width)
            self._solve_directly(interval, history, FULL_STEPS)

        way = Way(first=WIDE, retreat=WIDEST / WIDE, furthest=WIDEST, ratio=0.1)
        try:
            if isinstance(self.newton, Split):  # it takes no full steps, and the coupled one comes after it
                self._follow(solve, replace(way, tries=SPLIT_TRIES))
            else:
                self._follow(solve, way, leap)
        finally:
            eta.Set(width)

    def _lengthen(self, interval: Interval, history: list[NewtonIteration]) -> None:
        """Solve steps of growing length, each the start value of the next, up to the whole one."""

        def solve(fraction: float) -> None:
            self._solve_directly(interval.shortened(fraction), history)

        self._follow(solve, Way(first=0.25, retreat=1 / 8, furthest=0.25 / 8**5, ratio=4.0))

    def _follow(
        self, solve: Callable[[float], None], way: Way, leap: Callable[[], None] | None = None
    ) -> None:
        follow(solve, way, self.step.state.vec, self._restore, leap)

    def return_to(self, values: BaseVector) -> None:
        """Make ``values`` the present state, which the solutions since then do not lead on from."""
        self.extrapolation.drop()
        self._restore(values)

    def forget(self) -> None:
        """Drop the factorisation, so that the next solve makes a new one."""
        self.newton.jacobian.forget()

    def memory(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """What makes the next step depend on earlier ones: where the Jacobian at hand was factorised.

        A restart factorises there again, so that it goes on bit for bit as the run that wrote it.
        """
        numbers, arrays = self.extrapolation.memory()
        if not self.newton.jacobian.exists or self._last_tau is None:
            return numbers, arrays
        numbers |= {**self._factorised_at, "last_tau": self._last_tau}
        return numbers, arrays | {name: vec.FV().NumPy().copy() for name, vec in self._factorised.items()}

    def recall(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Take up what ``memory`` gave; state, old state and time are left as they are."""
        self.forget()
        self.extrapolation.recall(numbers, arrays)
        if "last_tau" not in numbers:
            return
        step, now = self.step, time.Get()
        kept = {name: getattr(step, name).vec.FV().NumPy().copy() for name in self._factorised}
        for name in self._factorised:
            getattr(step, name).vec.FV().NumPy()[:] = arrays[name]
        self._set_context(**{name: numbers[name] for name in self._factorised_at})
        step.eliminate.refresh()
        self.newton.jacobian.factorise(step.state.vec)
        self._remember()
        self._last_tau = numbers["last_tau"]
        for name, values in kept.items():
            getattr(step, name).vec.FV().NumPy()[:] = values
        time.Set(now)

    def _remember(self) -> None:
        context = self.step.context
        parameters = {name: getattr(context, name).Get() for name in ("tau", "loads_from", "loads_over")}
        self._factorised_at = parameters | {"end": time.Get()}
        for name, vector in self._factorised.items():
            vector.data = getattr(self.step, name).vec

    def _set_context(self, tau: float, end: float, loads_from: float, loads_over: float) -> None:
        self.step.context.set_step(tau, end, loads_from, loads_over)
        self.step.moving_walls.set_values()

    def _solve(self, interval: Interval, full_steps: int | None = None) -> list[NewtonIteration]:
        self._set_context(interval.tau, interval.end, interval.loads_from, interval.loads_over)
        self.norm.units["v"] = self.h_min / interval.tau
        energy = self.step.energy
        energy.last_failure = None
        try:
            # only the coupled iteration takes full steps whatever the increments
            newton = self.newton
            history = newton.solve(full_steps) if isinstance(newton, Newton) else newton.solve()
        except StepError as error:
            if energy.last_failure is None:
                raise
            raise StepError(f"{error}; {energy.last_failure}", error.history) from error
        if energy.failure is not None:  # of the last increment, which is added without a test
            raise StepError(energy.failure, history)
        reason = self.defect()
        if reason is not None:
            raise StepError(f"{reason}: take a smaller step or a finer mesh", history)
        return history

    def _restore(self, values: BaseVector) -> None:
        self.step.state.vec.data = values
        self.forget()

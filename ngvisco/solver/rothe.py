"""One Rothe step: from the state at t_old to the one at t_old + tau, or an error and the old state."""

from __future__ import annotations

from ngsolve import GridFunction

from ngvisco.errors import StepError
from ngvisco.forms.context import time
from ngvisco.forms.system import Step
from ngvisco.solver.newton import Newton, NewtonIteration, NewtonOptions, block_norm

CONTINUATION = (1 / 16, 1 / 4, 1.0)
"""Fractions of tau whose solutions are start values for the next, when tau itself does not converge."""


class RotheSolver:
    """Advances a Step by the implicit Euler formula (paper: Euler-large-viscoelastodyn+disc)."""

    def __init__(self, step: Step, options: NewtonOptions) -> None:
        self.step, self.options = step, options
        self.h_min = min(step.context.h.vec)
        self._floors = {"v": 0.0, "rho": 0.0, "z": 1e-3}
        norm = block_norm(step.layout.ranges, self._floors)
        self.newton = Newton(step.residual, step.state.vec, norm, step.eliminate, options)
        self._last_tau: float | None = None

    def advance(self, t_old: float, tau: float) -> list[NewtonIteration]:
        """Solve the step; ``step.state`` becomes the new state, ``step.state_old`` the old one.

        Raises
        ------
        StepError
            When Newton and the continuation in tau fail; both grid functions then hold the old state.
        """
        step = self.step
        step.state_old.vec.data = step.state.vec
        if tau != self._last_tau:
            self.forget()
            self._last_tau = tau
        try:
            return self._solve(t_old, tau)
        except StepError as error:
            history = list(error.history)
            self._restore()
        try:
            for fraction in CONTINUATION:
                self.forget()
                history += self._solve(t_old, fraction * tau)
            return history
        except StepError as error:
            self._restore()
            time.Set(t_old)
            message = f"step of length {tau:g} s from t = {t_old:g} s: {error}"
            raise StepError(message, [*history, *error.history]) from error

    def forget(self) -> None:
        """Drop the factorisation; a run that does so at checkpoints is reproduced by its restart."""
        self.newton.jacobian.forget()

    def _solve(self, t_old: float, tau: float) -> list[NewtonIteration]:
        context = self.step.context
        context.t_old.Set(t_old)
        context.tau.Set(tau)
        time.Set(t_old + tau)
        self._floors["v"] = 1e-3 * self.h_min / tau
        return self.newton.solve()

    def _restore(self) -> None:
        state: GridFunction = self.step.state
        state.vec.data = self.step.state_old.vec
        self.forget()

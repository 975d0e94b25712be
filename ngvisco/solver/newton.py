"""Damped Newton iteration with a reused factorisation, on the statically condensed system.

A Jacobian is assembled and factorised only where it is needed: at the start of a run and whenever the
contraction of the last increment, theta = |d_{i+1}|/|d_i|, is worse than ``refresh``.  In between,
increments come from the factorisation at hand.  Damping is the natural monotonicity test of affine
invariant Newton methods: a step of length lambda is taken when the next increment by the same
factorisation is shorter by the factor 1 - lambda/4.  The test is invariant under scaling of the
equations, so residuals in different units are never compared.  Both increments are measured by the same
scales, the larger of those before and after the step: a step that is far too long would otherwise
pass the test because it makes the scale grow.

Norm.  Increments are measured by ``BlockNorm``; an iteration that a fresh Jacobian no longer advances also
ends where the increment is below the tolerance with its large floor, or below ten times the tolerance.

Rounding.  The residual sums parts that cancel: near F = I those of the elastic force have the size of the
modulus G, and their rounding leaves a force of eps G/h that the stiffness of a strain does not resist where
it moves the body as a whole: v is known to eps G tau/(rho h) only (G = 1e6 Pa, tau = 10 s, h = 0.4 m,
rho = 1 kg/m3: 3e-9 m/s).  How large that is, the problem itself tells: the state is perturbed by one unit
in the last place of every number, and what this changes in the increment cannot be iterated away.  Where a
fresh Jacobian no longer advances the iteration, an increment of at most ``NOISE_MARGIN`` times that change,
and at most ``NOISE_CAP`` tolerances, is accepted.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from ngsolve import BaseVector, BilinearForm

from ngvisco.errors import StepError
from ngvisco.solver.condensed import CondensedJacobian
from ngvisco.solver.norm import BlockNorm
from ngvisco.solver.options import NewtonIteration, NewtonOptions

NOISE_SAMPLES = 2
"""Perturbations by rounding that are tried; the largest change of the increment counts."""

NOISE_MARGIN = 10.0
"""Increments of a stalled iteration, in units of that change: both are random, of a few modes."""

NOISE_CAP = 100.0
"""The largest increment, in tolerances, that is accepted as rounding."""


class Newton:
    """Solves R(u; .) = 0 for ``state``; keeps its vectors and factorisation between solves."""

    def __init__(
        self,
        form: BilinearForm,
        state: BaseVector,
        norm: BlockNorm,
        eliminate: Callable[[], None],
        options: NewtonOptions,
        on_factorise: Callable[[], None] = lambda: None,
        refresh: Callable[[], None] = lambda: None,
    ) -> None:
        """``eliminate`` recomputes the local unknowns of ``state`` from the others.

        ``on_factorise`` is called with the state at which the Jacobian has just been factorised,
        ``refresh`` before the form is used at a state that ``eliminate`` was not just called at.
        """
        self.form, self.state, self.norm, self.options = form, state, norm, options
        self.eliminate, self.on_factorise, self.refresh = eliminate, on_factorise, refresh
        self.jacobian = CondensedJacobian(form, options.inverse)
        self._residual = state.CreateVector()
        self._trial_residual = state.CreateVector()
        self._increment = state.CreateVector()
        self._next = state.CreateVector()
        self._base = state.CreateVector()

    def solve(self, full_steps: int | None = None) -> list[NewtonIteration]:
        """Iterate from the present state to a solution; returns the history.

        Parameters
        ----------
        full_steps : int, optional
            Take at most so many full steps whatever the increments, as for a semismooth equation, in
            place of damped ones: they may lead to a solution that no path of smaller increments joins.

        Raises
        ------
        StepError
            When the iteration does not converge; the state is then some iterate.
        """
        history: list[NewtonIteration] = []
        options, u, jacobian = self.options, self.state, self.jacobian
        fresh = self._start(history)
        damping, reason = 1.0, "too many iterations"
        while len(history) < (full_steps or options.max_iterations):
            self._base.data = u
            u.data -= damping * self._increment
            self.eliminate()
            self.form.Apply(u, self._trial_residual)
            size = self.norm(self._increment, self._base, u)
            next_size = contraction = np.inf
            if np.isfinite(self._trial_residual.Norm()):
                jacobian.solve(self._trial_residual, self._next)
                next_size = self.norm(self._next, u)
                # NaN where an increment is not finite, which passes no test below
                contraction = self.norm(self._next, self._base, u) / size if size != 0 else 0.0
            history.append(NewtonIteration(size, contraction, damping, fresh))
            # not where the residual is no number: the next increment is then an old one
            stalled = fresh and options.refresh < contraction < np.inf
            if damping == 1.0 and (next_size <= options.tolerance or (stalled and self._is_rounding())):
                if contraction < 1:
                    u.data -= self._next
                    self.eliminate()
                return history
            if not contraction <= (np.finfo(float).max if full_steps else 1 - damping / 4):
                u.data = self._base
                if not fresh:
                    fresh = self._refresh(history)
                    damping = 1.0
                elif damping > options.min_damping:
                    damping /= 2
                else:
                    reason = "no step length reduces the increment"
                    break
                continue
            self._residual.data = self._trial_residual
            if contraction > options.refresh or damping < 1:
                fresh = self._refresh(history)
            else:
                self._increment.data = self._next
                fresh = False
            damping = min(1.0, 2 * damping)
        last = history[-1].increment if history else np.inf
        raise StepError(
            f"Newton did not converge ({reason}; {len(history)} iterations, last increment "
            f"{last:.1e}, wanted {options.tolerance:.0e}): take a smaller step",
            history,
        )

    def _is_rounding(self) -> bool:
        """Whether the next increment is below the tolerance in the norm with the large floor, or nearly so.

        Near in the fine norm: with long steps in a stiff fluid rounding of the pressure alone moves a slow
        velocity by 4e-10 of itself (``barotropic`` demo with steps of a period), and a fresh Jacobian
        contracts quadratically there, so that a factor above ``refresh`` is rounding.
        """
        tolerance = self.options.tolerance
        if self.norm(self._next, self.state, coarse=True) <= tolerance:
            return True
        size = self.norm(self._next, self.state)
        if not size <= NOISE_CAP * tolerance:
            return False
        return size <= 10 * tolerance or size <= NOISE_MARGIN * self._noise()

    def _noise(self) -> float:
        """How much the present increment changes where the state does by one unit in the last place.

        The change of the state itself, by far the smaller one, is not counted apart.  A derivative that is
        wrong does not show here, nor a fold or a kink of the equations: their increments stay what they are.
        """
        u = self.state
        kept, rows, change = (u.CreateVector() for _ in range(3))
        values = u.FV().NumPy()
        kept.data = u
        signs = np.random.default_rng(0)  # a run does the same again
        largest = 0.0
        for _ in range(NOISE_SAMPLES):
            values *= 1 + np.finfo(float).eps * signs.choice((-1.0, 1.0), len(values))
            self.eliminate()
            self.form.Apply(u, rows)
            rows.data -= self._trial_residual
            self.jacobian.solve(rows, change)
            u.data = kept
            largest = max(largest, self.norm(change, u))
        self.refresh()
        return largest

    def _start(self, history: list[NewtonIteration]) -> bool:
        self.refresh()
        self.form.Apply(self.state, self._residual)
        if not np.isfinite(self._residual.Norm()):
            raise StepError("the residual at the start of the step is not finite", history)
        if not self.jacobian.exists:
            return self._refresh(history)
        self.jacobian.solve(self._residual, self._increment)
        return False

    def _refresh(self, history: list[NewtonIteration]) -> bool:
        self.refresh()
        try:
            self.jacobian.factorise(self.state)
        except StepError as error:
            raise StepError(str(error), history) from error
        self.on_factorise()
        self.jacobian.solve(self._residual, self._increment)
        return True

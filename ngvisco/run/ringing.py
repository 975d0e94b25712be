"""Warns if the velocities of a run alternate from step to step."""

from __future__ import annotations

from ngsolve import CF, GridFunction

from ngvisco.errors import NgviscoWarning
from ngvisco.forms.system import Step
from ngvisco.parallel.communicator import Communicator
from ngvisco.physics.tensors import inner, square

_STEPS = 10
"""Number of alternating steps in a row before a run warns; ten signs agree by chance once in 1,000 runs."""
_LEFT = 1e-4
"""Ratio of the kinetic energy to its largest value in the run, up to which alternating velocities bring no
warning, because they are remains of an earlier motion."""


class RingingWarning(NgviscoWarning):
    """Velocities alternate from step to step: the steps do not resolve the motion."""


class Ringing:
    """Warning, once after a start, of velocities that alternate from step to step.

    By the midpoint rule a wave of the frequency omega advances by the angle a, tan(a/2) = omega tau/2, in a
    step of the length tau.  Then v_{n+1} + v_{n-1} = 2 cos(a) v_n, so that int rho v_n . (v_{n+1} + v_{n-1})
    is negative if most of the kinetic energy is in waves with omega tau > 2.  By every scheme this integral
    is negative for a motion that a load repeats in fewer than four steps.  Velocities below the error of a
    step's solution do not count.
    """

    def __init__(self, step: Step, ranks: Communicator) -> None:
        self._step, self._ranks, self._count, self._largest = step, ranks, 0, 0.0
        v, rho = step.now.v, step.now.rho
        self._last, self._before = (GridFunction(step.layout.blocks["v"]) for _ in range(2))
        opposed = rho * inner(self._last, v + self._before)
        self._integrand = CF((opposed, rho * square(self._last), rho)).Compile()

    def __call__(self, t: float, error: float) -> None:
        """Check the state at the time ``t``, s, after a step.

        ``error`` is the error of the velocities, m/s, with which a step is solved.
        """
        if self._count == _STEPS:
            return
        opposed, energy, mass = self._step.quadrature.integrate_cells(self._integrand)
        self._before.vec.data, self._last.vec.data = self._last.vec, self._step.now.v.vec
        self._largest = max(self._largest, energy)
        is_small = energy <= max(mass * error**2, _LEFT * self._largest)
        self._count = self._count + 1 if opposed < 0 and not is_small else 0
        if self._count == _STEPS:
            message = (
                f"until t = {t:.4g} s velocities alternated from step to step, {_STEPS} times in a row, and "
                "so do stresses. The steps do not resolve this motion; take shorter steps. If the start was "
                "out of balance, backward Euler in the first steps (time.startup = 2) or the scheme 'sdirk2' "
                "damps the waves"
            )
            self._ranks.warn(message, RingingWarning, stacklevel=5)

"""The local error of a step, estimated by extrapolation of earlier states.

A step of order p from the exact state has the error u_n - u(t_n) = C tau^(p+1) u^(p+1) with the scheme's
error constant C.  The polynomial through the last p + 1 states misses u(t_n) by -P u^(p+1)/(p+1)!, where P =
prod_j (t_n - t_{n-1-j}).  So

    error = C tau^(p+1) / (C tau^(p+1) + P/(p+1)!) |u_n - u_extrapolated|,

which needs no further solve (for the implicit Euler scheme it is tau/(2 tau + tau_old) times the difference).
There is no estimate before p + 1 states are known.

The relative error is the largest of |e_u|/(|u| + s_u sqrt(volume)) over the evolving unknowns u, with L2
norms over the domain.  The scale s_u (``ngvisco.forms.term``) is the run's velocity scale for v, 0 for rho,
and 1 for z.
"""

import math
from collections.abc import Callable

import numpy as np
from ngsolve import CF, FESpace, GridFunction

from ngvisco.forms.system import Step
from ngvisco.physics.tensors import square
from ngvisco.timestepping.scheme import TimeScheme


class ErrorEstimate:
    """Estimates the error of the last step from stored states, which a checkpoint contains too.

    ``velocity_scale`` returns v_s, m/s; ``order`` is the highest order of a scheme to be estimated.
    """

    def __init__(self, step: Step, velocity_scale: Callable[[], float], order: int) -> None:
        self.step, self.velocity_scale = step, velocity_scale
        self._enough = order + 1
        self._times: list[float] = []
        self._states: list[np.ndarray] = []
        names = step.layout.evolving
        self._difference = GridFunction(FESpace([step.layout.blocks[name] for name in names]))
        errors, now = self._difference.components, (step.now.parts[name] for name in names)
        self._squares = CF((*map(square, errors), *map(square, now), 1.0)).Compile()

    def begin(self, time: float) -> None:
        """Begin a step at ``time``, s; if no state of this time is stored, store the present state alone."""
        if not (self._times and self._times[-1] == time):
            self._times, self._states = [], []
            self.keep(time)

    def keep(self, time: float) -> None:
        """Store the present state as the accepted one at ``time``, s."""
        self._times.append(time)
        self._states.append(self._values())
        del self._times[: -self._enough], self._states[: -self._enough]

    def __call__(self, time: float, scheme: TimeScheme) -> float | None:
        """Relative error of the step to the present state at ``time``, s; None if unknown."""
        p = scheme.order
        if len(self._times) < p + 1:
            return None
        times = np.array(self._times[-p - 1 :])
        weights = [np.prod([(time - s) / (t - s) for s in times if s != t]) for t in times]
        missed = np.prod(time - times) / math.factorial(p + 1)
        weight = scheme.error_constant * (time - times[-1]) ** (p + 1)
        extrapolated = sum(w * u for w, u in zip(weights, self._states[-p - 1 :], strict=True))
        self._difference.vec.FV().NumPy()[:] = weight / (weight + missed) * (self._values() - extrapolated)
        norms = np.sqrt(np.asarray(self.step.quadrature.integrate_cells(self._squares)))
        unknowns = [self.step.layout.unknowns[name] for name in self.step.layout.evolving]
        errors, sizes, root_volume = norms[: len(unknowns)], norms[len(unknowns) : -1], norms[-1]
        scales = [self.velocity_scale() if u.place == "velocity" else u.scale for u in unknowns]
        wholes = sizes + np.array(scales) * root_volume
        return float(max(e / s if s > 0 else e for e, s in zip(errors, wholes, strict=True)))

    def _values(self) -> np.ndarray:
        state, ranges = self.step.state.vec.FV().NumPy(), self.step.layout.ranges
        return np.concatenate([state[ranges[name]] for name in self.step.layout.evolving])

    def state_dict(self) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers and arrays for a restart."""
        numbers = {f"known_{i}": t for i, t in enumerate(self._times)}
        return numbers, {f"known_{i}": state.copy() for i, state in enumerate(self._states)}

    def load_state_dict(self, numbers: dict[str, float], arrays: dict[str, np.ndarray]) -> None:
        """Restore times and states from ``state_dict``."""
        kept = sorted(name for name in arrays if name.startswith("known_"))
        self._times = [numbers[name] for name in kept]
        self._states = [arrays[name] for name in kept]

"""The local error of a step, estimated by extrapolation of earlier states.

A step of order p from the exact state has the error u_n - u(t_n) = C tau^(p+1) u^(p+1) with the scheme's
error constant C.  The polynomial through the last p + 1 states misses u(t_n) by -P u^(p+1)/(p+1)!, where P =
prod_j (t_n - t_{n-1-j}).  So

    error = C tau^(p+1) / (C tau^(p+1) + P/(p+1)!) |u_n - u_extrapolated|,

which needs no further solve (for the implicit Euler scheme it is tau/(2 tau + tau_old) times the difference).
There is no estimate before p + 1 states are known.

The relative error is the largest of |e_u|/(|u| + s_u sqrt(volume)) over the evolving unknowns other than z
and over the variables in z, with L2 norms over the domain.  The scale s_u (``ngvisco.forms.term``) is the
run's velocity scale v_s for v, and 0 for rho.  For a strain, u is its departure z - z(F = I), and s_u is
v_s/c, the strain in a wave of the velocity v_s and the speed c, plus ``least``, the ratio of the solver's
tolerance to the tolerance of this error; in a run without waves s_u is 1.
entropy or a body's amount, and for a parameter, s_u is 1.
"""

import math
from typing import Protocol

import numpy as np
from ngsolve import CF, FESpace, GridFunction

from ngvisco.forms.system import Step
from ngvisco.physics.tensors import Tensor, square
from ngvisco.physics.variables import Values
from ngvisco.timestepping.scheme import TimeScheme


class Scaled(Protocol):
    """A run with its velocity scale v_s and its speed of waves c, m/s; c is 0 without waves."""

    rothe_step: Step
    velocity_scale: float
    wave_speed: float


class ErrorEstimate:
    """Estimates the error of the last step from stored states, which a checkpoint contains too.

    ``least`` is the strain that is added to the scale of strains, because the solver's tolerance hides errors
    of smaller strains; ``order`` is the highest order of the schemes whose errors are estimated.
    """

    def __init__(self, run: Scaled, least: float, order: int) -> None:
        step = self.step = run.rothe_step
        self.run, self.least, self._enough = run, least, order + 1
        self._times: list[float] = []
        self._states: list[np.ndarray] = []
        names, now = step.layout.evolving, step.now.parts
        self._difference = GridFunction(FESpace([step.layout.blocks[name] for name in names]))
        errors = dict(zip(names, self._difference.components, strict=True))
        self._strains = {v.name for v in step.model.material.variables if v.is_strain and not v.is_conserved}
        exact, computed = self._counted(now["z"] - errors["z"]), self._counted(now["z"])
        unknowns = [step.layout.unknowns[name] for name in names if name != "z"]
        pairs = [(errors[u.name], now[u.name]) for u in unknowns]
        pairs += [(computed[name] - exact[name], computed[name]) for name in computed]
        self._squares = CF((*(square(part) for pair in pairs for part in pair), 1.0)).Compile()
        # a scale is the sum of a number and of multiples of the velocity's scale and of the strains' scale
        scales = [(u.scale, float(u.place == "velocity"), 0.0) for u in unknowns]
        scales += [(0.0, 0.0, 1.0) if name in self._strains else (1.0, 0.0, 0.0) for name in computed]
        self._scales = np.array(scales)

    def _counted(self, components: Tensor) -> Values:
        """The values whose errors are estimated, by variable; for a strain the departure from F = I."""
        z = self.step.layout.states.tensors(lambda: components)
        rest = self.step.model.material.at_rest(z)
        return {name: z[name] - rest[name] if name in self._strains else z[name] for name in z}

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
        """Relative error of the step that ends in the present state at ``time``, s.

        The result is None if fewer states are stored than the scheme's order plus one.
        """
        p = scheme.order
        if len(self._times) < p + 1:
            return None
        times = np.array(self._times[-p - 1 :])
        weights = [np.prod([(time - s) / (t - s) for s in times if s != t]) for t in times]
        missed = np.prod(time - times) / math.factorial(p + 1)
        weight = scheme.error_constant * (time - times[-1]) ** (p + 1)
        extrapolated = sum(w * u for w, u in zip(weights, self._states[-p - 1 :], strict=True))
        self._difference.vec.FV().NumPy()[:] = weight / (weight + missed) * (self._values() - extrapolated)
        *norms, root_volume = np.sqrt(np.asarray(self.step.quadrature.integrate_cells(self._squares)))
        velocity, waves = self.run.velocity_scale, self.run.wave_speed
        strain = velocity / waves + self.least if waves > 0 else 1.0
        wholes = norms[1::2] + root_volume * (self._scales @ (1.0, velocity, strain))
        return float(max(e / s if s > 0 else e for e, s in zip(norms[::2], wholes, strict=True)))

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

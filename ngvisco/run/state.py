"""The parts of a run and its present time, for everything that reads a run.

``ngvisco.run.simulation.Simulation`` moves the time and has the observers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, TypeAlias

from ngsolve import CoefficientFunction

from ngvisco.forms.bounds import Bounds
from ngvisco.forms.context import time as run_time
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.start.data_checks import check_loads, check_walls
from ngvisco.forms.start.initial import Initial, set_initial
from ngvisco.forms.system import Step
from ngvisco.forms.tension import Tension
from ngvisco.forms.unfelt import require_held
from ngvisco.run.fields import FieldsByName, output_fields, require_names_of_their_own
from ngvisco.run.ledger import Ledger, closure_limit
from ngvisco.run.passive import CARRIED, PassiveFields
from ngvisco.run.ranks import Numbering
from ngvisco.run.scales import diameter, fastest_wave, typical_velocity
from ngvisco.run.stepping import AdaptiveStepper, TimeSteps
from ngvisco.solver.options import NewtonOptions
from ngvisco.solver.rothe import RotheSolver
from ngvisco.timestepping.integrator import Integrator
from ngvisco.timestepping.scheme import TimeScheme

_LOOKED_AT = 4

KeptPart: TypeAlias = tuple[dict[str, float], dict[str, Any]]
"""Numbers, and arrays or objects that NumPy converts to arrays: a part of a run's data for a restart."""


class RunState:
    """The parts of a run, made from its equations, and its present state and time."""

    def __init__(
        self, step: Step, time: TimeSteps, initial: Initial, options: NewtonOptions, passive: Sequence[str]
    ) -> None:
        """Make the parts and set the start values; see ``Simulation`` for the arguments and errors."""
        mesh, model = step.mesh, step.model
        self.mesh, self.model, self.rothe_step = mesh, model, step
        self.dt, self.given_velocity_scale = float(time.dt), time.velocity_scale
        self.stepper = time.stepper()
        self.stepper.require(step)
        require_held(model, step.discretisation)
        require_names_of_their_own(model.material, step.layout.further, CARRIED)
        self.sampler = Sampler(mesh, step.quadrature)
        self.ranks = self.sampler.ranks
        self.unknowns = step.layout.count()
        """The number of unknowns on the whole mesh, over all ranks, as ``cells`` is the number of cells."""
        self.cells = int(self.ranks.total(mesh.ne))
        self._cells_here = mesh.ne
        self._t, self._number, self.stop_requested = 0.0, 0, False
        self.check_data(0.0)
        run_time.Set(0.0)  # start values and walls are evaluated at t = 0, also after other runs
        F_0 = set_initial(step, initial, self.sampler)
        self.set_velocity_scale(float(time.velocity_scale or typical_velocity(step, self.sampler, self.dt)))
        self.bounds = Bounds(step, self.sampler, time.limiter, time.drift)
        self.solver = RotheSolver(step, options, self.bounds.refusal)
        closed = closure_limit(options.tolerance)
        self.ledger = Ledger(step, self.sampler, closed, lambda: self.velocity_scale)
        self.ledger.momentum.impulses.on_sides = self.solver.on_sides
        self.ledger.exchange.on_sides = self.solver.dissipated_on_sides
        self.tension = Tension(step, self.sampler)
        self.passive = PassiveFields(step, passive, F_0)
        distances, sharpening = self.passive.distances, self.bounds.sharpening
        if sharpening is not None and step.discretisation.outlines:
            sharpening.follow(distances)
        carried = [part for part in (self.passive, distances, sharpening) if part is not None]
        self.integrator = Integrator(
            self.solver,
            time.made,
            self.ledger.rates,
            self.bounds,
            carried=carried,
            startup=time.startup,
            relaxed=time.relaxation,
        )

    def set_velocity_scale(self, scale: float) -> None:
        """Set the velocity scale, m/s, and from it the curvature of v in the penalty's weight.

        Adaptive steps also need the speed of waves at the present state, m/s."""
        self.velocity_scale = scale
        self.wave_speed = fastest_wave(self.rothe_step, self.sampler) if self.is_adaptive else 0.0
        self.rothe_step.context.curvature.Set(0.1 * scale / diameter(self.rothe_step.mesh, self.ranks) ** 2)

    def set_time(self, t: float, number: int) -> None:
        """Set the number and the time ``t`` (s) of the present state.

        If ``t`` is not a multiple of dt, see ``stepper.begin``.
        """
        self._t, self._number = t, number
        run_time.Set(t)

    @property
    def t(self) -> float:
        """Time of the present state, s; the run alone advances it."""
        return self._t

    @property
    def number(self) -> int:
        """Number of the present state among the accepted states, 0 at the start."""
        return self._number

    @cached_property
    def numbering(self) -> Numbering:
        """The numbering of the unknowns on one process, for checkpoints; made by all ranks together."""
        return Numbering(self.rothe_step, self.passive, self.ranks)

    @property
    def scheme(self) -> TimeScheme:
        """The time scheme of the run (after its startup)."""
        return self.integrator.scheme

    @property
    def step_number(self) -> int:
        """Number of the step under way, or of the step that ended; ``number`` also counts parts of steps."""
        return self.stepper.step_of(self.t, self.number)[0]

    @property
    def step_under_way(self) -> int:
        """Number of the step that the run is within, or of the next step if a step has just ended."""
        return self.step_number + self.is_due(1)

    def is_due(self, every: int) -> bool:
        """Whether the present state ends a step whose number is a multiple of ``every``."""
        number, ended = self.stepper.step_of(self.t, self.number)
        return ended and number % every == 0

    @property
    def is_adaptive(self) -> bool:
        """Whether the run itself chooses its step lengths."""
        return isinstance(self.stepper, AdaptiveStepper)

    @property
    def fields(self) -> dict[str, CoefficientFunction]:
        """Velocity, density, the material's variables and stresses at the present time, by name.

        ``velocity`` has the mesh's dimension, tensors are 3x3; ``cauchy_stress`` is the elastic stress T by
        the projected conjugates, with ``pressure`` = -tr T/3 and ``von_mises``, all in Pa.  Creep rate,
        Mandel, viscous and hyperstress, principal stresses and stretches are present if the model has them
        (``ngvisco.run.fields``), as are the run's passive fields.
        """
        self.rothe_step.local_unknowns.update_stored()
        return FieldsByName(self._expressions | self.passive.fields)

    @cached_property
    def _expressions(self) -> dict[str, CoefficientFunction]:
        return output_fields(self.rothe_step)

    def check_data(self, until: float) -> None:
        """Raise ParameterError for bad values of loads and walls from the present time to ``until``, s.

        ``run`` calls this before its first step.
        """
        times = self._looked_at(until)
        check_loads(self.rothe_step, self.sampler, times)
        check_walls(self.rothe_step, times)

    def _looked_at(self, until: float) -> list[float]:
        """Times, s, at which ``check_data`` evaluates loads and walls."""
        return sorted({self.t + i / _LOOKED_AT * (until - self.t) for i in range(_LOOKED_AT + 1)})

"""How a run goes through time: scheme, step lengths and what belongs to them, checked as a whole."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Literal

from ngvisco.errors import ParameterError, Quantity, UnknownNameError, require_ranges, require_type
from ngvisco.run.stepping import (
    HALVINGS,
    MOST_HALVINGS,
    AdaptiveStepper,
    AdaptiveSteps,
    FixedStepper,
    Stepper,
)
from ngvisco.timestepping.scheme import TimeScheme, midpoint, scheme_of

LEAST_CONSTANT = 1e-2
"""Error constant of a scheme, times (p + 1)!, below which its local error cannot be estimated by it."""


@dataclass(frozen=True, kw_only=True)
class TimeSteps:
    """Scheme and step lengths of a run, the keys of [time] in a case file but for its end.

    Raises ParameterError or UnknownNameError if a parameter is out of its range, or does not fit the scheme.

    Parameters
    ----------
    dt : float
        Length of a step; of the first one, with [time.adaptive].
    scheme : str or TimeScheme
        Time scheme: "backward-euler" (order 1, the paper's), "midpoint" (order 2, damps nothing), "sdirk2"
        (order 2, damps what the step does not resolve) or "theta".
    theta : float, optional
        Of scheme = "theta": 1/2 is midpoint, 1 backward-euler.
    startup : int
        First steps of the run that are of backward-euler, which damps rough data.
    relaxation : bool
        With midpoint and [time.adaptive]: end each step where the scheme dissipates nothing.
    limiter : bool
        Whether cells in which rho, J, det F, ... are not positive at a point, though in the mean, are scaled
        towards their means after a step, whose energy the ledger has as limiter; false ends the run there.
    halvings : int
        Of a step of fixed length that is not solved, before the coupled solver is asked; 0 asks at once.
    velocity_scale : float, optional
        A typical velocity, which sets the width of the upwinding (1e-4 of it); default: of flow, walls, free
        fall or elastic release, at rest a tenth of the speed of sound.
    adaptive : AdaptiveSteps, optional
        Step lengths chosen by the run; of one length without this table.
    """

    dt: Annotated[float, Quantity("s", "> 0", 0.02)]
    scheme: Literal["backward-euler", "midpoint", "theta", "sdirk2"] | TimeScheme = "backward-euler"
    theta: Annotated[float | None, Quantity("1", "in [1/2, 1]", 0.6)] = None
    startup: Annotated[int, Quantity("1", ">= 0")] = 0
    relaxation: bool = False
    limiter: bool = True
    halvings: Annotated[int, Quantity("1", f"from 0 to {MOST_HALVINGS}")] = HALVINGS
    velocity_scale: Annotated[float | None, Quantity("m/s", "> 0", 1.0)] = None
    adaptive: AdaptiveSteps | None = None

    def __post_init__(self) -> None:
        require_ranges(self)
        for name in ("relaxation", "limiter"):
            require_type(f"TimeSteps.{name}", getattr(self, name), bool)
        if self.adaptive is not None:
            require_type("TimeSteps.adaptive", self.adaptive, AdaptiveSteps)
            if not self.adaptive.dt_min <= self.dt <= self.adaptive.dt_max:
                expected = (
                    f"a number from {self.adaptive.dt_min:g} to {self.adaptive.dt_max:g}, dt_min to dt_max"
                )
                raise ParameterError("TimeSteps.dt", self.dt, expected)
        self._check_scheme()

    def _check_scheme(self) -> None:
        made, tolerance = self.made, None if self.adaptive is None else self.adaptive.tolerance
        if (
            tolerance is not None
            and abs(made.error_constant) * math.factorial(made.order + 1) < LEAST_CONSTANT
        ):
            expected = (
                f"None with this scheme, whose local error is not that of its order {made.order}: "
                f"its error constant is {made.error_constant:.1e}"
            )
            raise ParameterError("AdaptiveSteps.tolerance", tolerance, expected)
        if self.relaxation and (self.adaptive is None or made.A != midpoint().A):
            expected = "False, or the scheme 'midpoint' with adaptive steps"
            raise ParameterError("TimeSteps.relaxation", self.relaxation, expected)

    def stepper(self) -> Stepper:
        """What takes these steps."""
        dt = float(self.dt)
        return (
            FixedStepper(dt, self.halvings) if self.adaptive is None else AdaptiveStepper(dt, self.adaptive)
        )

    @cached_property
    def made(self) -> TimeScheme:
        """The scheme itself."""
        try:
            return scheme_of(self.scheme, self.theta)
        except ParameterError as error:
            field = error.field if "." in error.field else f"TimeSteps.{error.field}"
            raise ParameterError(field, error.value, error.expected) from error


def time_steps(time: TimeSteps | None, given: Mapping[str, Any]) -> TimeSteps:
    """What ``Simulation`` was given of time: ``time``, or parameters of it.

    Raises ParameterError if it was given twice, or not at all; TypeError for what is no argument.
    """
    known = [field.name for field in fields(TimeSteps)]
    for name in given:
        if name not in known:
            raise TypeError(f"Simulation(): {UnknownNameError('keyword argument', name, known)}")
    if time is None:
        return TimeSteps(**{"dt": None, **given})
    require_type("Simulation.time", time, TimeSteps)
    if given:
        raise ParameterError("Simulation.time", time, f"None beside {', '.join(given)}, parameters of it")
    return time

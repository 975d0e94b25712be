"""Report on a step that could not be taken: the failure, the advised change and the time reached; details
follow below a line.

``Simulation.advance`` attaches a ``FailureReport`` to the StepError that it raises.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from ngsolve import L2, GridFunction

from ngvisco.errors import StepError
from ngvisco.forms.bounds import Violation
from ngvisco.forms.mesh.locating import nearest_wall
from ngvisco.parallel.mesh import number_of
from ngvisco.physics.defects import remedy
from ngvisco.physics.flow_rules.laws import Creep
from ngvisco.physics.material import part_of
from ngvisco.physics.materials.thermal import Thermal
from ngvisco.physics.model import Model
from ngvisco.physics.variables import Distortion, LeftCauchyGreen
from ngvisco.run.files import write_atomically
from ngvisco.run.scales import diameter
from ngvisco.run.state import RunState
from ngvisco.run.vtu import shown_by, write_vtu
from ngvisco.solver.problem import Attempt, Status, iterations

_SHOWN = 4
"""Number of an attempt's last iterations whose increments a report shows."""
_RULE = 80 * "-"

_ROUNDING = 1e-12
"""Share of the usual |v|/h below which matter counts as at rest."""
_FAST = 1.0
"""Courant number above which a report gives advice about it."""

_SHARP = 1e-5
"""Ratio of a creep rate's floor and the largest |v|/h, below which a report advises a larger floor."""


@dataclass(frozen=True)
class FailureReport:
    """The report on a step that a run could not take; ``str`` gives its text.

    Attributes
    ----------
    time, tau : float
        Begin and length of the step, s; in a run with adaptive steps those of the last step tried.
    number : int
        Number of the step that failed, from 1.
    violation, state : Violation and array, or None
        The bound that the refused solution violates, and the coefficients of this solution (on several ranks
        those of this rank), which ``showing`` shows; None if no solution was found.
    courant : float
        Largest tau |v|/h in the state before the step; 0 at rest.
    fastest, place, wall : int or None, tuple, and str or None
        Number in the whole mesh (None if unknown) of the cell with the largest |v|/h, the place of this
        value, m, and the name of the nearest wall.
    history : tuple of Attempt
        Attempts to solve the step, with their start values.
    advice : tuple of str
        Advised changes by the keys of a case file, the likeliest first.
    parted : str or None
        Names of the variables of one distortion that have parted too far, if that is the reason.
    nearest : str or None
        The bound of the energy's domain to which the state before the step is nearest, with its value and
        place; None for an energy without bounds of its own.
    """

    time: float
    tau: float
    number: int
    reason: str
    violation: Violation | None
    state: np.ndarray | None
    courant: float
    fastest: int | None
    place: tuple[float, ...]
    wall: str | None
    history: tuple[Attempt, ...]
    advice: tuple[str, ...]
    parted: str | None = None
    nearest: str | None = None

    def __str__(self) -> str:
        near = "" if self.wall is None else f", the nearest wall is {self.wall!r}"
        at = f"at ({', '.join(f'{c:.4g}' for c in self.place)}) m{near}"
        cell = "" if self.fastest is None else f"in cell {self.fastest} "
        first, *further_advice = self.advice
        where = f"the flow is fastest {at}" if self.courant else "the body was at rest"
        if self.nearest is not None:
            where = f"before the step {self.nearest}"
        failure = self.violation or self.parted or f"no solution was found; {where}"
        fast = f"the largest Courant number is {self.courant:.3g}, {cell}{at}"
        lines = [
            f"what       step {self.number} over {self.tau:.4g} s was not taken: {failure}",
            f"change     {first}",
            f"reached    t = {self.time:.6g} s, {self.number - 1} step{'' if self.number == 2 else 's'}",
            _RULE,
            *(f"or change  {line}" for line in further_advice),
            f"reason     {self.reason}",
            f"flow       {fast if self.courant else 'at rest'}",
            *(f"tried      {line}" for line in _described(self.history)),
        ]
        return "\n".join(lines)


def _described(history: Sequence[Attempt]) -> Iterator[str]:
    """Yield a line for each kind of start values: the number of attempts, and the end of the last one."""
    for which, group in groupby(history, key=lambda attempt: attempt.start):
        attempts = list(group)
        last = attempts[-1].solution
        text = f"{which}: {len(iterations(attempts))} iterations"
        if len(attempts) > 1:
            solved = sum(attempt.solution.converged for attempt in attempts)
            text += f" in {len(attempts)} attempts, {solved} of them solved; the last attempt"
        increments = ", ".join(f"{iteration.increment:.1e}" for iteration in last.history[-_SHOWN:])
        yield text + f": {last.status.value}" + (f", increments {increments}" if increments else "")


def failure_report(simulation: RunState, error: StepError) -> FailureReport:
    """The report on the last step tried from the simulation's present state, which failed with ``error``.

    Collective; all ranks get the same report, except for ``state``.
    """
    rate, fastest, place = _fastest(simulation)
    tau = simulation.integrator.tried
    violation, state = simulation.bounds.refused or (None, None)
    return FailureReport(
        time=simulation.t,
        tau=tau,
        number=simulation.step_under_way,
        reason=str(error),
        violation=violation,
        state=state,
        courant=tau * rate,
        fastest=fastest,
        place=place,
        wall=nearest_wall(simulation.mesh, np.array(place))[0],
        history=tuple(error.history),
        advice=tuple(
            [*_held(simulation.model, error.history), *_advice(simulation, violation, tau * rate, rate)]
        ),
        parted=simulation.bounds.parted,
        nearest=simulation.bounds.nearest(),
    )


def _held(model: Model, history: Sequence[Attempt]) -> Iterator[str]:
    """Yield advice if some attempt ended because rounding of the stress moved the body."""
    if not any(attempt.solution.status is Status.ROUNDING for attempt in history):
        return
    yield (
        "springs (walls.NAME.stiffness), a larger density, or solver.tolerance = 1e-8, since rounding moves "
        "a stiff body that only inertia resists, the farther the shorter the steps"
    )
    if part_of(model.material, Thermal) is not None:
        yield "thermal.theta_R near the temperature at the start, since a small entropy has little rounding"


def _fastest(simulation: RunState) -> tuple[float, int | None, tuple[float, ...]]:
    """The largest |v|/h, 1/s, the number of its cell, and its place, m."""
    sampler, step = simulation.sampler, simulation.rothe_step
    rates = np.linalg.norm(sampler.rows(step.now.v), axis=1) / sampler.rows(step.context.h)[:, 0]
    mine = None
    if len(rates):
        fastest = int(np.argmax(rates))
        place = sampler.coordinates(np.array([fastest]))[0]
        cell = number_of(simulation.mesh, int(sampler.cells[fastest]))
        mine = float(rates[fastest]), cell, tuple(float(c) for c in place)
    every = [entry for entry in simulation.ranks.gathered(mine) if entry is not None]
    rate, fastest, place = min(every, key=lambda entry: (-entry[0], -1 if entry[1] is None else entry[1]))
    usual = simulation.velocity_scale / diameter(simulation.mesh, simulation.ranks)
    return rate if rate > _ROUNDING * usual else 0.0, fastest, place


def _advice(simulation: RunState, violation: Violation | None, courant: float, rate: float) -> list[str]:
    """Advised changes, the likeliest first; ``rate`` is the largest |v|/h, 1/s."""
    model, lines = simulation.model, []
    if violation is not None and not violation.is_mean:
        lines.append("time.limiter = true, with which the run goes on if the means of all cells are positive")
    shorter = "shorter steps (time.dt), or adaptive steps ([time.adaptive])"
    lines.append(
        shorter + (f", since the largest Courant number is {courant:.3g}" if courant > _FAST else "")
    )
    if violation is None and simulation.bounds.parted is not None:
        return [remedy(model.material), *lines]
    domain = model.material.domain(simulation.rothe_step.now.z_tensors)
    if violation is None:
        if domain:
            bounds = " and ".join(f"{name} > 0" for name in domain)
            lines.append(f"an energy that has values also outside of {bounds}, or smaller loads")
        elif (met := simulation.rothe_step.energy.last_failure) is not None:
            lines.insert(0, f"the material, or smaller loads, since {met}")
        creep = model.creep
        is_sharp = creep is not None and not isinstance(creep, Creep) and creep.nu != 0
        # the floor of creep rates is far below the flow's rates
        if creep is not None and is_sharp and creep.rate_floor < _SHARP * rate:
            floor = f"rheology.creep.rate_floor from {creep.rate_floor:.3g}/s to a thousandth of the rates of"
            lines.insert(0, f"{floor} creep; the largest |v|/h is {rate:.2g}/s")
        return [*lines, "a larger viscosity, a smoother start, or loads and walls that change slowly"]
    near = "there" if violation.wall is None else f"near {violation.wall!r}"
    lines.append(
        f"a finer mesh {near}, or data that are smooth there (as equal velocities of walls that meet)"
    )
    if violation.quantity in domain:
        lines.append(f"an energy that has values also outside of {violation.quantity} > 0, or smaller loads")
        return lines
    if violation.quantity != "rho":
        lines.append("an energy that rises faster as the volume goes to zero (material.epsilon, kappa)")
        lines.append("material.J_min or a Yosida approximation, with which a run may pass J = 0")
    variables = model.material.variables
    distortion = next((v for v in variables if isinstance(v, Distortion)), None)
    if distortion is not None and violation.quantity == f"det {distortion.name}":
        lines.append('material.elastic_state = "B" for a body that flows')
    if any(isinstance(v, LeftCauchyGreen) for v in variables) and model.creep is None:
        lines.append("creep for a body that flows, since B then relaxes")
    return lines


@contextlib.contextmanager
def showing(simulation: RunState, state: np.ndarray) -> Iterator[None]:
    """Context in which the simulation's ``fields`` show other coefficients, e.g. of a ``FailureReport``."""
    step = simulation.rothe_step
    values = step.state.vec.FV().NumPy()
    present = values.copy()
    try:
        values[:] = state
        step.local_unknowns.update_stored()
        yield
    finally:
        values[:] = present
        step.local_unknowns.update_stored()


def write_failure(text: Path, fields: Path, simulation: RunState, report: FailureReport) -> Path:
    """Write the report as text, and the refused solution, or else the last state, as .vtu.

    The field ``out_of_bounds`` is 1 in cells where a bound is violated.  Returns the file of the fields, over
    ranks the .pvtu of their pieces.  Collective; an OSError of one rank is raised on all ranks.
    """
    ranks = simulation.ranks
    shown_in = shown_by(fields, ranks)
    state = simulation.rothe_step.state.vec.FV().NumPy().copy()
    title = f"the last state, t = {report.time:g} s"
    if report.state is not None:
        state, title = report.state, "the solution that was refused"
    written = f"{report}\nfields     {shown_in.name}: {title}\n".encode()
    ranks.on_first(lambda: write_atomically(text, written))
    outside = GridFunction(L2(simulation.mesh, order=0))
    with showing(simulation, state):
        outside.vec.FV().NumPy()[simulation.bounds.cells_outside()] = 1.0
        shown = simulation.fields | {"out_of_bounds": outside}
        with ranks.together(OSError):
            write_vtu(fields, simulation.mesh, shown)
    return shown_in

"""Gradients of what a run gives by its parameters."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ngvisco.errors import ParameterError, as_number, require_collection
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.columns import Columns, Wanted, columns_of, tables_of
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.parameters import Named
from ngvisco.sensitivity.tangent import History, Neighbours, history, tangents
from ngvisco.sensitivity.trajectory import Trajectory


@dataclass(frozen=True)
class Gradient:
    """Numbers of a run and their derivatives by its parameters.

    Attributes
    ----------
    of, by : tuple of str
        The numbers' and the parameters' names.
    values : array, (numbers,)
        In the units of the columns.
    jacobian : array, (numbers, parameters)
        In these units over those of the parameters.
    at : array, (parameters,)
        The parameters' values.
    limited : int
        Cells that the limiter changed, over all steps: what it adds to a state is kept in the derivatives.
    """

    of: tuple[str, ...]
    by: tuple[str, ...]
    values: np.ndarray
    jacobian: np.ndarray
    at: np.ndarray
    limited: int = 0

    def __getitem__(self, key: tuple[str, str]) -> float:
        """The derivative of a number by a parameter, by their names."""
        of, by = key
        return float(self.jacobian[self.of.index(of), self.by.index(by)])

    def __str__(self) -> str:
        """A table: a line for each number, a column for each parameter."""
        head = ["", "value", *(f"d/d {name}" for name in self.by)]
        body = [
            [name, f"{value:.8g}", *(f"{one:.8g}" for one in row)]
            for name, value, row in zip(self.of, self.values, self.jacobian, strict=True)
        ]
        widths = [max(len(line[i]) for line in (head, *body)) for i in range(len(head))]
        lines = ("  ".join(f"{x:>{w}}" for x, w in zip(line, widths, strict=True)) for line in (head, *body))
        return "\n".join(lines)


def gradient(
    simulation: Simulation,
    until: float,
    *,
    of: Sequence[str] | Mapping[str, str],
    by: Sequence[str],
    progress: Callable[[int, int], None] | None = None,
) -> Gradient:
    """Run a simulation until a time, and differentiate what it gives by parameters.

    The derivatives are those of the discrete scheme: of the numbers that this run computes, with its mesh and
    its steps, and not approximations of those of the equations.  Frozen are the lengths of adaptive steps,
    what the limiter adds to a state, the widths of the upwinding and the velocity v* that says its sides.

    Raises ParameterError or UnknownNameError for a number or a parameter that there is not, for damage,
    relaxed steps and several ranks, whose derivatives are not known; StepError as ``Simulation.run``.

    Parameters
    ----------
    simulation : Simulation
        It is run, with its observers.  At its start the start values depend on the parameters; later, as
        after ``restore``, the present state is kept.
    until : float
        s.
    of : sequence of str, or mapping of names to such
        ``"COLUMN at TIME"``, or ``"COLUMN until TIME"`` for the integral over time, of a column of the ledger
        or of a table among the run's observers (``Probes``, ``Integrals``, ``WallForces``, ``Bodies``).
    by : sequence of str
        Parameters by their paths, as ``"material.G_e"``, ``"creep.G_m"``, ``"loads.gravity.g.1"``,
        ``"initial.density"``.
    progress : callable, optional
        Called with the number of steps that are differentiated, and that of all.

    Returns
    -------
    Gradient
    """
    wanted, parameters = _wanted(of, until), _parameters(by, simulation)
    names, tables = columns_of(wanted), tables_of(simulation)
    base, is_start = _base(simulation, names), simulation.number == 0
    if not is_start and any(one.is_of_start for one in parameters):
        expected = "no start values: the run has begun, and goes on from its present state"
        raise ParameterError("by", by, expected)
    trajectory = Trajectory(simulation)
    near = [Neighbours(one, simulation, names, tables) for one in parameters]
    trajectory.run(until)
    total = len(trajectory.steps)
    tell = None if progress is None else (lambda number: progress(number, total))
    found = history(trajectory, base)
    derivatives = tangents(trajectory, base, near, is_start, *([] if tell is None else [tell]))
    values = np.array([_read(found, names, one) for one in wanted.values()])
    jacobian = np.array([_read(derivatives, names, one) for one in wanted.values()])
    at = np.array([one.value for one in parameters])
    by_names = tuple(one.name for one in parameters)
    return Gradient(tuple(wanted), by_names, values, jacobian, at, trajectory.limited)


def measure(simulation: Simulation, until: float, of: Sequence[str] | Mapping[str, str]) -> np.ndarray:
    """Run a simulation until a time; the numbers of ``gradient`` without derivatives, (numbers,)."""
    wanted = _wanted(of, until)
    names, trajectory = columns_of(wanted), Trajectory(simulation)
    base = _base(simulation, names)
    trajectory.run(until)
    found = history(trajectory, base)
    return np.array([_read(found, names, one) for one in wanted.values()])


def _base(simulation: Simulation, names: Sequence[str]) -> Follower:
    """A follower with the run's own parameters."""
    tables = tables_of(simulation)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the run itself has said what is doubtful
        worker = simulation.on(simulation.mesh, observers=())
    worker.set_velocity_scale(simulation.velocity_scale)
    return Follower(worker, Columns(worker, names, tables))


def _wanted(of: Sequence[str] | Mapping[str, str], until: float) -> dict[str, Wanted]:
    if isinstance(of, Mapping):
        found = {name: Wanted.of(text) for name, text in of.items()}
    else:
        texts = require_collection("of", of, 'texts as "kinetic at 0.5"')
        found = {str(text): Wanted.of(text) for text in texts}
    if not found:
        raise ParameterError("of", of, "at least one number of the run")
    end = as_number(until)
    for name, one in found.items():
        if end is None or not 0 <= one.time <= end * (1 + 1e-12):
            raise ParameterError(f"of: {name}", one.time, f"a time from 0 to the end of the run, {until} s")
    return found


def _parameters(by: Sequence[str], simulation: Simulation) -> list[Named]:
    names = require_collection("by", by, 'names of parameters, e.g. ["material.G_e"]')
    if not names or len(set(names)) < len(names):
        raise ParameterError("by", by, "at least one parameter, and each once")
    return [Named.of(name, simulation) for name in names]


def _read(history: History, names: Sequence[str], wanted: Wanted) -> np.ndarray:
    """A number of a history, interpolated linearly between the ends of steps."""
    column, times = names.index(wanted.column), history.times
    values = (history.integrals if wanted.is_integral else history.ends)[:, column]
    upper = int(np.clip(np.searchsorted(times, wanted.time * (1 - 1e-12)), 1, len(times) - 1))
    share = (wanted.time - times[upper - 1]) / (times[upper] - times[upper - 1])
    share = float(np.clip(share, 0.0, 1.0))
    result: np.ndarray = (1 - share) * values[upper - 1] + share * values[upper]
    return result

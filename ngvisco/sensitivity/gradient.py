"""Gradients of a run's results by its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from ngsolve import GridFunction

from ngvisco.errors import ParameterError, require_collection, require_known, require_type
from ngvisco.forms.projections import inverse_mass
from ngvisco.physics.parameters import Parameter
from ngvisco.run.files import AnyPath
from ngvisco.run.simulation import Simulation
from ngvisco.sensitivity.adjoint import Adjoint
from ngvisco.sensitivity.columns import Columns, tables_of
from ngvisco.sensitivity.follower import Follower
from ngvisco.sensitivity.numbers import Misfit, Numbers
from ngvisco.sensitivity.parameters import AT_FIXED_STATES, OFFSETS, STEP, Named, varied
from ngvisco.sensitivity.restart import Restart
from ngvisco.sensitivity.slopes import Slopes
from ngvisco.sensitivity.tangent import Neighbours, history, tangents
from ngvisco.sensitivity.trajectory import Trajectory
from ngvisco.threads import computing

METHODS = ("tangent", "adjoint")


@dataclass(frozen=True)
class Gradient:
    """Numbers of a run and their derivatives by its parameters.

    Attributes
    ----------
    of, by : tuple of str
        Names of the numbers and of the parameters.
    values : array, (numbers,)
        Values in the units of the columns.
    jacobian : array, (numbers, parameters)
        Derivatives in the units of the columns divided by the units of the parameters.
    at : array, (parameters,)
        Values of the parameters.
    limited : int
        Number of cells limited in all steps; derivatives treat the limiter's change of a state as constant.
    seconds : float
        Processor time of the run itself, s.
    """

    of: tuple[str, ...]
    by: tuple[str, ...]
    values: np.ndarray
    jacobian: np.ndarray
    at: np.ndarray
    limited: int = 0
    seconds: float = 0.0
    simulation: Simulation | None = field(default=None, repr=False, compare=False)
    _of_start: np.ndarray | None = field(default=None, repr=False, compare=False)

    def __getitem__(self, key: tuple[str, str]) -> float:
        """Derivative of a number by a parameter, given by their names."""
        number, by = key
        return float(self.jacobian[self._row(number), self.by.index(by)])

    def density(self, of: str, name: str) -> GridFunction:
        """Derivative of a number by the start values of a scalar field, per volume at the start.

        A small change d of the field's start values changes the number by the integral of this function times
        d, with the start values of other fields fixed.  The density needs a gradient with the method
        "adjoint".

        Parameters
        ----------
        of : str
            Name of the number.
        name : str
            ``"density"``, or a scalar variable of the material: ``"J"``, or a ``Parameter``, which can make
            a modulus a field.

        Returns
        -------
        GridFunction
            Density in the unit of the number over the unit of the field, per m^d; of the order of the field.
        """
        if self._of_start is None or self.simulation is None:
            raise ParameterError("Gradient.density", of, "a gradient with method='adjoint'")
        step = self.simulation.rothe_step
        layout, slices = step.layout, step.layout.states.slices
        scalars = {name: part for name, part in slices.items() if part.stop - part.start == 1}
        blocks = {"density": "rho"} if "rho" in layout.ranges else {}
        require_known("scalar field", [name], (*blocks, *scalars))
        block = blocks.get(name, "z")
        variable = next((v for v in self.simulation.model.material.variables if v.name == name), None)
        if isinstance(variable, Parameter) and variable.mean != "arithmetic":
            expected = (
                "a parameter whose value itself is carried, such as nv.Parameter(..., mean='arithmetic'); "
                "with any other mean, a function of the value is carried"
            )
            raise ParameterError("Gradient.density", name, expected)
        result = GridFunction(layout.scalar_space(block))
        begin = layout.ranges[block].start + (scalars[name].start * len(result.vec) if name in scalars else 0)
        slope = result.vec.CreateVector()
        slope.FV().NumPy()[:] = self._of_start[self._row(of)][begin : begin + len(result.vec)]
        result.vec.data = inverse_mass(result.space, step.quadrature) * slope
        return result

    def _row(self, name: str) -> int:
        require_known("number", [name], self.of)
        return self.of.index(name)

    def __str__(self) -> str:
        """Table with a line for each number and a column for each parameter."""
        head = ["", "value", *(f"d/d {name}" for name in self.by)]
        body = [
            [name, f"{value:.8g}", *(f"{entry:.8g}" for entry in row)]
            for name, value, row in zip(self.of, self.values, self.jacobian, strict=True)
        ]
        widths = [max(len(line[i]) for line in (head, *body)) for i in range(len(head))]
        lines = ("  ".join(f"{x:>{w}}" for x, w in zip(line, widths, strict=True)) for line in (head, *body))
        return "\n".join(lines)


@computing()
def gradient(
    simulation: Simulation,
    until: float,
    *,
    of: Sequence[str] | Mapping[str, str | Misfit],
    by: Sequence[str] = (),
    method: str = "tangent",
    order: int = 4,
    progress: Callable[[int, int], None] | None = None,
    restart: AnyPath | None = None,
) -> Gradient:
    """Run a simulation until a time, and differentiate its results by parameters.

    The derivatives are exact for the numbers that this run computes with its mesh and its steps; they are not
    discretised derivatives of the continuous equations.  The lengths of adaptive steps, the limiter's change
    of a state and the sides of upwinding are constants in the derivatives.  The constant change of the
    limiter causes errors of 0.1 % in runs with three limited cells. Constant sides of upwinding cause no
    error, except where matter rests at a facet with a jump: there the result is between the two one-sided
    derivatives. The tangent also differentiates the separation of bodies by ``Discretisation.sharp``; the
    adjoint is refused for a run with this separation.

    Raises ParameterError or UnknownNameError for an unknown number or parameter; ParameterError for a run
    without derivatives, for instance with damage, relaxed steps or several ranks; StepError as
    ``Simulation.run``; and StopRequested after ``simulation.request_stop()``.

    Parameters
    ----------
    simulation : Simulation
        Simulation to run, with its observers.  If the simulation is at its start, the start values depend on
        the parameters; after ``restore`` the present state is fixed.
    until : float
        End of the run, s.
    of : sequence of str, or mapping of names to texts or to Misfit
        ``"COLUMN at TIME"``, or ``"COLUMN until TIME"`` for the integral over time, of a column of the ledger
        or of a table among the run's observers (``Probes``, ``Integrals``, ``WallForces``, ``Bodies``). The
        integral of an exchange in a step, such as ``bregman`` or ``impulse_gravity_1``, is the sum over the
        steps.  An extremum, as ``rho_min``, is differentiated at its point.  Columns without a derivative are
        refused: counts, residuals, lengths of steps, and a body's extents and width of the interface, which
        jump. A perimeter, an angle or a gap has kinks, e.g. where the length of a body is its breadth.
    by : sequence of str
        Paths of parameters, as ``"material.G_e"``, ``"creep.G_m"``, ``"loads.gravity.g.1"``,
        ``"initial.density"``; the adjoint also accepts none, for ``Gradient.density`` alone.
    method : str
        ``"tangent"``, whose cost grows with the number of parameters, or ``"adjoint"``, whose cost grows with
        the number of results.
    order : int
        Order of the differences by the parameters at fixed states: 4 gives derivatives right to 1e-9, 2 to
        1e-7 at half of the evaluations.
    progress : callable, optional
        Function that is called with the numbers of differentiated steps and of all steps.
    restart : path of a folder, optional
        Folder in which the run's steps and the state of the derivatives are kept, so that the same call
        continues after an interruption.  On one machine with one thread the results are then equal bit for
        bit.  ``Simulation.request_stop`` ends the call by StopRequested: the run stops between two
        iterations, the derivatives between two stages.  After a process died, up to ten steps of the run are
        repeated.  The folder has the states of all steps.  Raises CheckpointError for a damaged folder, or
        one that belongs to another run or request.

    Returns
    -------
    Gradient
    """
    require_type("gradient.simulation", simulation, Simulation)
    if method not in METHODS:
        raise ParameterError("method", method, " or ".join(map(repr, METHODS)))
    if order not in OFFSETS:
        raise ParameterError("order", order, "4 or 2")
    numbers = numbers_of(of, until, simulation)
    parameters = _parameters(by, simulation, method)
    base, is_start = follower_of(simulation, numbers.columns), simulation.number == 0
    if not is_start and any(parameter.is_of_start for parameter in parameters):
        raise ParameterError("by", by, "no start values, since the run has begun")
    if method == "adjoint" and simulation.bounds.sharpening is not None:
        expected = "'tangent' for a run with Discretisation.sharp, whose planes have no transposed derivative"
        raise ParameterError("method", method, expected)
    simulation.stop_requested = False
    slopes = Slopes(base) if method == "adjoint" else None
    request = {"of": of, "by": list(by), "until": until, "method": method, "order": order}
    trajectory, columns = Trajectory(simulation), base.columns  # raises if a run has no derivatives
    if restart is not None:
        trajectory.restart = Restart.at(restart, simulation, request)
    columns.has_ends = any(not n.is_integral or n.column in numbers.balances for n in numbers.wanted)
    columns.has_means = bool(columns.is_of_stages.any()) or any(n.is_integral for n in numbers.wanted)
    near = [Neighbours(parameter, simulation, columns, order) for parameter in parameters]
    trajectory.run(until)
    total = len(trajectory.steps)

    def tell(number: int) -> None:
        if progress is not None:
            progress(number, total)

    record, of_start = history(trajectory, base), None
    parts = numbers.parts(record)
    if slopes is None:
        derivatives = tangents(trajectory, base, near, is_start, tell)
        jacobian = numbers.coefficients(parts) @ numbers.parts(derivatives)
    else:
        adjoint = Adjoint(trajectory, base, slopes, near, *numbers.weights(record, columns))
        adjoint.run(is_start, tell)
        jacobian, of_start = adjoint.jacobian, adjoint.of_start
    at = np.array([parameter.value for parameter in parameters])
    names = tuple(numbers.names), tuple(parameter.name for parameter in parameters)
    values = numbers.values(parts)
    return Gradient(
        *names, values, jacobian, at, trajectory.limited, trajectory.seconds, simulation, of_start
    )


@computing()
def numbers_of(
    of: Sequence[str] | Mapping[str, str | Misfit], until: float, simulation: Simulation
) -> Numbers:
    """The numbers in the argument ``of`` of ``gradient``."""
    return Numbers.of(of, until, simulation.t, simulation.ledger.momentum.balances)


def follower_of(simulation: Simulation, names: Sequence[str]) -> Follower:
    """A follower with the run's parameters."""
    worker = varied(simulation, {})
    return Follower(worker, Columns(worker, names, tables_of(simulation)))


def _parameters(by: Sequence[str], simulation: Simulation, method: str) -> list[Named]:
    names = require_collection("by", by, 'names of parameters, e.g. ["material.G_e"]')
    if not (names or method == "adjoint") or len(set(names)) < len(names):
        least = "" if method == "adjoint" else "at least one parameter, and "
        raise ParameterError("by", by, f"{least}no parameter twice")
    return [Named.of(name, simulation, AT_FIXED_STATES if method == "adjoint" else STEP) for name in names]

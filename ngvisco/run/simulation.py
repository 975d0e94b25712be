"""The time loop: the only place that advances time.

Output, checkpoints, plots and progress are observers of the loop (``ngvisco.run.observers``).
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Protocol, cast

from ngsolve import Mesh

from ngvisco.errors import MeshError, ParameterError, StepError, as_number, as_numbers, require_type
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.start.data_checks import warn_of_corners
from ngvisco.forms.start.initial import Initial
from ngvisco.forms.system import Step
from ngvisco.forms.term import Term
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import distributed
from ngvisco.parallel.petsc import require_petsc
from ngvisco.physics.model import Model
from ngvisco.run.advice import warn_of_floors
from ngvisco.run.arguments import check_arguments, require_observers
from ngvisco.run.failure import failure_report
from ngvisco.run.files import AnyPath
from ngvisco.run.interruption import Interruption
from ngvisco.run.ledger import Ledger
from ngvisco.run.notebook import simulation_html
from ngvisco.run.ranks import ending_all_ranks, tell
from ngvisco.run.ringing import Ringing
from ngvisco.run.self_contact import SelfContact
from ngvisco.run.snapshot import take_up
from ngvisco.run.state import RunState
from ngvisco.run.stepping import Rejection, TimeSteps, time_steps
from ngvisco.solver.options import Method, NewtonOptions
from ngvisco.threads import computing

_STEPS = {field.name for field in fields(TimeSteps)}
"""Arguments of the class that are parameters of ``TimeSteps``."""


class Observer(Protocol):
    """An observer of a run.  The methods are called between steps, never within a step.

    A class that derives from ``Observer`` defines only the methods that it needs.

    On several ranks the methods are called on every rank.  An observer with the attribute ``on_first_rank =
    True``, such as a writer of the ledger, is called on the first rank only, and must evaluate no field.
    """

    def start(self, simulation: Simulation) -> None:
        """Called before the first step of a run; the initial row is ``simulation.ledger.rows[0]``."""
        return

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        """Called after each accepted step; ``row`` is the step's row of the ledger."""
        return

    def finish(self, simulation: Simulation) -> None:
        """Called after the last step, and when the run ends with an error."""
        return


class Simulation(RunState):
    """The run of a model on a mesh: its state, and the steps that advance the state in time.

    Raises ParameterError, MeshError, InitialDataError or UnknownNameError for bad input, before anything is
    computed; PETScError over ranks without PETSc.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Mesh in 2D (plane strain, or see ``symmetry``) or 3D; every boundary that is not periodic is a wall.
        If mpirun started several processes, the mesh of the first process is distributed over them
        (``simulation.mesh``).
    model : Model
    initial : Initial, optional
    walls : mapping of boundary names (or tuples of them) to Wall objects, optional
        Conditions at walls; default slip (v.n = 0 with a free tangential part).
    time : TimeSteps
        Scheme and step lengths.  Keyword arguments of ``TimeSteps`` may be given instead: ``dt=0.1,
        scheme="midpoint"`` is short for ``time=TimeSteps(dt=0.1, scheme="midpoint")``.
    discretisation : Discretisation, optional
    newton : NewtonOptions, optional
    solver : str, optional
        Method, ``"auto"``, ``"coupled"`` or ``"split"``: short for ``NewtonOptions(method=...)``.
    observers : sequence of Observer
    sources : Term, optional
        A further term without unknowns, for manufactured solutions.
    terms : sequence of Term
        Further terms of the system, e.g. a drag: ``PointTerm`` objects with ``cells(u, w)``, ``facets(u, w)``
        and ``entries(u)`` (``ngvisco.forms.term``), whose entries are columns of the ledger.  ``PointTerm``
        objects act in both solvers.  The split solver refuses a term that has only ``form(u, w)``, unless
        all rows of this term are rows of the flow.
    passive : sequence of str
        Fields carried by the flow: ``"F_tot"``, ``"reference_map"``, ``"creep_strain"``.
    symmetry : str
        With ``"axisymmetric"`` a mesh of two dimensions is the half plane r = x >= 0 of a body of revolution
        about x = 0 that does not swirl; integrals, such as energies, masses and forces, are the body's over
        2 pi.  With ``"none"`` two dimensions mean plane strain.
    """

    @computing()
    @ending_all_ranks()
    def __init__(
        self,
        mesh: Mesh,
        model: Model,
        *,
        time: TimeSteps | None = None,
        initial: Initial | None = None,
        walls: Conditions | None = None,
        discretisation: Discretisation | None = None,
        newton: NewtonOptions | None = None,
        solver: str | None = None,
        observers: Sequence[Observer] = (),
        sources: Term | None = None,
        terms: Sequence[Term] = (),
        passive: Sequence[str] = (),
        symmetry: str = "none",
        **steps: Any,
    ) -> None:
        initial = Initial() if initial is None else initial
        newton = NewtonOptions() if newton is None else newton
        discretisation = Discretisation() if discretisation is None else discretisation
        for name, value, kind in (
            *(("mesh", mesh, Mesh), ("model", model, Model), ("initial", initial, Initial)),
            *(("discretisation", discretisation, Discretisation), ("newton", newton, NewtonOptions)),
        ):
            require_type(f"Simulation.{name}", value, kind)
        time = time_steps(time, steps, [*inspect.signature(Simulation).parameters][:-1])  # without **steps
        check_arguments(observers, walls, passive, sources, terms)
        if model.heat is not None and model.heat.numerical_heating and time.made.A != ((1.0,),):
            expected = (
                f" for {time.made.name!r}, since only backward Euler has a known dissipation at each point"
            )
            raise ParameterError("Heat.numerical_heating", True, False, expected)
        ranks = Communicator.world() if mesh.comm.size == 1 else Communicator.of(mesh)
        require_petsc(ranks)
        mesh = distributed(mesh, ranks) if mesh.comm.size == 1 else mesh
        self.arguments: dict[str, Any] = dict(time=time, initial=initial, walls=walls, solver=solver)
        """Arguments of the simulation other than mesh, model and observers."""
        self.arguments |= dict(discretisation=discretisation, newton=newton, passive=passive)
        self.arguments |= dict(sources=sources, terms=terms, symmetry=symmetry)
        options = newton if solver is None else replace(newton, method=cast(Method, solver))
        model = model.at_order(discretisation.m)
        step = Step(mesh, model, discretisation, sources, walls, terms, symmetry)
        super().__init__(step, time, initial, options, passive)
        self.observers = list(observers)
        self.interruption = Interruption(self)
        self.set_time(0.0, 0)
        kept = {"mesh", "model", "t", "number", *self.arguments, *_STEPS}
        self._kept = kept - {"velocity_scale"}  # which a resumed run sets

    def __setattr__(self, name: str, value: object) -> None:
        if name in vars(self).get("_kept", ()):  # the run would not read the value
            expected = "no change of a run; make another by Simulation.on, or set its state by nv.transfer"
            raise ParameterError(f"Simulation.{name}", value, expected)
        super().__setattr__(name, value)

    def on(self, mesh: Mesh, **changes: Any) -> Simulation:
        """A new simulation at its start, on another mesh or with other arguments of the class.

        ``changes`` may have parameters of ``TimeSteps``, such as ``dt``; the others stay.  ``nv.transfer``
        carries the present state over to the new simulation.
        """
        arguments = {"model": self.model, **self.arguments, "observers": self.observers}
        if "time" not in changes and (steps := {n: changes.pop(n) for n in _STEPS & changes.keys()}):
            changes["time"] = replace(self.arguments["time"], **steps)
        return Simulation(mesh, **arguments | changes)

    def _repr_html_(self) -> str:
        steps = "adaptive steps" if self.is_adaptive else f"steps of {self.dt:g} s"
        time = f"t = {self.t:g} s, step {self.step_number}, {steps}"
        return simulation_html(self.rothe_step, time) + self.ledger._repr_html_()

    @computing()
    @ending_all_ranks()
    def restore(
        self, path: AnyPath, step: int | None = None, attributes: Mapping[str, str] | None = None
    ) -> None:
        """Go on from a checkpoint in a run's HDF5 file, by default its last one.

        The file's ``attributes`` must have the given values (see ``Checkpoints``).  Raises CheckpointError if
        the file is missing or damaged, has no such checkpoint, or belongs to another mesh, discretisation or
        material; the message says which.
        """
        checkpoint, rows, limits = take_up(self, path, step, attributes)
        self.rothe_step.state_old.vec.data = self.rothe_step.state.vec
        self.rothe_step.start_from_old()
        numbers, _ = checkpoint.part("")
        self.set_time(numbers["time"], int(numbers["step"]))
        self.set_velocity_scale(numbers["velocity_scale"])
        self.wave_speed = numbers.get("wave_speed", self.wave_speed)
        self.solver.load_state_dict(*checkpoint.part("solver"))
        self.stepper.load_state_dict(self, *checkpoint.part("stepping"))
        self.ledger.resume(checkpoint.balance, rows, limits)

    def set_time(self, t: float, number: int) -> None:
        """Set the number and the time ``t`` (s) of a new present state, as a restart or a transfer does.

        Data of earlier steps that the solver and the warnings use are discarded.
        """
        super().set_time(t, number)
        self.solver.reset()
        parts = self.rothe_step, self.ranks
        self.self_contact, self.ringing = SelfContact(*parts), Ringing(*parts)

    def advance(self, stop: float = math.inf) -> dict[str, float]:
        """Take one step and return its row of the ledger; adaptive steps end at ``stop`` (s) at the latest.

        Raises StepError if the step cannot be solved, or rho, J, ... are not positive (see ``limiter``); with
        adaptive lengths only if the shortest step fails.  The state is then the one before the step, and the
        error's ``report`` says where and why the step failed.
        """
        if self.mesh.ne != self._cells_here:
            message = f"the mesh has {self.mesh.ne} cells, but had {self._cells_here} when the run was made"
            message = f"{message}; make another run on the refined mesh, and move the state by nv.transfer"
            raise MeshError(message)
        if stop != math.inf and ((end := as_number(stop)) is None or end <= self.t):
            raise ParameterError("advance.stop", stop, f"a number > {self.t:g}")
        with computing(), self.solver.workers(), ending_all_ranks():
            self._start_ledger()
            self.interruption.begin()
            self.bounds.refused = self.bounds.parted = None
            try:
                step, number = self.stepper.advance(self, stop, self.notify_rejection), self.number + 1
            except StepError as error:
                error.report = failure_report(self, error)
                raise
            try:
                row = self.ledger.record(number, step.time, step.taken, step.rejections, step.error)
            # even after an interrupt, or a warning raised as an error, each step has a row
            except BaseException as error:
                self.integrator.undo()
                if isinstance(error, StepError):
                    error.report = failure_report(self, error)
                raise
            self.integrator.accept()
            self.solver.accept()
            super().set_time(step.time, number)
            self.ledger.check_closure()
            self.tension(self.t)
            self.self_contact(self.t, row["cfl"])
            self.ringing(self.t, self.solver.options.tolerance * self.velocity_scale)
            return row

    @ending_all_ranks()
    def run(self, until: float, stops: Sequence[float] = ()) -> Ledger:
        """Step until ``until`` (s) or until ``request_stop`` is called; returns the ledger.

        Raises StepError as ``advance``; observers are finished first.

        Parameters
        ----------
        until : float
            End of the run; for steps of one length a multiple of dt, up to rounding.
        stops : sequence of float
            Further times that the steps meet exactly, s; for steps of one length multiples of dt.
        """
        end = as_number(until)
        if end is None or end < self.t:
            raise ParameterError("until", until, f"a finite number >= {self.t:g}")
        until, stops = end, as_numbers("stops", stops, "a sequence of finite numbers, in s")
        require_observers(self.observers)
        self.check_data(until)
        warn_of_corners(self.rothe_step, self._looked_at(until))
        for name, value in [("until", until), *(("stops", stop) for stop in stops)]:
            self.stepper.check(name, value)
        targets = sorted({*(stop for stop in stops if self.t < stop < until), until})
        self.stop_requested = False
        with computing():
            self._start_ledger()
            failure = self._observed(targets)
            for observer in self.observers:
                try:
                    tell(self.ranks, observer, observer.finish, self)
                # an error of one observer must not keep the others from finishing their files
                except Exception as error:
                    failure = failure or error
        if failure is not None:
            raise failure
        warn_of_floors(self)
        return self.ledger

    def request_stop(self) -> None:
        """Let ``run`` give up its present step and end; observers are finished."""
        self.stop_requested = True

    def notify_rejection(self, rejection: Rejection) -> None:
        """Tell observers with a method ``rejected`` of a rejected step; the state is then the one before the
        step."""
        for observer in self.observers:
            if (rejected := getattr(observer, "rejected", None)) is not None:
                tell(self.ranks, observer, rejected, self, rejection)

    def _observed(self, targets: Sequence[float]) -> BaseException | None:
        try:
            for observer in self.observers:
                tell(self.ranks, observer, observer.start, self)
            for target in targets:
                while not (self.stepper.reached(self, target) or self._is_to_stop()):
                    row = self.advance(target)
                    for observer in self.observers:
                        tell(self.ranks, observer, observer.step, self, row)
        except BaseException as error:
            return self.interruption.ended(error)
        return None

    def _is_to_stop(self) -> bool:
        """Whether some rank was asked to stop, as by a signal; all ranks then have the request."""
        self.stop_requested = self.ranks.any(self.stop_requested)
        return self.stop_requested

    def _start_ledger(self) -> None:
        if not self.ledger.rows and self.ledger.balance is None:
            self.ledger.start(self.t)

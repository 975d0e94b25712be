"""Runs of cases in their directories: from the start, from another run, from a checkpoint; what they hold."""

from __future__ import annotations

import contextlib
import os
import time as clock
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.case import changes
from ngvisco.case.build import Case
from ngvisco.case.directory import RunDirectory, RunDirectoryError
from ngvisco.case.faults import in_case
from ngvisco.errors import CheckpointError, StepError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import distributed
from ngvisco.parallel.petsc import require_petsc
from ngvisco.run.checkpoint import read_ledger
from ngvisco.run.failure import write_failure
from ngvisco.run.files import append
from ngvisco.run.meshfile import mesh_image, mesh_of
from ngvisco.run.notebook import data_frame, results_html
from ngvisco.run.observers import Progress
from ngvisco.run.refinement import stretches
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.run.transfer import resume_changed, transfer


@dataclass(frozen=True)
class Origin:
    """The state of an earlier run that a new one starts from."""

    directory: Path
    step: int

    @classmethod
    def last_of(cls, directory: str | os.PathLike[str]) -> Origin:
        """The last state of a run directory."""
        return cls(Path(directory).resolve(), load(directory).simulation.number)

    @property
    def record(self) -> dict[str, Any]:
        """As versions.json has it."""
        return {"directory": str(self.directory), "step": self.step}

    def carry_to(self, simulation: Simulation) -> str:
        """Put a simulation into this state; a line for the log of what that did."""
        done = transfer(load(self.directory, self.step).simulation, simulation)
        return (
            f"from step {self.step} of {self.directory}, t = {simulation.t:g} s: density times "
            f"1 {done.scaled - 1:+.2e}, energy lost {done.lost:.6e} J of {done.energy_before:.6e} J"
        )


def run(
    case: Case,
    directory: str | os.PathLike[str],
    *,
    force: bool = False,
    observers: Sequence[Observer] = (),
    source: str | os.PathLike[str] | None = None,
) -> Simulation:
    """Run a case into a new run directory.  Raises RunDirectoryError, CaseError, StepError, OSError.

    Parameters
    ----------
    force : bool
        Remove the results of an earlier run first, rather than refuse.
    observers : sequence of Observer
        Besides those that write the directory.
    source : path, optional
        A run directory whose last state is taken over in place of the case's initial one, time included
        (``ngvisco.run.transfer``).
    """
    place, ranks = RunDirectory(directory), Communicator.world()
    require_petsc(ranks)
    if not force:
        ranks.on_first(place.refuse_results)
    # all that can be wrong with the case is found here, before anything is written or removed
    notes, image = [f"run: {case.sections.title or case.source}"], b""
    with noting_warnings(notes.append):

        def whole() -> Mesh:
            nonlocal image
            image = mesh_image(case.mesh())
            return mesh_of(image)

        simulation = case.simulation(_mesh_of_first(case, ranks, whole))
    origin = None if source is None else Origin.last_of(source)
    if origin is not None:
        notes.append(origin.carry_to(simulation))
        _check_times(place, case, simulation, case.until)
        if simulation.t >= case.until * (1 - 1e-12):
            raise _reached(place, simulation)

    def begin() -> None:
        if not force:
            place.refuse_results()
        place.clear()
        place.prepare(case, image, None if origin is None else origin.record)

    with ranks.held_by_first(place.locked()):
        ranks.on_first(begin)
        start = simulation.t
        try:
            return _go(place, case, simulation, None, observers, notes)
        except StepError as error:
            if error.report is not None and error.report.time == start:
                ranks.on_first(place.keep_failure)
            raise


def resume(
    directory: str | os.PathLike[str],
    until: float | None = None,
    *,
    observers: Sequence[Observer] = (),
    settings: Sequence[str] = (),
) -> Simulation:
    """Go on with the run in a directory, from its last checkpoint (or its start, if it has none).

    ``until`` (s) replaces the case's end time.  ``settings`` change the case from here on
    (``ngvisco.case.changes`` says what may change); the directory keeps the case as it was too.
    """
    place, ranks = RunDirectory(directory), Communicator.world()
    require_petsc(ranks)
    case = place.case()

    def prepare() -> None:
        if not place.is_prepared:  # killed while it was
            place.prepare(case, mesh_image(case.mesh()))

    with ranks.held_by_first(place.locked()):
        ranks.on_first(prepare)
        if settings:
            new = changes.changed(place, case, settings)
            if new.resolved != case.resolved:
                simulation = new.simulation(_mesh_of_first(new, ranks, place.present_mesh))
                changes.check_change(place, case, simulation)  # before anything is written
                _check_times(place, new, simulation, new.until if until is None else until)
                ranks.on_first(lambda: changes.write_change(place, case, new, settings))
                case = place.case()
        notes = [f"resume: {case.sections.title or case.source}"]
        with noting_warnings(notes.append):
            simulation = case.simulation(_mesh_of_first(case, ranks, place.present_mesh))
        return _go(place, case, simulation, until, observers, notes)


def _go(
    place: RunDirectory,
    case: Case,
    simulation: Simulation,
    until: float | None,
    observers: Sequence[Observer],
    notes: list[str],
) -> Simulation:
    end, ranks = case.until if until is None else until, simulation.ranks
    if ranks.on_first(place.run_file.exists):
        before = ranks.on_first(lambda: changes.pending_change(place, case))
        if before is None:
            simulation.restore(place.run_file, attributes={"case": case.hash})
        else:
            resume_changed(simulation, place.run_file, {"case": before})
            notes.append(f"changed: {', '.join(place.read_versions()['changes'][-1]['settings'])}")
    elif not simulation.ledger.rows and (found := place.read_versions().get("from")) is not None:
        notes.append(Origin(Path(found["directory"]), found["step"]).carry_to(simulation))
    _check_times(place, case, simulation, end)
    log = Log(place.log_file, end, case.sections.output.log_every)
    # an end time given to resume is an output time of its own
    simulation.observers += [*case.observers(place.path, end), log, *observers]
    if ranks.is_distributed:
        notes.append(f"on {ranks.size} ranks, {ranks.size - 1} of them with cells")
    if simulation.number:
        notes.append(f"from the checkpoint of step {simulation.number}, t = {simulation.t:g} s")

    def begin() -> None:
        for path in place.failures:  # of an attempt before
            path.unlink()
        for note in notes:
            log.write(note)

    ranks.on_first(begin)
    write = log.write if ranks.is_first else (lambda line: None)
    try:
        with noting_warnings(write):
            for simulation, stop in _stretches(place, case, simulation, max(end, simulation.t)):  # noqa: B020
                simulation.run(stop, [time for time in case.output_times(end) if time <= stop])
    except BaseException as error:
        with contextlib.suppress(OSError):  # a full disk is what may have ended the run
            write(f"ended by {type(error).__name__}: {error}")
        if isinstance(error, StepError) and error.report is not None:
            with contextlib.suppress(OSError):
                fields = write_failure(place.failure_file, place.failed_state, simulation, error.report)
                error.add_note(f"what is known of it: {place.failure_file}; its fields: {fields}")
        raise
    if simulation.stop_requested:
        write(f"stopped on request at step {simulation.step_number}, t = {simulation.t:g} s")
    if simulation.closure_check.failures:
        write(simulation.closure_check.message)
    return simulation


def _stretches(
    place: RunDirectory, case: Case, simulation: Simulation, end: float
) -> Iterator[tuple[Simulation, float]]:
    """The run on each of its meshes, and until when, s."""
    if case.refinement is None:
        return iter([(simulation, end)])
    return stretches(simulation, case.refinement, end, place.mesh(), place.chosen_mesh())


def _mesh_of_first(case: Case, ranks: Communicator, make: Callable[[], Mesh]) -> Mesh:
    """The mesh that the first rank makes, distributed; its error is raised on every rank."""
    made: list[Mesh] = []
    ranks.on_first(lambda: made.append(make()))
    with case.blame.located("domain"):
        return distributed(made[0] if made else None, ranks)


def _check_times(place: RunDirectory, case: Case, simulation: Simulation, end: float) -> None:
    """Raise RunDirectoryError or ParameterError for times that the simulation's steps do not meet."""
    if simulation.t > end * (1 + 1e-12):
        raise _reached(place, simulation)
    for name, value in [("until", end), *(("stops", stop) for stop in case.output_times(end))]:
        simulation.stepper.check(name, value)


def _reached(place: RunDirectory, simulation: Simulation) -> RunDirectoryError:
    message = f"the run has already reached t = {simulation.t:g} s: expected an end time above that"
    return RunDirectoryError(f"{place.path}: {message}")


@dataclass(frozen=True)
class Results:
    """What a run directory holds.

    Attributes
    ----------
    case : Case
    ledger : dict of arrays, by column
    simulation : Simulation
        At the checkpoint's state.
    """

    case: Case
    ledger: dict[str, np.ndarray]
    simulation: Simulation

    def frame(self) -> Any:
        """The ledger as a pandas frame, with the step as index; NotebookError where pandas is missing."""
        return data_frame(self.ledger)

    def _repr_html_(self) -> str:
        return results_html(self.case.sections.title, self.time, self.ledger)

    @property
    def mesh(self) -> Mesh:
        return self.simulation.mesh

    @property
    def time(self) -> float:
        """Time of the state, s."""
        return self.simulation.t

    @property
    def fields(self) -> dict[str, CoefficientFunction]:
        """``simulation.fields``: velocity and density as grid functions, what is derived from them."""
        return self.simulation.fields


def load(directory: str | os.PathLike[str], step: int | None = None) -> Results:
    """The ledger and the state of the last (or a given) checkpoint of a run directory.

    Raises RunDirectoryError, CaseError, CheckpointError or MeshError.
    """
    place = RunDirectory(directory)
    case = place.case()
    if not place.run_file.exists():
        raise CheckpointError(f"{place.path}: no run.h5: the run ended before its first state was written")
    simulation = case.simulation(place.present_mesh())
    simulation.restore(place.run_file, step, attributes={"case": case.hash})
    return Results(case, read_ledger(place.run_file), simulation)


class Log(Progress):
    """Progress lines with the date, appended to a run's log file."""

    def __init__(self, path: Path, until: float, every: int = 1) -> None:
        super().__init__(until, every)
        self.path = path

    def write(self, line: str) -> None:
        """Append a line."""
        stamp = clock.strftime("%Y-%m-%d %H:%M:%S")
        append(self.path, f"{stamp}  {line}\n")

    def _print(self, line: str) -> None:
        self.write(line)


@contextlib.contextmanager
def noting_warnings(note: Callable[[str], None]) -> Iterator[None]:
    """Within: warnings are given to ``note`` too, each as a line."""
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        note(f"{category.__name__}: {in_case(str(message))}")
        shown(message, category, *where, **options)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield

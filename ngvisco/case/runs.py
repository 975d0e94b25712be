"""Runs of cases in their directories, from the start, another run or a checkpoint, and their results.

A run may be resumed with a changed case.  case.toml in the directory is then the changed case; the earlier
case is kept as ``case.until-step-N.toml``, and versions.json lists the changes with step, time and settings.
Until the first checkpoint after a change, run.h5 has the hash of the earlier case, so that an interrupted
change can be completed.
"""

from __future__ import annotations

import contextlib
import os
import re
import time as clock
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.case.build import Case, parse_case
from ngvisco.case.directory import RunDirectory
from ngvisco.case.faults import CaseError, in_case
from ngvisco.case.section import given
from ngvisco.case.toml import parse_override
from ngvisco.errors import CheckpointError, NgviscoError, ParameterError, StepError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import distributed
from ngvisco.parallel.petsc import require_petsc
from ngvisco.run.failure import write_failure
from ngvisco.run.files import append, mesh_image, mesh_of, write_atomically
from ngvisco.run.notebook import data_frame, results_html
from ngvisco.run.observers import Progress
from ngvisco.run.refinement import stretches
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.run.snapshot import read_ledger
from ngvisco.run.transfer import resume_changed, transfer

_CHANGEABLE = "title, time, loads, walls, numbers of material and rheology, solver, output except passive"
"""Keys that ``--set`` may change in a resumed run."""
_KINDS = re.compile(r"domain\.geometry|(bodies\.\d+\.)?material\.kind")
"""Keys that cannot change in a resumed run, and on which the names of other keys depend."""


def run(
    case: Case,
    directory: str | os.PathLike[str],
    *,
    force: bool = False,
    observers: Sequence[Observer] = (),
    source: str | os.PathLike[str] | None = None,
) -> Simulation:
    """Run a case in a new run directory.  Raises RunDirectoryError, CaseError, StepError or OSError.

    Parameters
    ----------
    force : bool
        Whether to remove the results of an earlier run first; otherwise they are an error.
    observers : sequence of Observer
        Observers in addition to those that write the files of the directory.
    source : path, optional
        A run directory whose last state, with its time, replaces the case's initial state
        (``ngvisco.run.transfer``).
    """
    place, ranks = RunDirectory(directory), Communicator.world()
    require_petsc(ranks)
    if not force:
        ranks.on_first(place.refuse_results)
    # every fault of the case is found here, before anything is written or removed
    notes = [f"run: {case.sections.title or case.source}"]
    with _noting_warnings(notes.append):
        images: list[bytes] = []  # on the first rank
        ranks.on_first(lambda: images.append(mesh_image(case.mesh())))
        simulation = case.simulation(_mesh_of_first(case, ranks, lambda: mesh_of(images[0])))
    origin: dict[str, Any] | None = None
    if source is not None:
        try:
            state = load(source).simulation
        except NgviscoError as error:
            error.key = "source"  # the directory from which the run starts is at fault
            raise
        origin = {"directory": str(Path(source).resolve()), "step": state.number}
        notes.append(_taken_over(state, origin, simulation))
    _check_times(case, simulation, is_new=True)

    def begin() -> None:
        if not force:
            place.refuse_results()
        place.clear()
        place.prepare(case, images[0], origin)

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
    """Resume the run in a directory from its last checkpoint, or from its start if it has taken no step.

    Raises RunDirectoryError for a directory with steps but without ``run.h5``.

    ``until`` (s) replaces the case's end time; steps of one length end at the nearest multiple of dt if it is
    within a thousandth of dt.  ``settings`` change the case from now on, within the limits of ``changed``;
    the directory also keeps the earlier case.
    """
    place, ranks = RunDirectory(directory), Communicator.world()
    require_petsc(ranks)
    case = place.case()

    def prepare() -> None:
        place.require_checkpoints()
        # this file is written last: without it, the run was killed before the directory was complete
        if not place.versions_file.exists():
            place.prepare(case, mesh_image(case.mesh()))

    with ranks.held_by_first(place.locked()):
        ranks.on_first(prepare)
        new = changed(place, case, settings) if settings else case
        notes = [f"resume: {new.sections.title or new.source}"]
        with _noting_warnings(notes.append):
            run = new.simulation(_mesh_of_first(new, ranks, place.present_mesh))
            # a change without a checkpoint is replaced
            before = ranks.on_first(lambda: _pending_change(place, case)) or case.hash
            notes += _go_on(place, new, run, before)
        if new.resolved != case.resolved:
            _check_times(new, run, until)  # errors come before anything is written
            of_run = {"step": run.number, "time": run.t, "settings": list(settings)}
            change = of_run | {"from": before, "to": new.hash}
            ranks.on_first(lambda: _write_change(place, case, new, change))
        if before != new.hash:
            notes.append(f"changed: {', '.join(place.read_versions()['changes'][-1]['settings'])}")
        return _go(place, new, run, until, observers, notes)


def _go(
    place: RunDirectory,
    case: Case,
    simulation: Simulation,
    until: float | None,
    observers: Sequence[Observer],
    notes: list[str],
) -> Simulation:
    ranks, end = simulation.ranks, case.until if until is None else until
    if (met := simulation.stepper.met(end)) != end:
        notes.append(f"the run ends at {met:.10g} s, the end of a step nearest to {end:.10g} s")
        end = met
    for observer in observers:
        if isinstance(observer, Progress):
            observer.until = end
    _check_times(case, simulation, until)
    log = Log(place.log_file, end, case.sections.output.log_every)
    # an end time given to ``resume`` is an output time too
    times = case.output_times(end, simulation.stepper.origin)
    simulation.observers += [*case.observers(place.path, times), log, *observers]
    if ranks.is_distributed:
        notes.append(f"the run has {ranks.size} ranks, {ranks.size - 1} of them with cells")
    if simulation.number:
        notes.append(
            f"the run goes on from the checkpoint of step {simulation.number}, t = {simulation.t:g} s"
        )

    def begin() -> None:
        for path in place.failures:  # reports of an earlier attempt
            path.unlink()
        for note in notes:
            log.write(note)

    ranks.on_first(begin)
    write = log.write if ranks.is_first else (lambda line: None)
    parts: Iterator[tuple[Simulation, float]] = iter([(simulation, max(end, simulation.t))])
    if case.refinement is not None:  # one part, with its end time, for each mesh
        last = max(end, simulation.t)
        parts = stretches(simulation, case.refinement, last, place.mesh(), place.chosen_mesh())
    try:
        with _noting_warnings(write):
            for simulation, stop in parts:
                simulation.run(stop, times)
    except BaseException as error:
        with contextlib.suppress(OSError):  # a full disk may have ended the run
            name = "" if isinstance(error, NgviscoError) else f"{type(error).__name__}: "
            write(f"ended: {name}{in_case(error)}")
        if isinstance(error, StepError) and error.report is not None:
            with contextlib.suppress(OSError):
                fields = write_failure(place.failure_file, place.failed_state, simulation, error.report)
                error.add_note(f"report of the failure: {place.failure_file}; its fields: {fields}")
        raise
    if simulation.stop_requested:
        write(f"stopped on request at step {simulation.step_number}, t = {simulation.t:g} s")
    if message := simulation.ledger.unclosed:
        write(message)
    return simulation


def _go_on(place: RunDirectory, case: Case, simulation: Simulation, before: str) -> list[str]:
    """Set a simulation to the state from which the run in a directory goes on; return lines for the log.

    ``before`` is the hash of the case of the run's checkpoints.
    """
    if simulation.ranks.on_first(place.run_file.exists):
        restore = Simulation.restore if before == case.hash else resume_changed
        restore(simulation, place.run_file, attributes={"case": before})
    elif (origin := place.read_versions().get("from")) is not None:
        return [_taken_over(load(origin["directory"], origin["step"]).simulation, origin, simulation)]
    return []


def _taken_over(old: Simulation, origin: dict[str, Any], simulation: Simulation) -> str:
    """Set a simulation to the state of another one, and return a line about it for the log."""
    done = transfer(old, simulation)
    return (
        f"the run starts from step {origin['step']} of {origin['directory']}, t = {simulation.t:g} s; the "
        f"transfer scaled the density by 1 {done.scaled - 1:+.2e} and lost {done.lost:.6e} J of "
        f"{done.energy_before:.6e} J"
    )


def _mesh_of_first(case: Case, ranks: Communicator, make: Callable[[], Mesh]) -> Mesh:
    """The distributed mesh, which the first rank makes; an error of ``make`` is raised on every rank."""
    meshes: list[Mesh] = []
    ranks.on_first(lambda: meshes.append(make()))
    with case.locator.located("domain"):
        return distributed(meshes[0] if meshes else None, ranks)


def _check_times(case: Case, run: Simulation, until: float | None = None, *, is_new: bool = False) -> None:
    """Raise ParameterError for an end time at which no step ends, or which the run has already passed.

    If ``until`` is None, the end time is the case's, and the error is a CaseError.  A new run must end later
    than it starts.  The case's end time is checked even if ``until`` is given, so that the run can later be
    resumed without ``until``.
    """
    end = case.until if until is None else run.stepper.met(until)
    with contextlib.nullcontext() if until is not None else case.locator.located("time"):
        if run.t > end * (1 + 1e-12) or (is_new and run.t >= end * (1 - 1e-12)):
            expected = f"a time after t = {run.t:g} s, which the run has already reached"
            raise ParameterError("until", end, expected)
        run.stepper.check("until", end)
    case.check_end(run)


def changed(place: RunDirectory, case: Case, settings: Sequence[str]) -> Case:
    """The directory's case with settings; raises CaseError for the key of a setting that may not change."""
    message = (
        f"this key cannot change when a run goes on (keys that can: {_CHANGEABLE}); start a new run "
        f"from the fields of this run: ngvisco run CASE -o NEW --from {place.path}"
    )
    try:
        new = parse_case(case.resolved, case.source, case.directory, settings)
    except CaseError:  # a section of another kind has other keys; the error names the key of the kind
        for setting in (text for text in settings if "=" in text):
            path, value = parse_override(setting)
            if _KINDS.fullmatch(".".join(path)) and value != given(case.sections, path):
                raise replace(case.locator, overridden=[path]).error(path, message) from None
        raise
    before, after = _fixed(case), _fixed(new)
    for key, value in before.items():
        if after[key] != value:
            where = tuple(key.split("."))
            set_there = [path for path in new.locator.overridden if path[: len(where)] == where]
            raise new.locator.error((set_there or [where])[0], message)
    return new


def _fixed(case: Case) -> dict[str, Any]:
    """The values that a resumed run cannot change, by key. Bodies can change only numbers of materials and
    mechanisms.

    Another mesh or other unknowns need a new run, which takes over the fields of this run.
    """
    data = case.sections.model_dump()
    kept, mechanisms = ("name", "where", "density", "order"), ("viscosity", "creep")
    bodies = [
        {name: body[name] for name in kept}
        | {"kind": body["material"]["kind"], "has heat": body["material"]["thermal"] is not None}
        | {name: body[name] is not None for name in mechanisms}
        for body in data["bodies"]
    ]
    material = data["material"] or {"kind": None, "thermal": None}
    return {
        **{name: data[name] for name in ("domain", "initial", "discretisation")},
        "bodies": bodies,
        "material.kind": material["kind"],
        "material.thermal": material["thermal"] is not None,
        "output.passive": data["output"]["passive"],
    }


def _write_change(place: RunDirectory, case: Case, new: Case, change: dict[str, Any]) -> None:
    """Write the changed case and a record of the ``change`` into the directory, and keep the earlier case."""
    record = place.read_versions()
    record["changes"] = [*record.get("changes", []), change]
    write_atomically(place.path / f"case.until-step-{change['step']}.toml", case.resolved.encode())
    place.write_versions(record)
    write_atomically(place.case_file, new.resolved.encode())


def _pending_change(place: RunDirectory, case: Case) -> str | None:
    """The hash of run.h5's case if no checkpoint has followed the last change of the case; else None."""
    changes = place.read_versions().get("changes", [])
    before = {change["from"] for change in changes if change["to"] == case.hash != change["from"]}
    try:
        with h5py.File(place.run_file) as file:
            digest = file.attrs.get("case")
    except OSError:  # the next reader raises the error
        return None
    return str(digest) if digest in before else None


@dataclass(frozen=True)
class Results:
    """The contents of a run directory.

    Attributes
    ----------
    case : Case
    ledger : dict of arrays, by column
    simulation : Simulation
        The simulation at the checkpoint's state.
    """

    case: Case
    ledger: dict[str, np.ndarray]
    simulation: Simulation

    def frame(self) -> Any:
        """The ledger as a pandas frame, with the step as index; raises NotebookError without pandas."""
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
        """The fields of the simulation by name: velocity, density and derived fields."""
        return self.simulation.fields


def load(directory: str | os.PathLike[str], step: int | None = None) -> Results:
    """The ledger of a run directory, and its state at the last checkpoint, or at the checkpoint of ``step``.

    Raises RunDirectoryError, CaseError, CheckpointError or MeshError.
    """
    place = RunDirectory(directory)
    case = place.case()
    if not place.run_file.exists():
        raise CheckpointError(
            f"{place.path}: run.h5 is missing, since the run has not written its first state, or the file "
            "was moved away"
        )
    simulation = case.simulation(place.present_mesh())
    simulation.restore(place.run_file, step, attributes={"case": case.hash})
    return Results(case, read_ledger(place.run_file), simulation)


class Log(Progress):
    """Observer that appends dated progress lines to a run's log file."""

    def __init__(self, path: Path, until: float, every: int = 1) -> None:
        super().__init__(until, every)
        self.path = path

    def write(self, line: str) -> None:
        """Append a line."""
        append(self.path, f"{clock.strftime('%Y-%m-%d %H:%M:%S')}  {line}\n")

    _print = write


@contextlib.contextmanager
def _noting_warnings(note: Callable[[str], None]) -> Iterator[None]:
    """Context in which ``note`` also receives each warning, as a line of text."""
    shown = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **options: Any) -> None:
        note(f"{category.__name__}: {in_case(message)}")
        shown(message, category, *where, **options)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield

"""A run directory: everything that a run needs to be understood, resumed and read.

| file          | holds                                                                     |
|---------------|---------------------------------------------------------------------------|
| case.toml     | the case as resolved: every default written out                           |
| versions.json | versions, commit, machine, the mesh file's hash                           |
| mesh.vol      | the mesh; every run uses the one read back from this file                 |
| ledger.csv    | the energy ledger, a row a step                                           |
| run.h5        | ledger and checkpoints (ngvisco.run.checkpoint)                           |
| vtk/          | the VTK series                                                            |
| shapes/       | the files of bodies' shapes, under their content's hashes                  |
| bodies.csv    | mass, centroid, energies, ... of each body, a row a step                   |
| samples/      | probes, lines, forces on walls, integrals over the domain, as CSV         |
| log.txt       | what was done when                                                        |
| failed.txt    | of a run that ended at a step: where and why, and what to change; of one  |
|               | that ended at its first step this and failed.vtu are all that stays       |
| failed.vtu    | the solution that was refused there, else the last state (ranks: .pvtu)   |
| lock          | there while a process runs; released by the system even when it is killed |

The whole case is built before the directory is touched, so that a case that is refused leaves nothing
behind and removes nothing.  The first three files are complete before the first step.  A resumed run reads
them, never the user's case.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.case import changes
from ngvisco.case.build import Case, load_case
from ngvisco.case.log import Log, noting_warnings
from ngvisco.case.meshfile import mesh_image, mesh_in, mesh_of, require_whole
from ngvisco.case.versions import versions
from ngvisco.errors import CheckpointError, MeshError, NgviscoError, StepError, require_path
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.mesh import distributed
from ngvisco.parallel.petsc import require_petsc
from ngvisco.run.checkpoint import read_ledger
from ngvisco.run.failure import write_failure
from ngvisco.run.files import locks, write_atomically
from ngvisco.run.notebook import data_frame, results_html
from ngvisco.run.plots import FORMATS
from ngvisco.run.simulation import Observer, Simulation
from ngvisco.run.transfer import resume_changed, transfer


class RunDirectoryError(NgviscoError, RuntimeError):
    """A run directory that cannot be used: results in it, in use, or not one at all."""


_RESULTS = (
    *("case.toml", "versions.json", "mesh.vol", "ledger.csv", "run.h5", "bodies.csv"),
    *(f"{stem}.{kind}" for stem in ("energies", "history", "fields") for kind in FORMATS),
    *("scene.html", "movie.gif", "movie.mp4"),
    *(f"vtk/fields*.{kind}" for kind in ("vtu", "pvtu", "pvd")),
    *("samples/*.csv", "case.until-step-*.toml", "shapes/*.stl", "shapes/*.png", "log.txt"),
)
"""Patterns of the files that runs leave, but for those of failures."""


class RunDirectory:
    """Names and files of a run directory."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = require_path("directory", path)
        self.case_file = self.path / "case.toml"
        self.versions_file = self.path / "versions.json"
        self.mesh_file = self.path / "mesh.vol"
        self.ledger_file = self.path / "ledger.csv"
        self.run_file = self.path / "run.h5"
        self.log_file = self.path / "log.txt"
        self.vtk = self.path / "vtk"
        self.failure_file, self.failed_state = self.path / "failed.txt", self.path / "failed.vtu"
        self.lock_file = self.path / "lock"

    @property
    def results(self) -> list[Path]:
        """Files of an earlier run."""
        return [*self._found(_RESULTS), *self.failures]

    @property
    def failures(self) -> list[Path]:
        """What an attempt that failed has left."""
        return self._found(("failed.txt", "failed.vtu", "failed.pvtu", "failed_p*.vtu"))

    def _found(self, patterns: Sequence[str]) -> list[Path]:
        return [path for pattern in patterns for path in self.path.glob(pattern)]

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the directory, made if missing; raises RunDirectoryError when another process does.

        The lock's file is there only while it is held, and a directory that stayed empty is removed.
        """
        made = not self.path.exists()
        self.path.mkdir(parents=True, exist_ok=True)
        with _held(self.lock_file) as file:
            try:
                file.write(f"process {os.getpid()} on {platform.node()}\n")
                file.flush()
                yield
            finally:
                with contextlib.suppress(OSError):  # Windows keeps open files
                    self.lock_file.unlink()
                if made:
                    with contextlib.suppress(OSError):  # it has results in it
                        self.path.rmdir()

    def clear(self) -> None:
        """Remove the results of an earlier run, and nothing else."""
        for path in self.results:
            path.unlink()

    def keep_failure(self) -> None:
        """Remove all but the report of a run that made no step, for the corrected case to run here."""
        for path in set(self.results) - set(self.failures):
            path.unlink()
        for folder in (self.vtk, self.path / "samples", self.path / "shapes"):
            with contextlib.suppress(OSError):  # missing, or with files of the user's
                folder.rmdir()

    def prepare(self, case: Case, image: bytes, source: Origin | None = None) -> None:
        """Write case, mesh (a .vol file's content) and versions of a new run, and where it starts from."""
        write_atomically(self.case_file, case.resolved.encode())
        for name, file in case.shape_files.items():
            (self.path / name).parent.mkdir(exist_ok=True)
            if file != self.path / name:
                write_atomically(self.path / name, file.read_bytes())
        write_atomically(self.mesh_file, image)
        record = versions() | {"mesh_sha256": hashlib.sha256(image).hexdigest()}
        if source is not None:
            record["from"] = {"directory": str(source.directory), "step": source.step}
        write_atomically(self.versions_file, (json.dumps(record, indent=2) + "\n").encode())

    def refuse_results(self) -> None:
        """Raise RunDirectoryError if there are results of an earlier run."""
        if results := set(self.results) - set(self.failures):
            found = ", ".join(sorted(path.name for path in results)[:3])
            raise RunDirectoryError(
                f"{self.path}: holds results of an earlier run ({found}, ...); resume it, choose another "
                "directory, or replace it with --force"
            )

    def read_versions(self) -> dict[str, Any]:
        """The record of versions; raises RunDirectoryError."""
        try:
            record = json.loads(self.versions_file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RunDirectoryError(f"{self.versions_file}: cannot be read ({error})") from error
        if not isinstance(record, dict):
            raise RunDirectoryError(f"{self.versions_file}: expected a JSON object")
        return record

    @property
    def is_prepared(self) -> bool:
        """Whether case, mesh and versions are complete (versions are written last)."""
        return all(path.exists() for path in (self.case_file, self.mesh_file, self.versions_file))

    def case(self) -> Case:
        """The resolved case; raises RunDirectoryError or CaseError."""
        if not self.case_file.exists():
            raise RunDirectoryError(f"{self.path}: not a run directory (no case.toml)")
        return load_case(self.case_file)

    def mesh(self) -> Mesh:
        """The mesh of the run; raises MeshError if the file is not the one that was written."""
        require_whole(self.mesh_file)
        found = hashlib.sha256(self.mesh_file.read_bytes()).hexdigest()
        if found != self.read_versions().get("mesh_sha256"):
            raise MeshError(f"{self.mesh_file}: not the mesh of this run (its hash differs)")
        return mesh_in(self.mesh_file)


@dataclass(frozen=True)
class Origin:
    """The state of an earlier run that a new one starts from."""

    directory: Path
    step: int

    @classmethod
    def last_of(cls, directory: str | os.PathLike[str]) -> Origin:
        """The last state of a run directory."""
        return cls(Path(directory).resolve(), load(directory).simulation.number)

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
    """Run a case into a new run directory.

    Parameters
    ----------
    case : Case
    directory : path
    force : bool
        Remove the results of an earlier run first, rather than refuse.
    observers : sequence of Observer
        Besides those that write the directory.
    source : path, optional
        A run directory whose last state is taken over in place of the case's initial one, time included
        (``ngvisco.run.transfer``).

    Raises
    ------
    RunDirectoryError, CaseError, StepError, OSError
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
        place.prepare(case, image, origin)

    with ranks.held_by_first(place.locked()):
        ranks.on_first(begin)
        start = simulation.number
        try:
            return _go(place, case, simulation, None, observers, notes)
        except StepError:
            if simulation.number == start:
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
                simulation = new.simulation(_mesh_of_first(new, ranks, place.mesh))
                changes.check_change(place, case, simulation)  # before anything is written
                _check_times(place, new, simulation, new.until if until is None else until)
                ranks.on_first(lambda: changes.write_change(place, case, new, settings))
                case = place.case()
        notes = [f"resume: {case.sections.title or case.source}"]
        with noting_warnings(notes.append):
            simulation = case.simulation(_mesh_of_first(case, ranks, place.mesh))
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
            simulation.run(max(end, simulation.t), case.output_times(end))
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

    Raises
    ------
    RunDirectoryError, CaseError, CheckpointError, MeshError
    """
    place = RunDirectory(directory)
    case = place.case()
    if not place.run_file.exists():
        raise CheckpointError(f"{place.path}: no run.h5: the run ended before its first state was written")
    simulation = case.simulation(place.mesh())
    simulation.restore(place.run_file, step, attributes={"case": case.hash})
    return Results(case, read_ledger(place.run_file), simulation)


@contextlib.contextmanager
def _held(path: Path) -> Iterator[TextIO]:
    """The lock's file, empty and locked; raises RunDirectoryError when another process holds it."""
    while True:
        with path.open("a+", encoding="utf-8") as file:
            if not locks(file):
                file.seek(0)
                holder = file.read().strip() or "another process"
                raise RunDirectoryError(f"{path.parent}: in use by {holder}; wait for it or stop it")
            # a holder removes the file before it lets go: this may be one that is no longer there
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    file.truncate(0)
                    yield file
                    return

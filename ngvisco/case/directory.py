"""A run directory: all files that are needed to understand, resume and read a run.

``CASES.md`` lists the files.  The whole case is built before the directory is touched, so that a refused case
leaves nothing behind and removes nothing.  case.toml, versions.json and mesh.vol are complete before the
first step. A resumed run reads these files, never the user's case.
"""

import contextlib
import hashlib
import json
import os
import platform
import subprocess
import sys
import time as clock
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from ngsolve import Mesh

from ngvisco.case.build import Case, load_case
from ngvisco.errors import CheckpointError, MeshError, NgviscoError, require_path
from ngvisco.run.files import locks, mesh_in, mesh_of, require_whole, write_atomically
from ngvisco.run.pictures import FORMATS
from ngvisco.run.snapshot import ChosenMesh, mesh_of_checkpoints, read_ledger, version


class RunDirectoryError(NgviscoError, RuntimeError):
    """The error of a directory that holds results, is in use, or is no run directory."""


_RESULTS = (
    *("case.toml", "versions.json", "mesh.vol", "ledger.csv", "run.h5", "bodies.csv"),
    *(f"{stem}.{kind}" for stem in ("energies", "history", "fields") for kind in FORMATS),
    *("scene.html", "movie.gif", "movie.mp4"),
    *(f"vtk/fields*.{kind}" for kind in ("vtu", "pvtu", "pvd")),
    *(f"contours/contours*.{kind}" for kind in ("csv", "vtu", "pvd")),
    *("samples/*.csv", "case.until-step-*.toml", "shapes/*.stl", "shapes/*.png", "log.txt"),
)
"""Patterns of the files that runs leave, except for reports of failures."""
_FAILURES = ("failed.txt", "failed.vtu", "failed.pvtu", "failed_p*.vtu")


class RunDirectory:
    """Names and files of a run directory."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = require_path("directory", path)
        self.case_file = self.path / "case.toml"
        self.versions_file = self.path / "versions.json"
        self.mesh_file = self.path / "mesh.vol"
        self.run_file = self.path / "run.h5"
        self.log_file = self.path / "log.txt"
        self.vtk, self.bodies = self.path / "vtk", self.path / "bodies.csv"
        self.failure_file, self.failed_state = self.path / "failed.txt", self.path / "failed.vtu"
        self.lock_file = self.path / "lock"

    @property
    def results(self) -> list[Path]:
        """Result files of an earlier run, without the reports in ``failures``."""
        return [path for pattern in _RESULTS for path in self.path.glob(pattern)]

    @property
    def failures(self) -> list[Path]:
        """Report files of a failed run."""
        return [path for pattern in _FAILURES for path in self.path.glob(pattern)]

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the directory, and create it if it is missing.

        Raises RunDirectoryError if another process has locked the directory.  The lock file exists only while
        the lock is held.  A created directory that stays empty is removed.
        """
        if self.path.exists() and not self.path.is_dir():
            message = f"{self.path}: this is a file; expected a directory (a missing directory is created)"
            raise RunDirectoryError(message)
        is_new = not self.path.exists()
        self.path.mkdir(parents=True, exist_ok=True)
        with _held(self.lock_file) as file:
            try:
                file.write(f"process {os.getpid()} on {platform.node()}\n")
                file.flush()
                yield
            finally:
                with contextlib.suppress(OSError):  # Windows keeps open files
                    self.lock_file.unlink()
                if is_new:
                    with contextlib.suppress(OSError):  # a directory with results stays
                        self.path.rmdir()

    def clear(self) -> None:
        """Remove the results of an earlier run, and nothing else."""
        for path in [*self.results, *self.failures]:
            path.unlink()

    def keep_failure(self) -> None:
        """Remove all files of a run that made no step, except for the report of its failure.

        The corrected case can then run in this directory.
        """
        for path in self.results:
            path.unlink()
        for folder in (self.vtk, *(self.path / name for name in ("samples", "shapes", "laws"))):
            with contextlib.suppress(OSError):  # a missing folder, or one with a user's files
                folder.rmdir()

    def prepare(self, case: Case, image: bytes, origin: Mapping[str, Any] | None = None) -> None:
        """Write case, mesh (``image`` is a .vol file's content), versions and origin of a new run."""
        write_atomically(self.case_file, case.resolved.encode())
        for name, file in case.files.items():
            (self.path / name).parent.mkdir(exist_ok=True)
            if file != self.path / name:
                write_atomically(self.path / name, file.read_bytes())
        write_atomically(self.mesh_file, image)
        record = versions() | {"mesh_sha256": hashlib.sha256(image).hexdigest()}
        if origin is not None:
            record["from"] = dict(origin)
        self.write_versions(record)

    def refuse_results(self) -> None:
        """Raise RunDirectoryError if there are results of an earlier run."""
        if results := self.results:
            names = ", ".join(sorted(path.name for path in results)[:3])
            raise RunDirectoryError(
                f"{self.path}: this directory has results of an earlier run ({names}, ...); resume that "
                "run, choose another directory, or replace the results with --force"
            )

    def read_versions(self) -> dict[str, Any]:
        """The record in versions.json; raises RunDirectoryError if it cannot be read."""
        try:
            record = json.loads(self.versions_file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise RunDirectoryError(f"{self.versions_file}: the file cannot be read ({error})") from error
        if not isinstance(record, dict):
            raise RunDirectoryError(f"{self.versions_file}: expected a file with a JSON object")
        return record

    def write_versions(self, record: Mapping[str, Any]) -> None:
        """Write versions.json, whole or not at all."""
        write_atomically(self.versions_file, (json.dumps(record, indent=2) + "\n").encode())

    def ledger(self) -> dict[str, np.ndarray]:
        """The columns of the ledger in run.h5, with at least one row; raises CheckpointError."""
        ledger = read_ledger(self.run_file)
        if not len(ledger.get("time", ())):
            raise CheckpointError(f"{self.run_file}: the ledger in this file is empty")
        return ledger

    def require_checkpoints(self) -> None:
        """Raise RunDirectoryError if the directory has steps but no checkpoints to go on from."""
        table = self.path / "ledger.csv"
        rows = len(table.read_text(encoding="utf-8").splitlines()) if table.exists() else 0
        if rows > 2 and not self.run_file.exists():  # the head, and the row of the start
            raise RunDirectoryError(
                f"{self.run_file}: this file is missing, although ledger.csv has {rows - 2} "
                f"step{'s' * (rows > 3)}; put the file back, or compute the case from its start into another "
                f"directory: ngvisco run {self.case_file} -o DIR"
            )

    def case(self) -> Case:
        """The resolved case; raises RunDirectoryError or CaseError."""
        if not self.case_file.exists():
            if self.path.is_dir():
                what = "this directory is not a run directory, since case.toml is missing"
            else:
                exists = self.path.exists()
                what = "this is a file, not a run directory" if exists else "this directory does not exist"
            raise RunDirectoryError(f"{self.path}: {what}")
        return load_case(self.case_file)

    def mesh(self) -> Mesh:
        """The initial mesh of the run; raises MeshError if the file has changed since the run wrote it."""
        require_whole(self.mesh_file)
        if hashlib.sha256(self.mesh_file.read_bytes()).hexdigest() != self.read_versions().get("mesh_sha256"):
            raise MeshError(
                f"{self.mesh_file}: the file has changed since the run wrote it, since the hash of the file "
                "differs from the hash in versions.json"
            )
        return mesh_in(self.mesh_file)

    def chosen_mesh(self) -> ChosenMesh | None:
        """The mesh of the last state; None if the last state is on the initial mesh."""
        return mesh_of_checkpoints(self.run_file) if self.run_file.exists() else None

    def present_mesh(self) -> Mesh:
        """The mesh of the last state; raises MeshError and CheckpointError."""
        chosen = self.chosen_mesh()
        return self.mesh() if chosen is None else mesh_of(chosen.image)


@contextlib.contextmanager
def _held(path: Path) -> Iterator[TextIO]:
    """The lock's file, empty and locked; raises RunDirectoryError when another process holds it."""
    while True:
        with path.open("a+", encoding="utf-8") as file:
            if not locks(file):
                file.seek(0)
                holder = file.read().strip() or "another process"
                raise RunDirectoryError(
                    f"{path.parent}: {holder} uses this directory; wait until that process has ended, or "
                    "stop the process"
                )
            # a holder deletes its lock file before it unlocks it: the open file may be deleted already
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    file.truncate(0)
                    yield file
                    return


def versions() -> dict[str, Any]:
    """Versions, commit and machine, for versions.json."""
    packages = ("ngvisco", "ngsolve", "netgen-mesher", "numpy", "scipy", "h5py", "pydantic")
    return {
        **{name: version(name) for name in packages},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "commit": commit(),
        "command": sys.argv,
        "started": clock.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def commit() -> str | None:
    """The commit of a clone (``-dirty`` with changes), None for an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=20)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() or None

"""The command ``ngvisco info --parallel``: checks MPI and PETSc, and computes a step on three ranks."""

import argparse
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from ngvisco.case.build import parse_case
from ngvisco.cli import streams
from ngvisco.cli.streams import DONE, FAILED
from ngvisco.errors import ParameterError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.petsc import PETScError, obstacle, packages, petsc

_RANKS, _SECONDS = 3, 120
_STARTERS = ("mpirun", "mpiexec")


def info(options: argparse.Namespace) -> int:
    """Print the installed packages, and test them on this command's ranks, or on three new ones."""
    if options.directory is not None:
        raise ParameterError("DIR", options.directory, "no directory together with --parallel")
    ranks, starter = Communicator.world(), _starter()
    complete, lines = _found()  # on all ranks: the first import of petsc4py is collective
    if complete and starter is not None and not ranks.is_distributed:
        return _started(starter)
    if ranks.is_first:
        streams.write("\n".join(lines) + "\n")
        if not (complete and ranks.is_distributed):
            streams.write(
                "not tried  a package or mpirun is missing; ngvisco/parallel/RANKS.md says what to install\n"
            )
    return _tried(ranks) if complete and ranks.is_distributed else FAILED


def _started(starter: str) -> int:
    """Start this command on several ranks; return its exit code."""
    command = [starter, "-n", str(_RANKS), sys.executable, "-m", "ngvisco", "info", "--parallel"]
    # as this is only a test, it may use more ranks than processors, and run as root
    allowed = dict.fromkeys(
        ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe"), "1"
    ) | {"PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    try:
        result = subprocess.run(
            command, env=os.environ | allowed, capture_output=True, text=True, timeout=_SECONDS
        )
    except subprocess.TimeoutExpired:
        streams.complain(f"{starter} -n {_RANKS} did not end within {_SECONDS} s")
        return FAILED
    streams.write(result.stdout)
    if result.returncode:
        streams.complain("the test failed on the ranks\n" + result.stderr)
    return FAILED if result.returncode else DONE


def _tried(ranks: Communicator) -> int:
    """Compute a step of a small body by each installed linear solver; exceptions are passed on."""
    for name in ("direct", *(name for name in ("gamg", "hypre") if obstacle(name) is None)):
        case = parse_case(_CASE, "info --parallel", Path(), [f"solver.coarse={name}"])
        run = case.simulation(case.mesh())
        row, solver = run.advance(), "mumps" if name == "direct" else name
        if ranks.is_first:
            streams.write(
                f"{solver:10s} a step of {run.cells} cells on {ranks.size - 1} of {ranks.size} ranks, "
                f"{row['newton_iterations']:.0f} iterations, closure {abs(row['closure_relative']):.0e}\n"
            )
    return DONE


_CASE = """
time = { dt = 0.02, until = 0.02 }
domain = { geometry = "structured_box", size = [1, 1], cells = [24, 24] }
material = { kind = "NeoHookean", K_e = 10, G_e = 5, epsilon = 0.1 }
rheology.viscosity = { K_v = 0.1, G_v = 0.1 }
initial.velocity = ["0.1*sin(pi*x)*cos(pi*y)", 0]
solver.method = "split"
"""
"""A case with so many cells that the velocities are not factorised as a whole."""


def _starter() -> str | None:
    """Path of this installation's mpirun: beside Python, or else on the search path; None if there is
    none."""
    folders = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return next((path for name in _STARTERS if (path := shutil.which(name, path=folders))), None)


def _found() -> tuple[bool, list[str]]:
    """Whether both MPI and PETSc with MUMPS are installed, and lines with the versions or the missing
    parts."""
    lines, complete = [], True
    try:
        mpi = importlib.import_module("mpi4py.MPI")
        version = mpi.Get_library_version().splitlines()[0].partition(",")[0].strip("\0 ")
        by = f"mpi4py {importlib.import_module('mpi4py').__version__}"
        lines.append(f"MPI        {version}, {by}, started by {_starter() or 'nothing: no mpirun'}")
    except (ImportError, RuntimeError) as error:
        lines.append(f"MPI        missing ({error})")
        complete = False
    try:
        number = ".".join(map(str, petsc().Sys.getVersion()))
        built = packages()
        there = ", ".join(name for name, has in built.items() if has) or "none"
        absent = ", ".join(name for name, has in built.items() if not has)
        lines.append(f"PETSc      {number}, packages {there}{f'; not {absent}' if absent else ''}")
        complete = complete and built["mumps"]
    except PETScError as error:
        lines.append(f"PETSc      {error}")
        complete = False
    return complete, lines

"""``ngvisco info --parallel``: what distributed runs need, whether it is there, and a test of it."""

from __future__ import annotations

import argparse
import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from ngvisco.cli import streams
from ngvisco.cli.exits import DONE, FAILED
from ngvisco.errors import ParameterError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.petsc import PETScError, packages, petsc
from ngvisco.parallel.selftest import main as tested

_RANKS, _SECONDS = 3, 120
_STARTERS = ("mpirun", "mpiexec")


def info(options: argparse.Namespace) -> int:
    """Print what there is, and run the self-test: on the ranks of this run, or on three of its own."""
    if options.directory is not None:
        raise ParameterError("info", options.directory, "a run directory or --parallel")
    ranks = Communicator.world()
    complete, lines = _found()  # on all ranks alike: the first import of petsc4py is collective
    if ranks.is_first:
        streams.write("\n".join(lines) + "\n")
    if ranks.is_distributed and complete:
        return tested()
    starter = _starter()
    if not complete or starter is None:
        if ranks.is_first:
            streams.write("self-test  not run: something is missing, see 'Several processes' in the README\n")
        return FAILED
    streams.write(f"self-test  on {_RANKS} ranks\n")
    command = [starter, "-n", str(_RANKS), sys.executable, "-m", "ngvisco.parallel.selftest"]
    # more ranks than processors, and root, are no reason to refuse a test
    allowed = dict.fromkeys(
        ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe"), "1"
    ) | {"PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    try:
        result = subprocess.run(
            command, env=os.environ | allowed, capture_output=True, text=True, timeout=_SECONDS
        )
    except subprocess.TimeoutExpired:
        streams.complain(f"the self-test did not end within {_SECONDS} s")
        return FAILED
    streams.write(result.stdout)
    if result.returncode:
        streams.complain("the self-test failed\n" + result.stderr)
    return FAILED if result.returncode else DONE


def _starter() -> str | None:
    """Where this installation's mpirun is: beside Python, then on the path."""
    folders = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return next((found for name in _STARTERS if (found := shutil.which(name, path=folders))), None)


def _found() -> tuple[bool, list[str]]:
    """Whether MPI and PETSc are there with what is needed of them, and lines that say what is."""
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
        found = packages()
        there = ", ".join(name for name, has in found.items() if has) or "none"
        absent = ", ".join(name for name, has in found.items() if not has)
        lines.append(f"PETSc      {number}, packages {there}{f'; not {absent}' if absent else ''}")
        complete = complete and found["mumps"]
    except PETScError as error:
        lines.append(f"PETSc      {error}")
        complete = False
    return complete, lines

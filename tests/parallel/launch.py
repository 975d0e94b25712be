"""Runs scripts under mpirun with a Python that has petsc4py: this one, or NGVISCO_PARALLEL_PYTHON."""

import json
import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("NGVISCO_PARALLEL_PYTHON", sys.executable)
FOLDERS = os.pathsep.join([str(Path(PYTHON).parent), os.environ.get("PATH", "")])
MPIRUN = shutil.which("mpirun", path=FOLDERS)


@cache
def has_petsc() -> bool:
    """Return whether distributed runs can be started; where CI requires them, raise an error if they
    cannot."""
    found = MPIRUN is not None and run("-c", "import ngsolve, mpi4py.MPI, petsc4py.PETSc").returncode == 0
    assert found or "NGVISCO_REQUIRE_PETSC" not in os.environ, "no mpirun, mpi4py or petsc4py"
    return found


def run(*words: str | Path, ranks: int = 1, timeout: float = 900) -> subprocess.CompletedProcess[str]:
    """Run Python with arguments, on one rank without mpirun, for a limited number of seconds."""
    start = ["--oversubscribe", "-n", str(ranks)] if ranks > 1 else []
    return launched([*start, PYTHON, *map(str, words)], timeout)


def launched(words: list[str], timeout: float = 900) -> subprocess.CompletedProcess[str]:
    """Run the words as a command; words that begin with an option are arguments of mpirun."""
    allowed = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM")
    environment = os.environ | dict.fromkeys(allowed, "1")
    environment |= {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "NGS_NUM_THREADS": "1"}
    start = [str(MPIRUN)] if words[0].startswith("-") else []
    return subprocess.run([*start, *words], env=environment, capture_output=True, text=True, timeout=timeout)


def printed(*words: str | Path, ranks: int = 1, timeout: float = 900) -> Any:
    """The last line of the processes' output, read as JSON."""
    result = run(*words, ranks=ranks, timeout=timeout)
    assert result.returncode == 0, result.stderr[-2000:]
    return json.loads(result.stdout.splitlines()[-1])


needs_petsc = pytest.mark.skipif(not has_petsc(), reason="no MPI or PETSc: see ngvisco/parallel/RANKS.md")

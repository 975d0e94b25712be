"""Every form is assembled across MPI's ranks as on one: what a distributed solver would start from."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("ranks.py")
BESIDE = str(Path(sys.executable).parent)
MPIEXEC = shutil.which("mpiexec", path=os.pathsep.join([BESIDE, os.environ.get("PATH", "")]))

pytestmark = [
    pytest.mark.long,
    pytest.mark.ci,
    pytest.mark.skipif(
        MPIEXEC is None or importlib.util.find_spec("mpi4py") is None,
        reason="no MPI: pip install ngvisco[mpi]",
    ),
]


NAMES = ("a periodic square", "a disc", "a cube")


def found(*command: str) -> dict:
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    threads = {"OPENBLAS_NUM_THREADS": "1", "NGS_NUM_THREADS": "1"}
    run = subprocess.run(
        [*command, sys.executable, str(SCRIPT), *NAMES],
        env={**os.environ, **root, **threads},
        capture_output=True,
        text=True,
        timeout=150,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return json.loads(run.stdout.splitlines()[-1])


def test_two_ranks_with_cells_find_what_one_finds():
    """Residual and Jacobian of every block of rows, entries of the ledger, passive fields after a step."""
    one, several = found(), found(str(MPIEXEC), "--oversubscribe", "-n", "3")
    for name in NAMES:
        for group, values in one[name].items():
            largest = max(abs(value) for value in values.values())
            for key, value in values.items():
                expected = pytest.approx(value, rel=1e-9, abs=1e-13 * largest)
                assert several[name][group][key] == expected, (name, group, key)

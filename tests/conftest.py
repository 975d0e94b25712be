"""Each test process has one NGSolve thread: sums have a fixed order, and processes share the cores.

There are three tiers. The default tier has all tests without the mark `long`, and the quick tier (`-m quick`)
has a part of these tests.
"""

import gc
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NGSolve loads its BLAS
os.environ.setdefault("NGS_NUM_THREADS", "1")  # read by processes that tests start
os.environ.setdefault("NGVISCO_THREADS", "1")
if sys.dont_write_bytecode:  # the processes share compiled modules in a folder outside of the sources
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache" / "bytecode")
    sys.dont_write_bytecode = False
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import numpy as np
import pytest
from ngsolve import SetNumThreads

SetNumThreads(1)

HERE = Path(__file__).parent
QUICK = {
    *("algebra", "reduced", "forms", "physics", "timestepping/test_scheme.py", "verification/test_labels.py"),
    *(f"case/test_{name}.py" for name in ("energies", "key_reference", "outputs", "schema", "units")),
    *(f"run/test_{name}.py" for name in ("output", "record", "refusals")),
    *(f"solver/test_{name}.py" for name in ("newton", "split_derivative")),
    *(f"test_{name}.py" for name in ("documents", "expressions", "notices", "readme", "rooms", "threads")),
}
"""Rooms and modules of the edit loop, at least one module for each room; 75 s of processor time in all."""
NOT_QUICK = {
    *(
        f"forms/test_{name}.py"
        for name in ("bounds", "kinks", "regularisation", "field_diffusion", "wall_conditions")
    ),
    *(f"physics/test_{name}.py" for name in ("material_laws", "variables")),
}
"""Modules of the edit loop's rooms that take too long for the edit loop."""


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """Collect the tests while Python's garbage collector is off: it would visit all tests twenty times."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the quick tests, before `-m` selects tests."""
    for item in items:
        path = item.path.relative_to(HERE)
        names = {path.as_posix(), path.parts[0]}
        if names & QUICK and not names & NOT_QUICK and item.get_closest_marker("long") is None:
            item.add_marker("quick")


@pytest.fixture
def rng() -> np.random.Generator:
    """A random number generator with a fixed seed."""
    return np.random.default_rng(20240)

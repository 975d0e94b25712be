"""One NGSolve thread in each test process: sums have a fixed order, and processes share the cores.

Three tiers: `-m quick` is a part of the default one, which is all that is not marked `long`.
"""

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NGSolve loads its BLAS
os.environ.setdefault("NGS_NUM_THREADS", "1")  # read by processes that tests start

import numpy as np
import pytest
from ngsolve import SetNumThreads

SetNumThreads(1)

HERE = Path(__file__).parent
QUICK = [
    "algebra",
    "reduced",
    "forms",
    "physics",
    "timestepping/test_scheme.py",
    "case/test_energies.py",
    "case/test_key_reference.py",
    "run/test_meshfile.py",
    "case/test_outputs.py",
    "case/test_schema.py",
    "case/test_units.py",
    "run/test_output.py",
    "run/test_record.py",
    "run/test_refusals.py",
    "run/test_rest_stresses.py",
    "solver/test_newton.py",
    "solver/test_split_derivative.py",
    "verification/test_labels.py",
    "test_documents.py",
    "test_expressions.py",
    "test_notices.py",
    "test_readme.py",
    "test_rooms.py",
    "test_threads.py",
]
"""Rooms and modules of the edit loop: one or more of each room, 75 s of processor time in all."""
NOT_QUICK = [
    "forms/test_bounds.py",
    "forms/test_corners.py",
    "forms/test_kinks.py",
    "forms/test_regularisation.py",
    "forms/test_field_diffusion.py",
    "forms/test_wall_conditions.py",
    "forms/test_wall_projection.py",
    "physics/test_material_laws.py",
    "physics/test_variables.py",
]
"""What takes longer in these rooms."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark what is quick, before `-m` chooses."""
    for item in items:
        path = item.path.relative_to(HERE)
        names = {path.as_posix(), path.parts[0]}
        if names & set(QUICK) and not names & set(NOT_QUICK) and item.get_closest_marker("long") is None:
            item.add_marker("quick")


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20240)

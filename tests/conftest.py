"""One NGSolve thread in each test process: sums have a fixed order, and processes share the cores."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NGSolve loads its BLAS

import numpy as np
import pytest
from ngsolve import SetNumThreads

SetNumThreads(1)


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run."""
    return np.random.default_rng(20240)

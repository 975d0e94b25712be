"""One NGSolve thread in each test process: sums have a fixed order, and processes share the cores."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NGSolve loads its BLAS

from ngsolve import SetNumThreads

SetNumThreads(1)

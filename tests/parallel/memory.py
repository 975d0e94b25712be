"""Factorises a matrix by PETSc many times; prints the growth of memory, and a factorisation's memory, GB."""

import numpy as np
import scipy.sparse as sp

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.petsc import SumInverse
from tests.benchmarks.ranks import resident

line = sp.diags([1.0, 30.0, 1.0], [-1, 0, 1], shape=(17, 17))
matrix = sp.kron(sp.kron(line, line), line).tocsr()
count = matrix.shape[0]
exchange = Exchange(count, {}, Communicator())
found = [resident("VmRSS")]
for _ in range(2):
    inverse = SumInverse(np.ones(count, dtype=bool), exchange)
    for _ in range(3):
        inverse.factorise(matrix)
        assert np.allclose(matrix @ inverse(np.ones(count)), 1.0)
        found.append(resident("VmRSS"))
    inverse.release()
print([max(found[2:]) - found[2], found[1] - found[0]])

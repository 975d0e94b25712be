"""Counts iterations of conjugate gradients with GAMG for the vertices' velocities, with and without rigid
motions.

``test_multigrid_over_ranks`` runs this script.  The matrix and the cycle with rigid motions are those of the
split solver.  The script also solves with a matrix that is not positive definite, and prints the residual of
the solution, and the message.
"""

import json
import warnings

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

import ngvisco as nv
from ngvisco.algebra.factorised import TwoLevelSolver
from ngvisco.geometries import structured_box
from ngvisco.parallel.petsc import SumInverse
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.problem import Interval

matrices = []
factorise = TwoLevelSolver.factorise


def noting(self, matrix):
    matrices.append(matrix)
    factorise(self, matrix)


TwoLevelSolver.factorise = noting
model = nv.Model(
    material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1), viscosity=nv.StokesViscosity(K_v=10.0, G_v=10.0)
)
newton = nv.NewtonOptions(method="split", coarse="gamg", split=SplitOptions(direct_up_to=(0, 0)))
run = nv.Simulation(structured_box((1, 1), (16, 16)), model, dt=0.1, newton=newton)
run.solver.newton.factorise(run.solver.problem(Interval(0.1, 0.0, 0.1, 0.0, 0.1)))
solver, (matrix,) = run.solver.newton.preconditioner.solver, matrices
free = solver.free & solver.vertices
bare = SumInverse(free, solver.exchange, symmetric=True, method="gamg")
bare.factorise(matrix)
own = np.flatnonzero(free)
block = matrix[own][:, own]
block = 0.5 * (block + block.T)


def iterations(inverse) -> int:
    found = []

    def preconditioned(r):
        whole = np.zeros(len(free))
        whole[own] = r
        return inverse(whole)[own]

    right = np.random.default_rng(0).standard_normal(len(own))
    cg(block, right, rtol=1e-8, M=LinearOperator(block.shape, preconditioned), callback=found.append)
    return len(found)


found = {"cells": run.cells, "with": iterations(solver.coarse), "without": iterations(bare)}
with warnings.catch_warnings(record=True) as caught:
    factorised = solver.factorised(free, -matrix, True)
whole = np.zeros(len(free))
whole[own] = np.random.default_rng(1).standard_normal(len(own))
found["left"] = float(abs(whole[own] + block @ factorised(whole)[own]).max())
found["said"] = [str(each.message) for each in caught]
print(json.dumps(found))

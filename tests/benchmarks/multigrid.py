"""GMRES with algebraic multigrid for displacements, by PETSc: the linear solver of ``LagrangianSwirl``."""

import itertools

import numpy as np

from tests.verification.lagrangian_swirl import Blocks

_TOLERANCE = 1e-3
"""Relative tolerance of the linear systems."""


class Multigrid:
    """GMRES; its preconditioner is a cycle of GAMG, with the rigid motions as near-null space.

    The multigrid's interpolation is kept for all matrices.  Raises ModuleNotFoundError without petsc4py.
    """

    def __init__(self, nodes: np.ndarray) -> None:
        import petsc4py

        petsc4py.init(["lagrangian", "-pc_gamg_reuse_interpolation", "true"])
        from petsc4py import PETSc

        self._petsc, self._matrix = PETSc, None
        coordinates = PETSc.Vec().createWithArray(nodes.ravel().copy(), bsize=3)
        self._rigid = PETSc.NullSpace().createRigidBody(coordinates)
        self._solver = PETSc.KSP().create()
        self._solver.setType("gmres")
        self._solver.setTolerances(rtol=_TOLERANCE, max_it=200)
        self._solver.getPC().setType("gamg")
        self._solver.setFromOptions()

    def __call__(self, blocks: Blocks, right: np.ndarray) -> tuple[np.ndarray, int]:
        """The solution and the number of iterations."""
        ends, columns, values = blocks
        size, module = len(right), self._petsc
        if self._matrix is None:  # rows of the three unknowns of each node in turn
            counts = np.diff(ends)
            places = np.repeat(np.tile(np.arange(3), len(counts)), np.repeat(counts, 3))
            order = np.concatenate([np.tile(np.arange(*pair), 3) for pair in itertools.pairwise(ends)])
            self._order = order, places
            wide = (3 * columns[order][:, None] + np.arange(3, dtype=np.int32)).ravel()
            self._pattern = np.append(0, np.cumsum(np.repeat(3 * counts, 3))).astype(np.int32), wide
            entries = values[order, places].ravel()
            self._matrix = module.Mat().createAIJ((size, size), bsize=3, csr=(*self._pattern, entries))
            self._matrix.setNearNullSpace(self._rigid)
        else:
            self._matrix.setValuesCSR(*self._pattern, values[self._order].ravel())
            self._matrix.assemble()
        self._solver.setOperators(self._matrix)
        given = module.Vec().createWithArray(right)
        solution = given.duplicate()
        self._solver.solve(given, solution)
        return solution.getArray().copy(), self._solver.getIterationNumber()

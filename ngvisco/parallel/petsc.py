"""PETSc for the linear systems: matrices of rows over the ranks, a direct solver and multigrid.

Which unknown is which row: ``ParallelDofs.EnumerateGlobally`` of the free unknowns.  A matrix that NGSolve
assembled is the sum of the ranks' local ones; PETSc has that as a type (IS) and converts it to rows (AIJ).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from ngsolve import BaseMatrix, BaseVector, BitArray
from ngsolve.la import PARALLEL_STATUS

from ngvisco.errors import NgviscoError
from ngvisco.parallel.communicator import Communicator

PACKAGES = ("mumps", "superlu_dist", "hypre", "ml", "ptscotch", "parmetis")
"""External packages that are of use here; GAMG is a part of PETSc."""

MISSING = "petsc4py is missing or does not load: see 'Several processes' in the README for what to install"


class PETScError(NgviscoError, RuntimeError):
    """PETSc is missing, or did not solve a system."""


def petsc() -> Any:
    """The module ``petsc4py.PETSc``; collective at its first call.  Raises PETScError where there is none."""
    try:
        import petsc4py

        petsc4py.init(["ngvisco", "-no_signal_handler"])  # SIGTERM and closed pipes are ours to handle
        from petsc4py import PETSc
    except ImportError as error:
        raise PETScError(f"{MISSING} ({error})") from error
    return PETSc


def packages() -> dict[str, bool]:
    """Which of ``PACKAGES`` this PETSc was built with."""
    has = petsc().Sys.hasExternalPackage
    return {name: bool(has(name)) for name in PACKAGES}


class Rows:
    """The free unknowns of a distributed space as rows of PETSc's matrices and vectors.

    Parameters
    ----------
    dofs : ParallelDofs
        Of the space, whose unknowns are scalars.
    free : BitArray
    communicator : Communicator
    """

    def __init__(self, dofs: Any, free: BitArray, communicator: Communicator) -> None:
        module = petsc()
        self.comm = communicator.mpi
        self.free = np.flatnonzero(np.array(list(free), dtype=bool)).astype(module.IntType)
        numbers, self.count = dofs.EnumerateGlobally(free)
        own = np.array(numbers, dtype=module.IntType)[self.free]
        self._map = module.LGMap().create(indices=own, comm=self.comm)
        self._rows = module.IS().createGeneral(own, comm=self.comm)
        self._values = np.zeros(len(own))
        self._own = module.Vec().createWithArray(self._values, comm=module.COMM_SELF)
        self._scatter: Any = None

    def matrix(self, local: BaseMatrix) -> Any:
        """The sum of the ranks' matrices, (unknowns, unknowns), in free rows and columns, as AIJ."""
        module = petsc()
        values, columns, starts = local.CSR()
        csr = (np.array(starts, module.IntType), np.array(columns, module.IntType), np.array(values))
        own = module.Mat().createAIJ(size=(local.height, local.width), csr=csr, comm=module.COMM_SELF)
        matrix = module.Mat().create(comm=self.comm)
        matrix.setSizes(self.count)
        matrix.setType(module.Mat.Type.IS)
        matrix.setLGMap(self._map)
        matrix.setISLocalMat(own.createSubMatrices(module.IS().createGeneral(self.free))[0])
        matrix.assemble()
        matrix.convert(module.Mat.Type.AIJ)
        return matrix

    def solve(self, solver: Any, rows: BaseVector, unknowns: BaseVector) -> None:
        """unknowns = the solver's solution for the right-hand side ``rows``; 0 where not free."""
        module = petsc()
        if self._scatter is None:
            self._solution, self._right = solver.getOperators()[0].createVecs()
            self._scatter = module.Scatter().create(self._own, None, self._right, self._rows)
        rows.Distribute()
        self._values[:] = rows.FV().NumPy()[self.free]
        self._right.set(0.0)
        self._scatter.scatter(self._own, self._right, addv=module.InsertMode.ADD)
        solver.solve(self._right, self._solution)
        reason = solver.getConvergedReason()
        if reason < 0:
            raise PETScError(f"PETSc's {solver.getType()} did not converge (reason {reason})")
        self._scatter.scatter(
            self._solution, self._own, addv=module.InsertMode.INSERT, mode=module.ScatterMode.REVERSE
        )
        unknowns.SetParallelStatus(PARALLEL_STATUS.CUMULATED)
        unknowns.FV().NumPy()[:] = 0.0
        unknowns.FV().NumPy()[self.free] = self._values


class Direct(BaseMatrix):
    """The inverse of a distributed matrix by a factorisation of MUMPS, in the free unknowns.

    Raises
    ------
    PETScError
        If PETSc or its MUMPS is missing, or the matrix is singular.
    """

    def __init__(self, matrix: BaseMatrix, free: BitArray, communicator: Communicator) -> None:
        super().__init__()
        if not packages()["mumps"]:
            raise PETScError("this PETSc has no MUMPS: expected one built with it")
        self.matrix = matrix
        self.rows = Rows(matrix.row_pardofs, free, communicator)
        self.Update()

    def Update(self) -> None:
        """Factorise again, as NGSolve's inverses do, where the matrix has changed."""
        module = petsc()
        own = self.rows.matrix(self.matrix.local_mat)
        self._solver = module.KSP().create(comm=self.rows.comm)
        self._solver.setOperators(own)
        self._solver.setType("preonly")
        preconditioner = self._solver.getPC()
        preconditioner.setType("lu")
        preconditioner.setFactorSolverType("mumps")
        try:
            self._solver.setUp()
        except module.Error as error:
            raise PETScError(f"MUMPS did not factorise the matrix ({error})") from error

    def Mult(self, rows: BaseVector, unknowns: BaseVector) -> None:
        """unknowns = matrix^{-1} rows, 0 where not free; collective."""
        self.rows.solve(self._solver, rows, unknowns)

    def Shape(self) -> Any:
        return self.matrix.shape

    def CreateVector(self, col: bool) -> BaseVector:
        return self.matrix.CreateVector(not col)


def inverse_of(matrix: BaseMatrix, free: BitArray, communicator: Communicator) -> BaseMatrix:
    """The inverse of a symmetric positive definite matrix in the free unknowns."""
    if communicator.is_distributed:
        return Direct(matrix, free, communicator)
    return matrix.Inverse(free, inverse="sparsecholesky")

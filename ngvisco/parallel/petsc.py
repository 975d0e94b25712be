"""PETSc for the linear systems: matrices with rows over the ranks, a direct solver and multigrid.

``Exchange.numbers`` of the free unknowns assigns the rows.  A matrix is the sum of the ranks' matrices, added
in the ranks' order.  The first of several ranks has no cells, and hence no rows.  The first rank takes no
part in solutions, because waiting for the other ranks would keep a processor busy.

MUMPS over ranks adds contributions in the order in which messages arrive, so that its factors and solutions
differ in the last digits from one run to the next.  Up to some thousand unknowns, one rank therefore has all
rows, and its solutions are reproducible to the bit.

PETSc 3.18 keeps objects that petsc4py has dropped, also after ``garbage_cleanup``.  Therefore this module
destroys every object explicitly and collectively; callers ``release`` an inverse before they make another
one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from ngsolve import BaseMatrix, BaseVector, BitArray
from ngsolve.la import PARALLEL_STATUS

from ngvisco.errors import NgviscoError, StepError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange, Owned

PACKAGES = ("mumps", "superlu_dist", "hypre", "ml", "ptscotch", "parmetis")
"""External packages of PETSc that are useful here; GAMG is a part of PETSc itself."""

ON_ONE_RANK_UP_TO = 5_000
"""Largest number of unknowns that one rank factorises alone; PETSc's option
``-ngvisco_on_one_rank_up_to`` overrides it."""

MISSING = "petsc4py is missing or does not load; ngvisco/parallel/RANKS.md says what to install"

_loaded: list[Any] = []
"""The loaded module ``petsc4py.PETSc``; empty before the first use."""


class PETScError(NgviscoError, RuntimeError):
    """PETSc is missing, or did not solve a system."""


class SingularError(PETScError, StepError):
    """A matrix has no factorisation."""


def petsc() -> Any:
    """The module ``petsc4py.PETSc``; collective at its first call.  Raises PETScError if it does not load."""
    if _loaded:
        return _loaded[0]
    try:
        import petsc4py

        petsc4py.init(["ngvisco", "-no_signal_handler"])  # ngvisco handles SIGTERM and closed pipes itself
        from petsc4py import PETSc
    except ImportError as error:
        raise PETScError(f"{MISSING} ({error})") from error
    # without a communicator of all ranks, PETSc would make one at its end, and wait there for failed ranks
    PETSc.COMM_WORLD.duplicate()
    _loaded.append(PETSc)
    return PETSc


def packages() -> dict[str, bool]:
    """Whether this PETSc was built with each of ``PACKAGES``, by name."""
    return {name: bool(petsc().Sys.hasExternalPackage(name)) for name in PACKAGES}


def obstacle(method: str) -> str | None:
    """Reason why PETSc lacks the linear solver ``"mumps"``, ``"gamg"`` or ``"hypre"``, or None."""
    try:
        has = packages()
    except PETScError as error:
        return str(error)
    if has.get(method, True):
        return None
    return f"this PETSc was built without {method}; expected a PETSc with {method}"


def require_petsc(communicator: Communicator) -> None:
    """Raise PETScError if several ranks have no PETSc with MUMPS; one process needs none."""
    if communicator.is_distributed and (missing := obstacle("mumps")) is not None:
        raise PETScError(missing)


class SumInverse:
    """The inverse of a sum of the ranks' matrices in the free unknowns, exact or by one multigrid cycle.

    Raises PETScError if PETSc or the method's package is missing, also on one process.

    Parameters
    ----------
    free : (unknowns,) array of bool
        Free unknowns, equal on all ranks that share an unknown; the solution is 0 in all other unknowns.
    exchange : Exchange or HaloUnknowns
        Exchange of the unknowns.
    symmetric : bool
        Whether the matrix is replaced by its symmetric part.
    method : str
        ``"mumps"`` factorises; ``"gamg"`` (PETSc's) and ``"hypre"`` (BoomerAMG) are one cycle of algebraic
        multigrid, for positive definite matrices.
    kernel : (n, unknowns) array, optional
        Summed vectors of the near-null space, such as rigid motions, from which GAMG makes coarse spaces.
    """

    def __init__(
        self,
        free: np.ndarray,
        exchange: Owned,
        symmetric: bool = False,
        method: str = "mumps",
        kernel: np.ndarray | None = None,
    ) -> None:
        if (missing := obstacle(method)) is not None:
            raise PETScError(missing)
        self.exchange, self.symmetric, self.method, self.kernel = exchange, symmetric, method, kernel
        self.communicator, module = exchange.communicator, petsc()
        self._comm = self.communicator.working or module.COMM_SELF
        numbers, count = exchange.numbers(free)
        mine = int(np.count_nonzero(free & exchange.owned))
        largest = module.Options().getInt("ngvisco_on_one_rank_up_to", ON_ONE_RANK_UP_TO)
        self._on_one = exchange.is_distributed and method == "mumps" and count <= largest
        """Whether the first rank with cells has all rows."""
        self._solving: Any = self._comm
        """Communicator on which the system is solved; None on a rank without rows."""
        if self._on_one:
            mine = count if self._comm.rank == 0 else 0
            self._solving = module.COMM_SELF if self._comm.rank == 0 else None
        self._size = mine, count
        """Numbers of rows of this rank and of all ranks."""
        self._free = np.flatnonzero(free)
        self._numbers = numbers[self._free].astype(module.IntType)
        self._values = np.zeros(len(self._numbers))
        self._solver: Any = None
        self._rows = module.IS().createGeneral(self._numbers, comm=self._comm)
        self._own = module.Vec().createWithArray(self._values, comm=module.COMM_SELF)
        self._held = [self._rows, self._own]
        if not self.communicator.is_idle:
            self._right = module.Vec().createMPI(self._size, comm=self._comm)
            self._solution = self._right.duplicate()
            self._scatter = module.Scatter().create(self._own, None, self._right, self._rows)
            self._held += [self._right, self._solution, self._scatter]

    def factorise(self, local: sp.csr_matrix) -> None:
        """Factorise the sum of the ranks' matrices.  Raises SingularError on every rank if it is singular."""
        with self.communicator.together(SingularError):
            if self.communicator.is_idle:
                return
            self.forget()  # freed first, because a run takes the most memory if it holds two factorisations
            matrix, failure = self._matrix(0.5 * (local + local.T) if self.symmetric else local), None
            if self._solving is not None:
                failure = self._set_up(matrix)
            if self._on_one:
                failure = self._comm.bcast(failure)
            if failure is not None:
                raise self._refused(failure)
            try:
                self.solve(np.zeros(self.exchange.count))
            except PETScError as error:  # PETSc finds a zero pivot only when it solves
                raise self._refused(error) from error

    def _refused(self, reason: object) -> SingularError:
        return SingularError(f"{self.method} cannot be used for the matrix ({reason})")

    def _matrix(self, local: sp.csr_matrix) -> Any:
        """Sum of the ranks' matrices in free rows and columns, as AIJ; None on a rank without rows."""
        module, (mine, count) = petsc(), self._size
        free = local[self._free][:, self._free].tocoo()
        rows, columns, data, first = self._numbers[free.row], self._numbers[free.col], free.data, 0
        if self.exchange.is_distributed:
            rows, columns, data, first = self._of_owners(rows, columns, data)
        if self._solving is None:
            return None
        summed = sp.csr_matrix((data, (rows - first, columns)), shape=(mine, count))
        csr = summed.indptr.astype(module.IntType), summed.indices.astype(module.IntType), summed.data
        return module.Mat().createAIJ(size=(self._size, self._size), csr=csr, comm=self._solving)

    def _of_owners(self, *entries: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Rows, columns, values of this rank's rows, from all ranks in order, and the first row's number."""
        ends, this_rank = np.cumsum(self._comm.allgather(self._size[0])), self._comm.rank
        owner = np.searchsorted(ends, entries[0], side="right")
        # only neighbours own rows of shared unknowns; `rank - 1` counts the ranks with cells
        near = range(self._comm.size) if self._on_one else (rank - 1 for rank in self.exchange.neighbours)
        ranks = sorted({this_rank, *near})
        split = {rank: tuple(part[owner == rank] for part in entries) for rank in ranks}
        sent = [self._comm.isend(split[rank], rank) for rank in ranks if rank != this_rank]
        parts = [split[this_rank] if rank == this_rank else self._comm.recv(source=rank) for rank in ranks]
        for request in sent:
            request.wait()
        rows, columns, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows, columns, data, int(ends[this_rank] - self._size[0])

    def _set_up(self, matrix: Any) -> str | None:
        """Make a solver with the matrix.  Return the reason for a failure, or None."""
        module = petsc()
        self._solver = module.KSP().create(comm=self._solving)
        self._solver.setOperators(matrix)
        self._solver.setType("preonly")
        preconditioner, resources = self._solver.getPC(), []
        if self.method == "mumps":
            preconditioner.setType("lu")
            preconditioner.setFactorSolverType("mumps")
        elif not _may_be_definite(matrix):
            return "the matrix is not positive definite"
        else:
            preconditioner.setType(self.method)
            if self.kernel is not None:
                resources = [self._vector(matrix, vector) for vector in self.kernel]
                resources.append(module.NullSpace().create(vectors=resources, comm=self._comm))
                matrix.setNearNullSpace(resources[-1])
        for resource in (*resources, preconditioner, matrix):  # the solver keeps references to these objects
            resource.destroy()
        try:
            self._solver.setUp()
        except module.Error as error:
            return str(error)
        return None

    def _vector(self, matrix: Any, values: np.ndarray) -> Any:
        """PETSc vector of unit norm with the free entries of the summed ``values``."""
        module = petsc()
        vector = matrix.createVecs()[0]
        local = module.Vec().createWithArray(np.ascontiguousarray(values[self._free]), comm=module.COMM_SELF)
        scatter = module.Scatter().create(local, None, vector, self._rows)
        scatter.scatter(local, vector, addv=module.InsertMode.INSERT)
        scatter.destroy()
        local.destroy()
        vector.normalize()
        return vector

    def forget(self) -> None:
        """Free the last factorisation's memory; collective."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def release(self) -> None:
        """Destroy the PETSc objects, to be called before another inverse is made; collective."""
        self.forget()
        for resource in self._held:
            resource.destroy()

    def __call__(self, r: np.ndarray) -> np.ndarray:
        """Solve for a summed right-hand side; collective."""
        return self.of_parts(np.where(self.exchange.owned, r, 0.0))

    def of_parts(self, rows: np.ndarray) -> np.ndarray:
        """Solve for a right-hand side in parts.  If the solver fails on several ranks, the result is NaN and
        the reason is noted (``Communicator.noted``)."""
        if self.communicator.is_idle:
            return np.zeros_like(rows)
        try:
            return self.solve(rows)
        except PETScError as error:
            if not self.communicator.is_distributed:
                raise self._refused(error) from error
            self.communicator.note(f"{self.method}: {error}")  # the first rank sees NaN in its products
            return np.full_like(rows, np.nan)

    def solve(self, rows: np.ndarray) -> np.ndarray:
        """Solve for ``rows`` on ranks with cells.  Raises PETScError if there is no solution."""
        module = petsc()
        self._values[:] = rows[self._free]
        self._right.set(0.0)
        self._scatter.scatter(self._own, self._right, addv=module.InsertMode.ADD)
        failure = None if self._solving is None else self._failure()
        if self._on_one:
            failure = self._comm.bcast(failure)
        if failure is not None:
            raise PETScError(f"PETSc did not solve a linear system ({failure})")
        reverse = {"addv": module.InsertMode.INSERT, "mode": module.ScatterMode.REVERSE}
        self._scatter.scatter(self._solution, self._own, **reverse)
        result = np.zeros(len(rows))
        result[self._free] = self._values
        return result

    def _failure(self) -> str | None:
        """Solve with the current right-hand side.  Return the reason for a failure, or None."""
        module, vectors = petsc(), (self._right, self._solution)
        sequential = [
            module.Vec().createWithArray(vector.getArray(), comm=module.COMM_SELF)
            for vector in vectors
            if self._on_one  # KSP on one rank needs sequential vectors, which share the memory
        ]
        try:
            self._solver.solve(*(sequential or vectors))
        except module.Error as error:
            return str(error)
        finally:
            for vector in sequential:
                vector.destroy()
        return _reason(self._solver) if self._solver.getConvergedReason() < 0 else None


def _may_be_definite(matrix: Any) -> bool:
    """Whether all entries are finite and the diagonal is positive; collective.  Multigrid's smoothers divide
    by the diagonal, and a zero there would end the process."""
    diagonal = matrix.getDiagonal()
    diagonal.setArray(diagonal.getArray() > 0)
    return bool(np.isfinite(matrix.norm())) and diagonal.min()[1] > 0


def _reason(solver: Any) -> str:
    """Reason why a PETSc solver failed, in PETSc's names; for MUMPS with its INFOG numbers."""
    number, names = solver.getConvergedReason(), vars(petsc().KSP.ConvergedReason)
    name = next((name for name, value in names.items() if value == number), f"reason {number}")
    preconditioner = solver.getPC()
    how = f"{name} by {preconditioner.getType()}"
    if preconditioner.getType() == "lu":
        matrix = preconditioner.getFactorMatrix()
        numbers = [f"INFOG({i}) = {matrix.getMumpsInfog(i)}" for i in (1, 2)]
        how = f"{name}, MUMPS's {', '.join(numbers)}"
        matrix.destroy()
    preconditioner.destroy()
    return how


class PETScInverse(BaseMatrix):
    """``SumInverse`` of an assembled NGSolve matrix, as an NGSolve matrix."""

    def __init__(self, matrix: BaseMatrix, free: BitArray, communicator: Communicator) -> None:
        super().__init__()
        self.matrix = matrix
        exchange = Exchange.of_dofs(matrix.row_pardofs, matrix.local_mat.height, communicator)
        self._inverse = SumInverse(np.array(list(free), dtype=bool), exchange)
        self.Update()

    def Update(self) -> None:
        """Factorise the changed matrix again, as NGSolve's inverses do."""
        local = self.matrix.local_mat  # contributions of this rank's cells
        csr = tuple(np.array(part) for part in local.CSR())
        self._inverse.factorise(sp.csr_matrix(csr, shape=(local.height, local.width)))

    def release(self) -> None:
        """Release PETSc's objects, as ``SumInverse`` does."""
        self._inverse.release()

    def Mult(self, rows: BaseVector, unknowns: BaseVector) -> None:
        """Set ``unknowns`` to matrix^{-1} ``rows``, and to 0 in constrained unknowns; collective."""
        rows.Distribute()
        solution = self._inverse.of_parts(rows.FV().NumPy())
        unknowns.SetParallelStatus(PARALLEL_STATUS.CUMULATED)
        unknowns.FV().NumPy()[:] = solution

    def Shape(self) -> Any:
        return self.matrix.shape

    def CreateVector(self, col: bool) -> BaseVector:
        return self.matrix.CreateVector(not col)


def inverse_of(matrix: BaseMatrix, free: BitArray, communicator: Communicator) -> BaseMatrix:
    """Inverse of a symmetric positive definite matrix in the free unknowns."""
    if communicator.is_distributed:
        return PETScInverse(matrix, free, communicator)
    return matrix.Inverse(free, inverse="sparsecholesky")


def release(inverse: BaseMatrix) -> None:
    """Free the memory of an inverse that ``inverse_of`` made; collective."""
    if isinstance(inverse, PETScInverse):
        inverse.release()

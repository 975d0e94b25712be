"""Direct solution with a matrix of scipy's by factorisations."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from ngsolve.la import SparseMatrixd
from scipy.sparse.linalg import eigsh, splu

from ngvisco.algebra import precision
from ngvisco.errors import StepError
from ngvisco.parallel.exchange import Exchange, Owned
from ngvisco.parallel.petsc import SumInverse

MANY = 100
"""Unknowns from which an eigenvalue is found by iteration."""


class Direct(Protocol):
    """What solves with a matrix on some of its unknowns, and gives others 0."""

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Raises StepError if the matrix is singular."""

    def __call__(self, r: np.ndarray) -> np.ndarray: ...

    def release(self) -> None:
        """Give its memory back; over ranks collective."""


class MakesDirect(Protocol):
    """Makes a solver for the free unknowns; of the matrix's symmetric part where that is said."""

    def __call__(self, free: np.ndarray, *, symmetric: bool) -> Direct: ...


_NEAR_SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.01,
    "options": {"SymmetricMode": True},
}
"""For matrices with entries in symmetric places.  By the default order, for any, a step with delta_density on
2,639 tetrahedra took 4.5 times as long, in half as much memory again."""


_Solve = Callable[[np.ndarray], np.ndarray]

_ENOUGH = 1e-3
"""What factors in single precision may leave of a right side drawn at random."""


def _in_single(matrix: sp.csr_matrix) -> _Solve | None:
    """What solves with factors in single precision, in units of the diagonal; None where that does not."""
    diagonal = abs(matrix.diagonal())
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = (sp.diags(unit) @ matrix @ sp.diags(unit)).tocsc()
    try:
        factors = splu(scaled.astype(precision.SINGLE), **_NEAR_SYMMETRIC)
    except RuntimeError:
        return None

    def solve(r: np.ndarray) -> np.ndarray:
        r = unit * r
        length = abs(r).max() or 1.0
        return length * unit * factors.solve((r / length).astype(precision.SINGLE))

    right = np.random.default_rng(0).standard_normal(len(unit))
    left = right - unit * (matrix @ solve(right / unit))
    return solve if np.linalg.norm(left) <= _ENOUGH * np.linalg.norm(right) else None


class DirectSolver:
    """The factorised matrix on its free unknowns; the others get 0.

    Factors of a preconditioner are in single precision where that does, in units of the diagonal: half of the
    time and the memory.
    """

    def __init__(self, free: np.ndarray, symmetric: bool = False, approximate: bool = False) -> None:
        """``free`` is a mask of unknowns; of the matrix's symmetric part where that is said."""
        self.free, self.symmetric, self.approximate = np.flatnonzero(free), symmetric, approximate
        self._solve: _Solve | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Raises StepError if the matrix is singular."""
        matrix = matrix[self.free][:, self.free]
        self._solve = None
        if not len(self.free):
            return
        try:
            if self.symmetric:
                matrix = 0.5 * (matrix + matrix.T)
            if self.approximate:
                self._solve = _in_single(matrix)
            if self._solve is None:
                self._solve = splu(matrix.tocsc(), **_NEAR_SYMMETRIC).solve
        except RuntimeError as error:  # of SuperLU
            raise StepError(f"a matrix of the step has no factorisation: {error}") from error

    def __call__(self, r: np.ndarray) -> np.ndarray:
        result = np.zeros_like(r)
        if self._solve is not None:
            result[self.free] = self._solve(r[self.free])
        return result

    def release(self) -> None:
        """Drop the factorisation."""
        self._solve = None


def direct_solver(free: np.ndarray, exchange: Owned, *, symmetric: bool = False) -> DirectSolver | SumInverse:
    """By SuperLU on one process; over ranks by PETSc, of matrices in parts.

    With ``symmetric`` what solves is a preconditioner, on one process in single precision where that does.
    """
    if exchange.is_distributed:
        return SumInverse(free, exchange, symmetric)
    return DirectSolver(free, symmetric, approximate=symmetric)


class Fallback:
    """A solver, and in its place another one for matrices that it does not take."""

    def __init__(
        self,
        first: MakesDirect,
        other: MakesDirect,
        say: Callable[[str], None],
        free: np.ndarray,
        *,
        symmetric: bool,
    ) -> None:
        """``say`` is told once why the other one, which is made where it is needed, has to solve."""
        self.first = self._present = first(free, symmetric=symmetric)
        self._make_other, self._say = partial(other, free, symmetric=symmetric), say
        self._other: Direct | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Raises StepError if the matrix is singular."""
        try:
            self.first.factorise(matrix)
            self._present = self.first
        except StepError as error:
            is_new = self._other is None
            self._other = self._present = self._other or self._make_other()
            self._other.factorise(matrix)
            if is_new:
                self._say(str(error))

    def __call__(self, r: np.ndarray) -> np.ndarray:
        return self._present(r)

    def release(self) -> None:
        """Give back the memory of both; over ranks collective."""
        self.first.release()
        if self._other is not None:
            self._other.release()


SWEEPS, DAMPING = 2, 1.65
"""Of Jacobi before and after the coarse problem, and their damping in units of 1/(largest eigenvalue of
D^{-1} A), below 2; the eigenvalue depends on the mesh."""


class TwoLevelSolver:
    """An approximate inverse for large meshes: vertices solved as a whole, all other functions smoothed.

    NGSolve's functions of degree two and more vanish at vertices, so that the coefficients of vertices
    are the P_1 functions; their block is the coarse problem, factorised.  The others, of edges and faces,
    make well-conditioned blocks with inertia and with viscosity (the hierarchical splitting), and get damped
    Jacobi sweeps before and after.  Unknowns beside the velocity - stresses of walls, creep rates - belong
    to the coarse problem, with the velocities that they are coupled to: those of the walls.  Where the
    fourth-order term dominates at the mesh's scale the iterations that it takes grow.
    """

    def __init__(
        self,
        free: np.ndarray,
        vertices: np.ndarray,
        others: np.ndarray,
        direct: MakesDirect,
        exchange: Exchange,
        *,
        dropped: float = 1e-2,
    ) -> None:
        """Masks of unknowns: ``free`` ones, velocities at ``vertices``, and ``others`` than velocities.

        ``direct`` makes the solver of the coarse problem from a mask and whether the matrix is to be made
        symmetric; ``exchange`` is that of the unknowns: over ranks matrices are in parts.
        Entries smaller than ``dropped`` of the diagonal are left out of the sweeps: two thirds, for a
        hundredth more of GMRES's iterations.
        """
        self.free, self.vertices, self.others = free, vertices, others
        self.direct, self.exchange = direct, exchange
        self.dropped = dropped
        self.coarse: Direct | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Raises StepError if the coarse block is singular."""
        matrix = matrix.tocsr()
        is_coarse = self.vertices | self.others
        exchange = self.exchange
        beside = exchange.communicator.any(self.others.any())
        if beside:
            is_coarse[matrix[self.others].indices] = True
            is_coarse = exchange.sum(is_coarse.astype(float)) > 0
        self.release()
        self.coarse = self.direct(self.free & is_coarse, symmetric=not beside)
        self.coarse.factorise(matrix)
        own_diagonal = matrix.diagonal()
        diagonal = exchange.sum(own_diagonal)
        self._fine = np.flatnonzero(self.free & ~is_coarse & (diagonal != 0))
        self._coarse = np.flatnonzero(self.free & is_coarse)
        rows, columns = matrix[self._fine], matrix[:, self._fine].tocsr()
        self._of_fine, self._of_coarse = (exchange.part(own) for own in (self._fine, self._coarse))
        own = _without_small(rows[:, self._fine], diagonal[self._fine], self.dropped)
        between = rows[:, self._coarse].tocsr(), columns[self._coarse].tocsr()
        self._own, self._from_coarse, self._to_coarse = (m.astype(precision.SINGLE) for m in (own, *between))
        # a sum of matrices has no larger one than the largest of these, each in its own diagonal's units
        largest = exchange.communicator.most(largest_eigenvalue(own))
        smoother = DAMPING / (largest * diagonal[self._fine])
        self._smoother = smoother.astype(precision.SINGLE)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        assert self.coarse is not None
        r_fine = r[self._fine].astype(precision.SINGLE)
        x = self._smoothed(r_fine)
        r_coarse = r.copy()
        r_coarse[self._coarse] -= self._of_coarse.sum(self._to_coarse @ x)
        result = self.coarse(r_coarse)
        change = self._own @ x + self._from_coarse @ result[self._coarse].astype(precision.SINGLE)
        r_fine -= self._of_fine.sum(change)
        result[self._fine] = x + self._smoothed(r_fine)
        return result

    def release(self) -> None:
        """Give back the memory of the coarse factorisation."""
        if self.coarse is not None:
            self.coarse.release()

    def _smoothed(self, r: np.ndarray) -> np.ndarray:
        """Sweeps from zero with the fine functions' residual ``r``."""
        x = self._smoother * r
        for _ in range(SWEEPS - 1):
            x += self._smoother * (r - self._of_fine.sum(self._own @ x))
        return x


def _without_small(matrix: sp.csr_matrix, diagonal: np.ndarray, share: float) -> sp.csr_matrix:
    """The matrix without entries of less than ``share`` of their diagonals' geometric mean."""
    size, m = np.sqrt(abs(diagonal)), matrix.tocoo()
    kept = abs(m.data) >= share * size[m.row] * size[m.col]
    return sp.csr_matrix((m.data[kept], (m.row[kept], m.col[kept])), shape=m.shape)


def largest_eigenvalue(matrix: sp.csr_matrix) -> float:
    """Of D^{-1} (A + A^T)/2, D the diagonal of A, to a few per cent and not far below it."""
    scale = sp.diags(1 / np.sqrt(abs(matrix.diagonal())))
    scaled = scale @ (0.5 * (matrix + matrix.T)) @ scale
    if scaled.shape[0] < MANY:
        return float(np.linalg.eigvalsh(scaled.toarray()).max(initial=1.0))
    start = np.random.default_rng(0).standard_normal(scaled.shape[0])
    return float(eigsh(scaled, k=1, which="LA", v0=start, tol=0.02, return_eigenvectors=False)[0])


@cache
def is_available(inverse: str) -> bool:
    """Whether NGSolve, as it is installed, has this sparse direct solver: found by asking it for one."""
    if inverse == "umfpack":
        return True
    try:
        SparseMatrixd.CreateFromCOO([0, 1], [0, 1], [1.0, 1.0], 2, 2).Inverse(inverse=inverse)
    except Exception:  # NGSolve raises NgException and RuntimeError
        return False
    return True

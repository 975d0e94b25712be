"""Direct solution with a matrix of scipy's by factorisations."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh, splu

from ngvisco.algebra import precision
from ngvisco.errors import StepError
from ngvisco.parallel.exchange import Exchange, Owned
from ngvisco.parallel.petsc import SumInverse

MANY = 100
"""Unknowns from which an eigenvalue is found by iteration."""

_NEAR_SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.01,
    "options": {"SymmetricMode": True},
}
"""For matrices with entries in symmetric places."""

_ENOUGH = 1e-3
"""Largest residual, relative to a right side drawn at random, with which factors in single precision are
accepted."""

SWEEPS, DAMPING = 2, 1.65
"""Jacobi sweeps before and after the coarse problem, and their damping in units of 1/(largest eigenvalue of
D^{-1} A), below 2; the eigenvalue depends on the mesh."""


class Direct(Protocol):
    """A solver of a matrix on some of its unknowns, which sets the others to 0."""

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Raises StepError if the matrix is singular."""

    def __call__(self, r: np.ndarray) -> np.ndarray: ...

    def release(self) -> None:
        """Give its memory back; over ranks collective."""


Factorising = Callable[[np.ndarray, sp.csr_matrix, bool], Direct]
"""Makes what solves with a matrix on a mask of unknowns; of its symmetric part where that is said."""


class DirectSolver:
    """The factorised matrix on its free unknowns; the others get 0.

    Parameters
    ----------
    free : (unknowns,) array of bool
    symmetric : bool
        Take the matrix's symmetric part.
    approximate : bool
        For a preconditioner: factors in single precision where that does, half of the time and the memory.
    """

    def __init__(self, free: np.ndarray, symmetric: bool = False, approximate: bool = False) -> None:
        self.free, self.symmetric, self.approximate = np.flatnonzero(free), symmetric, approximate
        self._solve: Callable[[np.ndarray], np.ndarray] | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        self._solve = None
        if not len(self.free):
            return
        matrix = matrix[self.free][:, self.free]
        if self.symmetric:
            matrix = 0.5 * (matrix + matrix.T)
        try:
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
        self._solve = None


def _in_single(matrix: sp.csr_matrix) -> Callable[[np.ndarray], np.ndarray] | None:
    """A solver by factors in single precision, in units of the diagonal; None where these are not accurate
    enough."""
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


def direct_solver(free: np.ndarray, exchange: Owned, symmetric: bool = False) -> DirectSolver | SumInverse:
    """A direct solver: SuperLU on one process, PETSc over ranks, for matrices in parts.

    With ``symmetric`` what solves is a preconditioner, on one process in single precision where that does.
    """
    if exchange.is_distributed:
        return SumInverse(free, exchange, symmetric)
    return DirectSolver(free, symmetric, approximate=symmetric)


class TwoLevelSolver:
    """An approximate inverse for large meshes: vertices solved as a whole, all other functions smoothed.

    NGSolve's functions of degree two and more vanish at vertices, so that the coefficients of vertices
    are the P_1 functions; their block is the coarse problem, factorised.  The others, of edges and faces,
    make well-conditioned blocks with inertia and with viscosity (the hierarchical splitting), and get damped
    Jacobi sweeps before and after.  Unknowns beside the velocity - stresses of walls, creep rates - belong
    to the coarse problem, with the velocities that they are coupled to: those of the walls.  Where the
    fourth-order term dominates at the mesh's scale the iterations that it takes grow.

    Parameters
    ----------
    free, vertices, others : (unknowns,) arrays of bool
        Free ones, velocities at vertices, and others than velocities.
    factorised : callable
        Makes the solver of the coarse problem.
    exchange : Exchange
        Of the unknowns; over ranks matrices are in parts.
    dropped : float
        Entries smaller than this share of the diagonal are left out of the sweeps: two thirds, for a
        hundredth more of GMRES's iterations.
    """

    def __init__(
        self,
        free: np.ndarray,
        vertices: np.ndarray,
        others: np.ndarray,
        factorised: Factorising,
        exchange: Exchange,
        *,
        dropped: float = 1e-2,
    ) -> None:
        self.free, self.vertices, self.others = free, vertices, others
        self.factorised, self.exchange, self.dropped = factorised, exchange, dropped
        self.coarse: Direct | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        matrix, exchange = matrix.tocsr(), self.exchange
        is_coarse = self.vertices | self.others
        beside = exchange.communicator.any(self.others.any())
        if beside:
            is_coarse[matrix[self.others].indices] = True
            is_coarse = exchange.sum(is_coarse.astype(float)) > 0
        self.release()
        self.coarse = self.factorised(self.free & is_coarse, matrix, not beside)
        diagonal = exchange.sum(matrix.diagonal())
        fine = self._fine = np.flatnonzero(self.free & ~is_coarse & (diagonal != 0))
        coarse = self._coarse = np.flatnonzero(self.free & is_coarse)
        self._of_fine, self._of_coarse = exchange.part(fine), exchange.part(coarse)
        rows = matrix[fine]
        own = _without_small(rows[:, fine], diagonal[fine], self.dropped)
        self._own = own.astype(precision.SINGLE)
        self._from_coarse = rows[:, coarse].tocsr().astype(precision.SINGLE)
        self._to_coarse = matrix[coarse][:, fine].tocsr().astype(precision.SINGLE)
        # a sum of matrices has no larger one than the largest of these, each in its own diagonal's units
        largest = exchange.communicator.most(largest_eigenvalue(own))
        self._smoother = (DAMPING / (largest * diagonal[fine])).astype(precision.SINGLE)

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
    """The largest eigenvalue of D^{-1} (A + A^T)/2, D the diagonal of A, to a few per cent and not far below
    it."""
    scale = sp.diags(1 / np.sqrt(abs(matrix.diagonal())))
    scaled = scale @ (0.5 * (matrix + matrix.T)) @ scale
    if scaled.shape[0] < MANY:
        return float(np.linalg.eigvalsh(scaled.toarray()).max(initial=1.0))
    start = np.random.default_rng(0).standard_normal(scaled.shape[0])
    return float(eigsh(scaled, k=1, which="LA", v0=start, tol=0.02, return_eigenvectors=False)[0])

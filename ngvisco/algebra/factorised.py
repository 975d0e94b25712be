"""Solution of systems with SciPy's sparse matrices by factorisation."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh, splu

from ngvisco.algebra import precision
from ngvisco.algebra.banded import LARGEST as LARGEST_BAND
from ngvisco.algebra.banded import Band
from ngvisco.errors import StepError
from ngvisco.parallel.exchange import Exchange, Owned
from ngvisco.parallel.petsc import SumInverse

MANY = 100
"""Least number of unknowns for which an eigenvalue is computed by iteration."""

_NEAR_SYMMETRIC: dict[str, Any] = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.01,
    "options": {"SymmetricMode": True},
}
"""Options of SuperLU for matrices with a symmetric pattern."""

_ENOUGH = 1e-3
"""Factors in single precision are accepted if the relative residual for a random right-hand side is not above
this bound."""

DROPPED = 3e-2
"""Sweeps omit entries below this fraction of the diagonal: four fifths of all entries. GMRES takes no more
iterations than with all entries."""

_PARTS = 16
"""Number of parts into which the rows of fine functions are divided. Entries that are dropped take memory
only while their part is formed."""

SWEEPS, SMOOTHED = 3, 8.0
"""Degree of the Chebyshev polynomial that smooths before and after the coarse problem, and the ratio of the
largest eigenvalue of D^{-1} A to the least one that the polynomial reduces."""


class Direct(Protocol):
    """A solver for some unknowns of a matrix, which sets the other unknowns to 0."""

    def factorise(self, matrix: sp.csr_matrix) -> None:
        """Factorise a matrix.  Raises StepError if the matrix is singular."""

    def __call__(self, r: np.ndarray) -> np.ndarray: ...

    def forget(self) -> None:
        """Free the last factorisation's memory; collective over ranks."""

    def release(self) -> None:
        """Free the solver's memory; collective over ranks."""


Factorising = Callable[[np.ndarray, sp.csr_matrix, bool], Direct]
"""Function (mask of unknowns, matrix, whether to take its symmetric part) that returns a solver."""


class DirectSolver:
    """A direct solver for the unknowns that the mask ``free`` marks; other unknowns are set to 0.

    If ``symmetric`` is True, the solver takes the matrix's symmetric part.  If ``approximate`` is True, the
    solver uses factors in single precision where these are accurate enough; such factors take half of the
    time and the memory.
    """

    def __init__(self, free: np.ndarray, symmetric: bool = False, approximate: bool = False) -> None:
        self.free, self.symmetric, self.approximate = np.flatnonzero(free), symmetric, approximate
        self._solve: Callable[[np.ndarray], np.ndarray] | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        self._solve = None
        if not len(self.free):
            return
        matrix = matrix[self.free][:, self.free].astype(float, copy=False)
        if self.symmetric:
            matrix = 0.5 * (matrix + matrix.T)
        try:
            if self.approximate:
                self._solve = _in_single(matrix)
            if self._solve is None:
                self._solve = splu(matrix.tocsc(), **_NEAR_SYMMETRIC).solve
        except RuntimeError as error:  # raised by SuperLU
            raise StepError(f"a matrix of the step has no factorisation: {error}") from error

    def __call__(self, r: np.ndarray) -> np.ndarray:
        result = np.zeros_like(r)
        if self._solve is not None:
            result[self.free] = self._solve(r[self.free])
        return result

    def forget(self) -> None:
        self._solve = None

    release = forget


def _in_single(matrix: sp.csr_matrix) -> Callable[[np.ndarray], np.ndarray] | None:
    """Factorise a symmetric matrix in single precision, scaled by the diagonal.  Return a solver, or None if
    the factors are not accurate enough."""
    diagonal = abs(matrix.diagonal())
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled = matrix.tocsr().copy()
    scaled.data *= np.repeat(unit, np.diff(scaled.indptr)) * unit[scaled.indices]
    factors: Any = Band(scaled)
    if factors.entries > LARGEST_BAND:
        try:
            factors = splu(scaled.astype(precision.SINGLE).tocsc(), **_NEAR_SYMMETRIC)
        except RuntimeError:
            return None
    elif not factors.factorise(precision.SINGLE):
        return None
    del scaled

    def solve(r: np.ndarray) -> np.ndarray:
        r = unit * r
        length = abs(r).max() or 1.0
        return length * unit * factors.solve((r / length).astype(precision.SINGLE))

    right = np.random.default_rng(0).standard_normal(len(unit))
    left = right - unit * (matrix @ solve(right / unit))
    return solve if np.linalg.norm(left) <= _ENOUGH * np.linalg.norm(right) else None


def direct_solver(free: np.ndarray, exchange: Owned, symmetric: bool = False) -> DirectSolver | SumInverse:
    """A direct solver: SuperLU on one process, PETSc over ranks.

    Over ranks the matrix is the sum of the ranks' parts.

    If ``symmetric`` is True, the solver takes the matrix's symmetric part and serves as a preconditioner; on
    one process it then uses factors in single precision where they are accurate enough.
    """
    if exchange.is_distributed:
        return SumInverse(free, exchange, symmetric)
    return DirectSolver(free, symmetric, approximate=symmetric)


class TwoLevelSolver:
    """An approximate inverse for large meshes, which solves for vertices and smooths all other functions.

    NGSolve's functions of degree two and more vanish at vertices, so that the coefficients of vertices belong
    to P_1 functions.  The block of the vertices is the coarse problem, which is factorised.  The block of the
    functions of edges and faces is well-conditioned, both with inertia and with viscosity (the hierarchical
    splitting).  Sweeps by Chebyshev's polynomial smooth these functions before and after the coarse problem.
    The coarse problem also has the unknowns other than velocities (stresses of walls, creep rates), and the
    velocities coupled to these unknowns.  GMRES takes more iterations if the fourth-order term dominates at
    the mesh's scale.

    ``free``, ``vertices`` and ``beside_velocity`` are masks of the free unknowns, of the velocities at
    vertices, and of the unknowns other than velocities.  ``factorised`` makes the solver of the coarse
    problem.  Over ranks a matrix is the sum of the ranks' parts.
    """

    def __init__(
        self,
        free: np.ndarray,
        vertices: np.ndarray,
        beside_velocity: np.ndarray,
        factorised: Factorising,
        exchange: Exchange,
    ) -> None:
        self.free, self.vertices, self.beside_velocity = free, vertices, beside_velocity
        self.factorised, self.exchange = factorised, exchange
        self.coarse: Direct | None = None

    def factorise(self, matrix: sp.csr_matrix) -> None:
        matrix, exchange = matrix.tocsr(), self.exchange
        is_coarse = self.vertices | self.beside_velocity
        beside = exchange.communicator.any(self.beside_velocity.any())
        if beside:
            is_coarse[matrix[self.beside_velocity].indices] = True
            is_coarse = exchange.sum(is_coarse.astype(float)) > 0
        self.forget()
        self.coarse = self.factorised(self.free & is_coarse, matrix, not beside)
        diagonal = exchange.sum(matrix.diagonal())
        fine = self._fine = np.flatnonzero(self.free & ~is_coarse & (diagonal != 0))
        coarse = self._coarse = np.flatnonzero(self.free & is_coarse)
        self._of_fine, self._of_coarse = exchange.part(fine), exchange.part(coarse)
        self._to_coarse = matrix[coarse][:, fine].tocsr().astype(precision.SINGLE, copy=False)
        size, from_coarse, among_fine = np.sqrt(abs(diagonal[fine])), [], []
        for some in np.array_split(np.arange(len(fine)), _PARTS):
            rows = matrix[fine[some]]
            from_coarse.append(rows[:, coarse].tocsr().astype(precision.SINGLE, copy=False))
            among_fine.append(rows[:, fine].tocsr())
            _drop_small(among_fine[-1], size[some], size)
        del matrix, rows
        self._from_coarse = sp.vstack(from_coarse, format="csr")
        all_fine = sp.vstack(among_fine, format="csr")
        del from_coarse, among_fine
        self._among_fine = all_fine.astype(precision.SINGLE, copy=False)
        # if each matrix is scaled by its own diagonal, the largest eigenvalue of a sum is no larger than
        # those of the summands
        middle = 0.5 * exchange.communicator.most(largest_eigenvalue(all_fine)) * (1 + 1 / SMOOTHED)
        self._smoother = (1 / (middle * diagonal[fine])).astype(precision.SINGLE)

    def __call__(self, r: np.ndarray) -> np.ndarray:
        assert self.coarse is not None
        r_fine = r[self._fine].astype(precision.SINGLE)
        x = self._smoothed(r_fine)
        r_coarse = r.copy()
        r_coarse[self._coarse] -= self._of_coarse.sum(self._to_coarse @ x)
        result = self.coarse(r_coarse)
        change = self._among_fine @ x + self._from_coarse @ result[self._coarse].astype(precision.SINGLE)
        r_fine -= self._of_fine.sum(change)
        result[self._fine] = x + self._smoothed(r_fine)
        return result

    def forget(self) -> None:
        if self.coarse is not None:
            self.coarse.release()
        self.coarse = None
        self._to_coarse = self._from_coarse = self._among_fine = sp.csr_matrix((0, 0))

    release = forget

    def _smoothed(self, r: np.ndarray) -> np.ndarray:
        """Correction of the fine functions for their residual ``r``, by sweeps that start at zero."""
        x = step = self._smoother * r
        # half of the range of the eigenvalues, divided by the middle of the range
        ratio = half = (SMOOTHED - 1) / (SMOOTHED + 1)
        for _ in range(SWEEPS - 1):
            last, ratio = ratio, 1 / (2 / half - ratio)
            remaining = r - self._of_fine.sum(self._among_fine @ x)
            step = ratio * (last * step + (2 / half) * (self._smoother * remaining))
            x = x + step
        return x


def _drop_small(matrix: sp.csr_matrix, of_rows: np.ndarray, of_columns: np.ndarray) -> None:
    """Remove, in place, entries below ``DROPPED`` times the product of the sizes of their row and column. The
    size of a row or column is the square root of its diagonal entry."""
    bound = np.repeat(DROPPED * of_rows, np.diff(matrix.indptr))
    bound *= of_columns[matrix.indices]
    matrix.data[abs(matrix.data) < bound] = 0.0
    matrix.eliminate_zeros()


def largest_eigenvalue(matrix: sp.csr_matrix) -> float:
    """Largest eigenvalue of D^{-1} (A + A^T)/2, where D is the diagonal of A, to a few per cent.

    A row of zeros counts as an eigenvalue of zero: a rank may share an unknown that none of its cells has.
    """
    diagonal = abs(matrix.diagonal())
    scale = sp.diags(np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0))
    scaled = scale @ (0.5 * (matrix + matrix.T)) @ scale
    if scaled.shape[0] < MANY:
        return float(np.linalg.eigvalsh(scaled.toarray()).max(initial=1.0))
    start = np.random.default_rng(0).standard_normal(scaled.shape[0])
    return float(eigsh(scaled, k=1, which="LA", v0=start, tol=0.02, return_eigenvectors=False)[0])

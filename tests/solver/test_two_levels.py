"""The smoother of the two-level solver, and the facets of which the flow's operator takes notice."""

import numpy as np
import pytest
import scipy.sparse as sp

from ngvisco.algebra import factorised
from ngvisco.algebra.factorised import DAMPING, MANY, DirectSolver, TwoLevelSolver, largest_eigenvalue
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange


@pytest.mark.parametrize("size", [MANY // 2, 5 * MANY])
def test_one_cell_s_eigenvalue_is_found_among_many(size):
    """Powers from a random vector would take it for that of the bulk, 2."""
    rng = np.random.default_rng(2)
    scale = np.exp(rng.standard_normal(size))
    A = sp.diags([np.full(size - 1, -0.5), np.ones(size), np.full(size - 1, -0.5)], [-1, 0, 1]).tolil()
    for i in range(4):  # a block of larger coupling: its eigenvalue is 1 + 3 * 0.9
        for j in range(4):
            A[20 + i, 20 + j] = 1.0 if i == j else 0.9
    A = (sp.diags(scale) @ A.tocsr() @ sp.diags(scale)).tocsr()
    D = np.sqrt(A.diagonal())
    exact = np.linalg.eigvalsh(A.toarray() / np.outer(D, D)).max()
    assert exact > 3.7
    assert largest_eigenvalue(A) == pytest.approx(exact, rel=0.03)


@pytest.mark.usefixtures("double_precision")
def test_two_levels_are_sweeps_around_a_coarse_solution():
    """The same by residuals of the whole matrix, where no entry is dropped."""
    rng = np.random.default_rng(4)
    n = 30
    B = rng.standard_normal((n, n))
    A = B @ B.T + n * np.eye(n)
    free, vertices, others = np.ones(n, dtype=bool), np.arange(n) < 10, np.zeros(n, dtype=bool)
    free[[3, 20]] = False

    def coarse_solver(free, matrix, symmetric):
        direct = DirectSolver(free, symmetric)
        direct.factorise(matrix)
        return direct

    exchange = Exchange(n, {}, Communicator())
    solver = TwoLevelSolver(free, vertices, others, coarse_solver, exchange, dropped=1e-300)
    solver.factorise(sp.csr_matrix(A))
    coarse, fine = np.flatnonzero(free & vertices), np.flatnonzero(free & ~vertices)
    own, r = A[np.ix_(fine, fine)], rng.standard_normal(n)
    scaled = own / np.sqrt(np.outer(np.diag(own), np.diag(own)))
    damping = DAMPING / np.linalg.eigvalsh(scaled).max()
    x = np.zeros(n)
    for stage in ("fine", "fine", "coarse", "fine", "fine"):
        left = r - A @ x
        if stage == "coarse":
            x[coarse] += np.linalg.solve(A[np.ix_(coarse, coarse)], left[coarse])
        else:
            x[fine] += damping * left[fine] / np.diag(own)
    assert solver(r) == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize(("shift", "sizes"), [(1e-2, [4]), (1e-7, [4, 8])], ids=["single", "double"])
@pytest.mark.parametrize("unit", [1e-50, 1.0, 1e50])
def test_factors_of_a_preconditioner_are_in_single_precision_where_that_does(shift, sizes, unit, monkeypatch):
    """In units that leave it, too; next to a singular matrix they are in double precision."""
    count, made, factorise = 50, [], factorised.splu

    def counted(matrix, **options):
        made.append(matrix.dtype.itemsize)
        return factorise(matrix, **options)

    monkeypatch.setattr(factorised, "splu", counted)
    A = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], (count, count)).tolil()
    A[0, 0] = A[-1, -1] = 1.0  # constants are in the kernel
    A = unit * (A + shift * sp.identity(count)).tocsr()
    solver = DirectSolver(np.ones(count, dtype=bool), symmetric=True, approximate=True)
    solver.factorise(A)
    right = np.random.default_rng(1).standard_normal(count)
    assert np.linalg.norm(A @ solver(right) - right) < 1e-3 * np.linalg.norm(right)
    assert made == sizes

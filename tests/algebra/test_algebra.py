"""Small solvers and sparse matrices: minimisation in a box, GMRES, and sums of element matrices."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import gmres as scipy_gmres

from ngvisco.algebra.box import minimise_in_box
from ngvisco.algebra.krylov import gmres
from ngvisco.algebra.sparse import ElementAssembly, beside, stacked
from ngvisco.errors import StepError


@pytest.mark.parametrize("seed", range(5))
def test_minimum_in_a_box_meets_the_optimality_conditions(seed):
    """The slope is zero where no bound is active, and has the bound's sign elsewhere; the drag depends on
    the sign of x."""
    rng, n = np.random.default_rng(seed), 30
    A = rng.standard_normal((n, n))
    H, f = A @ A.T + 0.01 * np.eye(n), 5 * rng.standard_normal(n)
    low, high = -rng.random(n) * (rng.random(n) > 0.3), rng.random(n) * (rng.random(n) > 0.3)
    drag = rng.random(n), 10 * rng.random(n)
    found = minimise_in_box(sp.csr_matrix(H), f, drag, low, high)
    x, slope = found.x, H @ found.x + f + np.where(found.x < 0, drag[1], drag[0]) * found.x
    assert (low <= x).all() and (x <= high).all()
    assert np.allclose(slope, found.slope, atol=1e-12)
    free = (low < x) & (x < high)
    assert 3 < free.sum() < n - 3 and abs(slope[free]).max() < 1e-11
    assert (slope[(x == low) & (x < high)] >= -1e-11).all()
    assert (slope[(x == high) & (x > low)] <= 1e-11).all()


def test_function_that_is_not_convex_is_refused():
    """Newton's step raises the function by much more than the rounding error of any BLAS kernel."""
    H, f, none = sp.diags([-1.0, 1.0]).tocsr(), np.array([-0.2, 0.1]), (np.zeros(2), np.zeros(2))
    with pytest.raises(StepError, match="not convex"):
        minimise_in_box(H, f, none, np.full(2, -9.0), np.full(2, 9.0))


def system(size=80):
    random = np.random.default_rng(0)
    matrix = np.diag(np.linspace(1, 3, size)) + 0.05 * random.standard_normal((size, size))
    return matrix, random.standard_normal(size)


@pytest.mark.parametrize(("rtol", "most"), [(1e-2, 40), (1e-8, 40), (1e-8, 5)])
def test_gmres_takes_the_same_directions_as_scipy(rtol, most):
    matrix, right = system()
    found, taken = gmres(matrix.__matmul__, right, rtol=rtol, directions=most)
    steps = []
    options = {"callback": steps.append, "callback_type": "pr_norm"}
    expected, _ = scipy_gmres(matrix, right, rtol=rtol, restart=most, maxiter=1, **options)
    assert taken == len(steps)
    assert np.linalg.norm(found - expected) <= 1e-10 * np.linalg.norm(expected)


def test_gmres_uses_the_inner_product_of_its_caller():
    """Unknowns that a vector contains twice, like the unknowns that ranks share, count once."""
    matrix, right = system()
    twice = np.concatenate([np.arange(len(right)), np.arange(10)])
    first = np.arange(len(twice)) < len(right)

    def products(several, one):
        return several[:, first] @ one[first]

    def operator(x):
        return (matrix @ x[first])[twice]

    found, taken = gmres(operator, right[twice], rtol=1e-8, directions=40, products=products)
    expected, alone = gmres(matrix.__matmul__, right, rtol=1e-8, directions=40)
    assert taken == alone and np.linalg.norm(found - expected[twice]) <= 1e-12 * np.linalg.norm(expected)


def test_gmres_ends_where_no_further_direction_exists():
    right = np.array([1.0, 2.0, 0.0])
    found, taken = gmres(lambda x: 2 * x, right, rtol=1e-12, directions=3)
    assert taken == 1 and np.allclose(found, right / 2)
    assert not gmres(lambda x: 2 * x, 0 * right, rtol=1e-12, directions=3)[0].any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_gmres_gives_nan_for_numbers_that_are_not_finite(bad):
    """Numbers that are not finite are in the right-hand side, or in a product."""
    right = np.ones(3)
    assert np.isnan(gmres(lambda x: x, bad * right, rtol=1e-2, directions=3)[0]).all()
    assert np.isnan(gmres(lambda x: bad * x, right, rtol=1e-2, directions=3)[0]).all()


def test_stacked_matrices_equal_those_of_scipy():
    blocks = [sp.random(7, n, 0.4, "csr", random_state=n) for n in (3, 5, 4)]
    row, expected = beside(blocks), sp.hstack(blocks, format="csr")
    parts = [row, 2 * row, row[:0]]
    both = stacked(parts)
    assert not parts
    for matrix, of_scipy in ((row, expected), (both, sp.vstack([expected, 2 * expected], format="csr"))):
        assert matrix.shape == of_scipy.shape
        for name in ("data", "indices", "indptr"):
            assert np.array_equal(getattr(matrix, name), getattr(of_scipy, name))


def test_element_matrices_are_summed_in_their_order(monkeypatch):
    """Chunks of positions have no effect on the bits of the sums."""
    random = np.random.default_rng(0)
    unknowns, elements = random.integers(0, 9, (20, 3)), random.standard_normal((20, 3, 3))
    rows, columns = (
        np.broadcast_to(places, elements.shape) for places in (unknowns[:, :, None], unknowns[:, None])
    )
    expected = np.zeros((9, 9))
    np.add.at(expected, (rows.ravel(), columns.ravel()), elements.ravel())
    monkeypatch.setattr("ngvisco.algebra.sparse._AT_ONCE", 7)
    assert np.array_equal(ElementAssembly(unknowns, 9)(elements).toarray(), expected)

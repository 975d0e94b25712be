"""Dense blocks of cells against the sparse matrix that they are made of."""

import numpy as np
import pytest
import scipy.sparse as sp

from ngvisco.algebra.local import LocalMatrix

CELLS, ROWS, WIDTH, PARTS = 5, 3, 9, 2


@pytest.fixture(params=["shared unknowns", "unknowns cell by cell"])
def matrix(request):
    """Cells with 4, 3, 2 ... unknowns that they share, or with 2 of their own."""
    random = np.random.default_rng(1)
    blocks = []
    for cell in range(CELLS):
        if request.param == "shared unknowns":
            columns = random.choice(WIDTH, size=4 - cell % 3, replace=False)
        else:
            columns = np.array([2 * cell, 2 * cell + 1])
        block = np.zeros((ROWS, WIDTH if request.param == "shared unknowns" else 2 * CELLS))
        block[:, columns] = random.standard_normal((ROWS, len(columns)))
        blocks.append(block)
    return sp.csr_matrix(np.concatenate(blocks))


@pytest.fixture
def weights():
    return np.random.default_rng(2).random(CELLS * ROWS)


def values(count, dtype=float):
    random = np.random.default_rng(3)
    real = random.standard_normal((PARTS, count))
    return real + 1j * random.standard_normal((PARTS, count)) if dtype is complex else real


@pytest.mark.parametrize("dtype", [float, complex])
def test_values_and_tests_are_those_of_the_matrix(matrix, weights, dtype):
    local = LocalMatrix(matrix, CELLS, weights)
    x, y = values(matrix.shape[1], dtype), values(matrix.shape[0], dtype)
    assert local(x) == pytest.approx(x @ matrix.T, abs=1e-14)
    assert local.test(y) == pytest.approx((weights * y) @ matrix, abs=1e-14)


def test_columns_cell_by_cell_and_their_tests_without_weights(matrix, weights):
    local = LocalMatrix(matrix, CELLS, weights)
    columns = values(matrix.shape[1]).T
    by_cells = local.by_cells(columns)
    assert by_cells.swapaxes(1, 2).reshape(-1, PARTS) == pytest.approx(matrix @ columns, abs=1e-14)
    assert local.tested(by_cells) == pytest.approx(matrix.T @ (matrix @ columns), abs=1e-13)

"""Matrices of cells by the nodes of their pieces: products are those of the sparse matrix."""

import numpy as np
import pytest
import scipy.sparse as sp

from ngvisco.algebra.local import Functions, LocalMatrix, integrals, squared

CELLS, PIECES, POINTS, WIDTH = 12, 3, 7, 20


def matrix(rng, bent=None, x=None):
    """Values of five unknowns of each cell at points of its pieces. The functions are quadratic in all cells
    but ``bent``."""
    x = np.linspace(0.0, 1.0, POINTS) if x is None else x
    functions = np.stack([np.ones(POINTS), x, x * x])
    blocks = rng.standard_normal((CELLS, 5, PIECES, 3)) @ functions
    if bent is not None:
        blocks[bent, 2, 1, 3] += 1e-6
    columns = np.sort([rng.permutation(WIDTH)[:5] for _ in range(CELLS)])
    rows = np.arange(CELLS * PIECES * POINTS).reshape(CELLS, 1, -1)
    where = np.broadcast_to(rows, (CELLS, 5, PIECES * POINTS)), np.repeat(columns, PIECES * POINTS)
    values = blocks.reshape(CELLS, 5, -1)
    return sp.csr_matrix((values.ravel(), (where[0].ravel(), where[1])), (rows.size, WIDTH))


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Nodes are chosen by cells 0, 2, 4, 6, 8 and 11."""
    monkeypatch.setattr("ngvisco.algebra.local.SAMPLE", 6)


@pytest.mark.parametrize("bent, nodes", [(None, 3), (4, 4), (1, POINTS)])
def test_products_equal_those_of_the_sparse_matrix(bent, nodes):
    rng = np.random.default_rng(3)
    A, weights = matrix(rng, bent), rng.random(CELLS * PIECES * POINTS)
    local = LocalMatrix(A, CELLS, weights, pieces=PIECES)
    assert local.nodal.shape == (CELLS, 5, PIECES * nodes)
    x, y = rng.standard_normal((2, WIDTH)), rng.standard_normal((2, len(weights)))
    assert np.abs(local(x) - x @ A.T).max() <= 1e-12
    assert np.abs(local(x + 1j * x[::-1]) - (x + 1j * x[::-1]) @ A.T).max() <= 1e-12
    assert np.abs(local.test(y) - (y * weights) @ A).max() <= 1e-11
    assert abs(local.matrix - A).max() <= 1e-12
    some = local.part(slice(3, 8))
    rows = slice(3 * PIECES * POINTS, 8 * PIECES * POINTS)
    assert np.abs(some(x) - (x @ A.T)[:, rows]).max() <= 1e-12
    per_cell = local.by_cells(x.T)
    assert np.abs(local.from_nodes(per_cell).swapaxes(0, 1).reshape(2, -1) - x @ A.T).max() <= 1e-12
    tested = local.tested(local.to_nodes(y.reshape(2, CELLS, -1).swapaxes(0, 1)))
    assert np.abs(tested - A.T @ y.T).max() <= 1e-11


@pytest.mark.parametrize("bent", [None, 4])
def test_two_rules_share_their_nodes_where_functions_are_quadratic(bent):
    """The second rule has seven other points; in a cell that is not quadratic, the rule keeps its own
    values."""
    first = LocalMatrix(matrix(np.random.default_rng(3)), CELLS, pieces=PIECES)
    B = matrix(np.random.default_rng(3), bent, np.linspace(0.1, 0.8, POINTS) ** 2)
    local = LocalMatrix(B, CELLS, pieces=PIECES, other=first)
    assert (local.nodal is first.nodal) == (bent is None)
    x, y = np.random.default_rng(4).standard_normal((2, WIDTH)), np.ones(CELLS * PIECES * POINTS)
    assert np.abs(local(x) - x @ B.T).max() <= 1e-12
    assert np.abs(local.test(y) - y @ B).max() <= 1e-11


@pytest.mark.parametrize("bent", [None, 1])
def test_squares_of_blocks_are_sums_over_points(bent):
    rng = np.random.default_rng(4)
    local = LocalMatrix(matrix(rng, bent), CELLS, pieces=PIECES)
    weights = rng.random((CELLS, local.per_cell))
    found = squared(local.nodal.swapaxes(1, 2), local.shape, weights)
    expected = np.einsum("cpi,cp,cpj->cij", local.blocks, weights, local.blocks)
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


def test_a_rank_without_cells_has_empty_blocks():
    local = LocalMatrix(sp.csr_matrix((0, WIDTH)), 0, np.zeros(0), pieces=PIECES)
    assert local(np.ones((2, WIDTH))).shape == (2, 0) and local.test(np.zeros((2, 0))).shape == (2, WIDTH)


@pytest.mark.parametrize("sides", [4, 0])
def test_integrals_and_loads_are_sums_over_points_also_on_a_rank_without_sides(rng, sides):
    """Without sides there are no nodes: the values then have as many rows as points."""
    shape, weights = rng.standard_normal((2, POINTS)), rng.random((sides, POINTS))
    left = Functions(rng.standard_normal((sides, 3, 2 if sides else 0)), shape if sides else None)
    right = Functions(rng.standard_normal((sides, 5, POINTS if sides else 0)), None)
    values = rng.standard_normal((sides, POINTS, 4))
    products, loads = integrals(left, right, weights), left.loads(values)
    assert products.shape == (sides, 3, 5) and loads.shape == (sides, 3, 4)
    for s in range(sides):
        at_points = left.nodal[s] @ shape
        assert np.allclose(products[s], (at_points * weights[s]) @ right.nodal[s].T, atol=1e-12)
        assert np.allclose(loads[s], at_points @ values[s], atol=1e-12)

"""The minimum of a convex quadratic function in a box."""

import numpy as np
import pytest
import scipy.sparse as sp

from ngvisco.algebra.box import minimise_in_box
from ngvisco.errors import StepError


@pytest.mark.parametrize("seed", range(5))
def test_minimum_meets_its_conditions(seed):
    """Slope zero where no bound holds, else of the bound's sign; a drag that differs by the sign of x."""
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
    """Newton's step goes up by 0.04 - 0.01, not by the rounding of equal parts, which is the kernel's."""
    H, f, none = sp.diags([-1.0, 1.0]).tocsr(), np.array([-0.2, 0.1]), (np.zeros(2), np.zeros(2))
    with pytest.raises(StepError, match="not convex"):
        minimise_in_box(H, f, none, np.full(2, -9.0), np.full(2, 9.0))

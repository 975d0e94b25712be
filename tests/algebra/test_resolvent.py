"""Inverses (1 - N)^{-1} by their series, and the number of terms that the series needs."""

import numpy as np
import pytest

from ngvisco.algebra.resolvent import resolvents


@pytest.mark.parametrize("terms", range(5, 13))
def test_the_series_has_enough_terms_for_its_error_limit(terms):
    """N has the norm s with s^terms = 1e-4, and the norm of each power of N is the same power of s."""
    size = 1e-4 ** (1 / terms)
    N = np.array([size * np.ones((4, 4)) / 4])
    inverse, count = resolvents(N)
    exact = np.linalg.inv(np.eye(4) - N[0])
    series = sum(np.linalg.matrix_power(N[0], power) for power in range(count))
    for found in (inverse[0], series):
        assert abs(found - exact).sum(axis=1).max() <= 1e-4
    assert count <= terms + 2

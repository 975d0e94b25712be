"""The least eigenvalue of many tensors: a closed form selects the few tensors that are decomposed."""

import numpy as np
import pytest

from ngvisco.physics.tensors import least_eigenvalues


def rotated(eigenvalues):
    """Symmetric tensors, (n, 3, 3), with ``eigenvalues`` (n, 3), in random directions."""
    random = np.random.default_rng(0)
    axes = np.linalg.qr(random.standard_normal((len(eigenvalues), 3, 3)))[0]
    tensors = axes @ (eigenvalues[:, :, None] * axes.transpose(0, 2, 1))
    return 0.5 * (tensors + tensors.transpose(0, 2, 1))


@pytest.mark.parametrize("size", [1e-8, 1e-3, 1.0, 1e6])
@pytest.mark.parametrize("spread", [0.0, 1e-15, 1e-9, 1e-3, 1.0])
def test_the_least_eigenvalue_equals_that_of_full_decompositions(size, spread):
    """The eigenvalues may be nearly double or triple, where the closed form loses half of the digits."""
    random = np.random.default_rng(1)
    for of_rest in (1.0, 1.0 + spread, 3.0):
        base = np.stack([np.ones(500), np.ones(500), np.full(500, of_rest)], axis=1)
        tensors = size * rotated(base + spread * random.standard_normal((500, 3)))
        found = least_eigenvalues(tensors)
        assert found.min() == np.linalg.eigvalsh(tensors)[:, 0].min()


def test_few_of_many_tensors_are_decomposed():
    tensors = rotated(np.random.default_rng(2).uniform(0.1, 5.0, (2000, 3)))
    assert 1 <= len(least_eigenvalues(tensors)) <= 3


def test_without_tensors_there_is_no_eigenvalue_and_nan_stays_nan():
    assert least_eigenvalues(np.zeros((0, 3, 3))).shape == (0,)
    tensors = np.tile(np.eye(3), (5, 1, 1))
    tensors[2] = np.nan
    assert np.isnan(least_eigenvalues(tensors)).any()

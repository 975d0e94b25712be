"""Tensor spaces and the algebra on 3x3 coefficient functions."""

import numpy as np
import pytest
from ngsolve import CF
from support import one_triangle, plane_strain, tensor, value

from ngvisco.physics.tensors import (
    full_tensors,
    power_of_square,
    symmetric_tensors,
    trace_free_tensors,
)

SPACES = {
    (make.__name__, dim): (make(dim), size)
    for make, sizes in ((full_tensors, (5, 9)), (symmetric_tensors, (4, 6)), (trace_free_tensors, (3, 5)))
    for dim, size in zip((2, 3), sizes, strict=True)
}


def admissible(name: str, dim: int, A: np.ndarray) -> np.ndarray:
    """The orthogonal projection of A to the space, written by hand."""
    A = A if dim == 3 else plane_strain(A)
    if name != "full_tensors":
        A = (A + A.T) / 2
    return A - np.trace(A) / 3 * np.eye(3) if name == "trace_free_tensors" else A


@pytest.mark.parametrize("key", SPACES, ids=str)
def test_basis_is_orthonormal_and_complete(key: tuple[str, int]) -> None:
    space, size = SPACES[key]
    assert space.size == size == len(space.basis)
    assert space.columns.T @ space.columns == pytest.approx(np.eye(size), abs=1e-15)


@pytest.mark.parametrize("key", SPACES, ids=str)
def test_components_are_the_orthogonal_projection(key: tuple[str, int], rng: np.random.Generator) -> None:
    space, _ = SPACES[key]
    A = rng.standard_normal((3, 3))
    projected = value(space.tensor(space.components(tensor(A))))
    assert projected == pytest.approx(admissible(*key, A), abs=1e-14)
    again = value(space.tensor(space.components(tensor(projected))))
    assert again == pytest.approx(projected, abs=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_components_of_full_tensors_are_the_entries_row_by_row(dim: int) -> None:
    space = full_tensors(dim)
    entries = [(i, j) for i in range(3) for j in range(3) if dim == 3 or (i == 2) == (j == 2)]
    for component, entry in zip(np.eye(space.size), entries, strict=True):
        A = value(space.tensor(tensor(component)))
        assert A[entry] == 1 and np.abs(A).sum() == 1


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 0.75, -0.25, 2.5])
def test_power_of_square_has_finite_derivatives_at_zero(exponent: float) -> None:
    s = CF(0.0).MakeVariable()
    f = power_of_square(s, exponent, 1e-5)
    point = one_triangle()(0.3, 0.3)
    assert np.isfinite(f(point)) and np.isfinite(f.Diff(s)(point))
    s = CF(1.7).MakeVariable()
    f = power_of_square(s, exponent, 1e-5)
    assert f(point) == pytest.approx(1.7**exponent, rel=1e-9)
    assert f.Diff(s)(point) == pytest.approx(exponent * 1.7 ** (exponent - 1), rel=1e-9)

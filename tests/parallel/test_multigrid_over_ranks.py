"""PETSc's multigrid: the rigid motions that it needs, matrices that it does not take, and released memory."""

from functools import cache
from pathlib import Path

import pytest
from launch import needs_petsc, printed

pytestmark = [needs_petsc, pytest.mark.long, pytest.mark.ci]


@cache
def found():
    return printed(Path(__file__).with_name("multigrid.py"))


def test_rigid_motions_halve_the_iterations():
    """With rigid motions, 512 triangles take 9 iterations instead of 27: coarse spaces of constants contain
    no rotation of an elastic body."""
    assert found()["cells"] == 512 and found()["with"] <= 12
    assert found()["with"] < 0.5 * found()["without"]


def test_a_matrix_that_multigrid_does_not_take_is_factorised():
    assert found()["left"] < 1e-4  # the bound allows for factors in single precision
    (said,) = found()["said"]
    assert said == (
        "coarse = 'gamg' is not used (gamg cannot be used for the matrix (the matrix is not positive "
        "definite)); a direct solver factorises the matrix of the vertices instead"
    )


def test_memory_does_not_grow_with_factorisations():
    growth, of_one = printed(Path(__file__).with_name("memory.py"))
    assert growth < 0.3 * of_one

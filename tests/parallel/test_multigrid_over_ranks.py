"""PETSc's multigrid for the velocities at vertices: what it needs to know, and what is done without it."""

from functools import cache
from pathlib import Path

from launch import needs_petsc, printed

pytestmark = needs_petsc


@cache
def found():
    return printed(Path(__file__).with_name("multigrid.py"))


def test_rigid_motions_halve_the_iterations():
    """9 for 27 on 512 triangles: coarse spaces of constants alone hold no rotation of an elastic body."""
    assert found()["cells"] == 512 and found()["with"] <= 12
    assert found()["with"] < 0.5 * found()["without"]


def test_a_matrix_that_multigrid_does_not_take_is_factorised():
    assert found()["left"] < 1e-4  # factors are in single precision
    (said,) = found()["said"]
    assert said == (
        "coarse = 'gamg': gamg did not take the matrix (it is not positive definite); the velocities of the "
        "vertices are factorised"
    )

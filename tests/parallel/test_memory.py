"""PETSc gives back what is no longer asked of it."""

from pathlib import Path

from launch import needs_petsc, printed

pytestmark = needs_petsc


def test_memory_does_not_grow_with_factorisations():
    growth, of_one = printed(Path(__file__).with_name("memory.py"))
    assert growth < 0.3 * of_one

"""PETSc gives back what is no longer asked of it."""

from pathlib import Path

import pytest
from launch import has_petsc, run

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(
    not has_petsc(), reason="no MPI or PETSc: see the README's 'Several processes'"
)


def test_memory_does_not_grow_with_factorisations():
    result = run(HERE / "memory.py")
    assert result.returncode == 0, result.stderr[-2000:]
    growth, of_one = map(float, result.stdout.split())
    assert growth < 0.3 * of_one

"""Over three ranks with cells no sum depends on the order in which messages come."""

import json
from pathlib import Path

import pytest
from launch import has_petsc, run

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(
    not has_petsc(), reason="no MPI or PETSc: see the README's 'Several processes'"
)


def assert_same_whoever_is_late(*names):
    result = run("-m", "mpi4py", HERE / "order.py", *names, ranks=4)
    assert result.returncode == 0, result.stderr[-2000:]
    for one, other in json.loads(result.stdout.splitlines()[-1]).values():
        assert len(one) == 4 and one == other


def test_interpolation_is_the_same_to_the_bit():
    assert_same_whoever_is_late("interpolated")


@pytest.mark.long
@pytest.mark.ci
def test_a_step_in_space_is_the_same_to_the_bit(monkeypatch):
    """Its ledger, and the states before and after it, where MUMPS is not over ranks."""
    monkeypatch.setenv("PETSC_OPTIONS", "-ngvisco_on_one_rank_up_to 100000")
    assert_same_whoever_is_late("coupled", "split")

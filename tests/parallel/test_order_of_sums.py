"""Over three ranks with cells no sum depends on the order in which messages come."""

import json
from pathlib import Path

import pytest
from launch import has_petsc, run

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(
    not has_petsc(), reason="no MPI or PETSc: see the README's 'Several processes'"
)


@pytest.mark.long
@pytest.mark.ci
def test_a_step_in_space_and_interpolation_are_the_same_to_the_bit(monkeypatch):
    """The ledger, and the states before and after it, where MUMPS is not over ranks; whoever is late."""
    monkeypatch.setenv("PETSC_OPTIONS", "-ngvisco_on_one_rank_up_to 100000")
    result = run("-m", "mpi4py", HERE / "order.py", "interpolated", "coupled", "split", ranks=4)
    assert result.returncode == 0, result.stderr[-2000:]
    for one, other in json.loads(result.stdout.splitlines()[-1]).values():
        assert len(one) == 4 and one == other

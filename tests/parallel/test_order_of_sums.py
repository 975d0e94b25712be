"""Over three ranks with cells no sum depends on the order in which messages come."""

from pathlib import Path

import pytest
from launch import needs_petsc, printed

HERE = Path(__file__).parent
pytestmark = needs_petsc


@pytest.mark.long
@pytest.mark.ci
def test_a_three_dimensional_step_and_interpolation_do_not_depend_on_which_rank_is_late(monkeypatch):
    """Ledger and states before and after the step do not depend on the rank that is late, unless MUMPS runs
    over ranks."""
    monkeypatch.setenv("PETSC_OPTIONS", "-ngvisco_on_one_rank_up_to 100000")
    found = printed("-m", "mpi4py", HERE / "order.py", "interpolated", "coupled", "split", ranks=4)
    for one, other in found.values():
        assert len(one) == 4 and one == other

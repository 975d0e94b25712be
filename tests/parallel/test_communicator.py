"""Ranks' reductions on one process and three, and errors that travel."""

from pathlib import Path

import numpy as np
import pytest
from launch import needs_petsc, printed
from ngsolve import H1

from ngvisco.case.faults import CaseError, Fault
from ngvisco.errors import ParameterError, StepError, UnknownNameError
from ngvisco.geometries import box
from ngvisco.parallel.communicator import Communicator, MPIError, _packed, _unpacked
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import distributed


def test_on_one_process_everything_is_its_argument():
    mesh = box((1, 1), maxh=0.5)
    ranks = Communicator.of(mesh)
    values = np.array([3.0, 1.0, 2.0])
    assert (ranks.size, ranks.rank, ranks.is_distributed, ranks.is_first) == (1, 0, False, True)
    assert (ranks.total(2.5), ranks.least(values), ranks.most(values)) == (2.5, 1.0, 3.0)
    assert ranks.any(True) and not ranks.all(False) and ranks.norm(values) == np.linalg.norm(values)
    assert np.isnan(ranks.least(np.array([1.0, np.nan]))) and np.isnan(ranks.most(np.array([np.nan])))
    assert ranks.agree(None) is None and ranks.settled(3) == 3 and ranks.on_first(lambda: 7) == 7
    assert distributed(mesh, ranks) is mesh
    exchange, numbers = Exchange.of(H1(mesh, order=1), ranks), np.arange(mesh.nv) * 1.0
    assert exchange.sum(numbers) is numbers and exchange.owned.all() and not len(exchange.places)
    assert exchange.norm(numbers, slice(0, 3)) == np.linalg.norm(numbers[:3])
    assert (exchange.products(numbers[None], numbers) == [numbers @ numbers]).all()
    assert exchange.length() == mesh.nv and exchange.part(np.array([2, 0])).count == 2
    chosen, count = exchange.numbers(numbers > 0)
    assert count == mesh.nv - 1 and (chosen[1:] == np.arange(count)).all()
    with pytest.raises(ValueError, match="alone"), ranks.together(ValueError):
        raise ValueError("alone")


@pytest.mark.parametrize(
    "error",
    [
        ParameterError("Simulation.dt", -1, "a number > 0"),
        UnknownNameError("boundary", "tob", ["top"]),
        StepError("no step"),
        CaseError("case.toml", [Fault("time.dt", "is missing", 3)]),
        OSError(28, "No space left on device", "somewhere"),
        KeyboardInterrupt(),
        ValueError("other"),
    ],
)
def test_errors_are_the_same_on_other_ranks(error):
    """Type, message and attributes; a value that cannot travel is left out."""
    if isinstance(error, ParameterError):
        error.value = lambda: None
    copy = _unpacked(_packed(error))
    assert type(copy) is type(error) and str(copy) == str(error)
    kept = {name: value for name, value in vars(error).items() if name != "value"}
    assert {name: vars(copy)[name] for name in kept} == kept


def test_processes_that_cannot_meet_are_refused(monkeypatch):
    """As where mpirun and mpi4py are of different MPIs: each process would do the whole run."""
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "3")
    with pytest.raises(MPIError, match="mpirun started 3 processes"):
        Communicator.world()


@needs_petsc
def test_first_rank_has_all_sums_and_sleeps_while_it_waits():
    """MPI's own waiting takes the whole processor."""
    last = printed(Path(__file__).with_name("following.py"), ranks=3)
    assert last["found"] == 3 * [5 * [[0.0, 3.0, 6.0], [3.0, 2.0]]]
    assert last["share"] < 0.5

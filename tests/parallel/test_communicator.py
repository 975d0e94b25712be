"""Reductions on one process and on three ranks, and errors that are sent between ranks."""

import pickle
from pathlib import Path

import pytest
from launch import needs_petsc, printed

from ngvisco.case.faults import CaseError, Fault
from ngvisco.errors import ParameterError, StepError, UnknownNameError
from ngvisco.parallel.communicator import Communicator, MPIError
from ngvisco.words import words_of


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
def test_errors_keep_type_message_and_attributes_in_other_processes(error):
    """Type, message and attributes are equal; a value that cannot be copied is left out."""
    if isinstance(error, ParameterError):
        error.value = lambda: None
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error) and str(copy) == str(error)
    assert getattr(words_of(copy), "parts", None) == getattr(words_of(error), "parts", None)
    kept = {name: value for name, value in vars(error).items() if name != "value"}
    assert {name: vars(copy)[name] for name in kept} == kept


def test_mpirun_and_mpi4py_of_different_mpis_are_refused(monkeypatch):
    """If mpirun and mpi4py belong to different MPIs, each process would do the whole run."""
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "3")
    with pytest.raises(MPIError, match="mpirun started 3 processes"):
        Communicator.world()


@pytest.mark.long
@pytest.mark.ci
@needs_petsc
def test_the_first_rank_has_all_sums_and_sleeps_while_it_waits():
    """MPI's own waiting would take the whole processor."""
    last = printed(Path(__file__).with_name("following.py"), ranks=3)
    assert last["found"] == 3 * [5 * [[0.0, 3.0, 6.0], [3.0, 2.0]]]
    assert last["share"] < 0.5

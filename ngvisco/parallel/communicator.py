"""Reductions over the ranks of a mesh; on one process a reduction returns its argument at no cost.

The first rank has no cells.  Sums over cells are reduced among the other ranks, which send the result to the
first rank without waiting for the first rank.  A rank that waits by MPI keeps a processor busy.  If there are
as many ranks with cells as processors, the waiting first rank would slow down one of these ranks.  Therefore
the first rank polls, and sleeps between polls.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from ngsolve import Mesh

from ngvisco.errors import NgviscoError, can_be_copied

_SHORTEST, _LONGEST, _GROWTH = 2e-5, 1e-3, 1.5
"""Shortest and longest pause, s, between two polls of a sleeping rank, and the growth factor of pauses."""

_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS")
"""Environment variables in which the usual MPIs pass the number of processes."""

OF_ALL_RANKS = "_of_all_ranks"
"""Name of the attribute of errors on which all ranks have agreed."""

_LOOK, _PATIENCE = 0.01, 20.0
"""Seconds between polls of other ranks, and seconds that a failed rank waits for them to end."""

Result = TypeVar("Result")


class MPIError(NgviscoError, RuntimeError):
    """Processes that mpirun started cannot work together."""


@dataclass
class Traffic:
    """Numbers of this process's messages to neighbours, of the bytes in these messages, and of this process's
    reductions."""

    messages: int = 0
    bytes: int = 0
    reductions: int = 0


TRAFFIC = Traffic()
"""The counts of this process so far."""


class Working:
    """The ranks with cells of a communicator; made collectively, once for each communicator."""

    def __init__(self, mpi: Any) -> None:
        self.is_first = mpi.rank == 0
        self.among = mpi.Split(int(not self.is_first), mpi.rank)
        """Communicator of the ranks with cells; on the first rank a communicator of this rank alone."""
        self._first = mpi.Dup()
        self._sent: list[Any] = []
        self.notes: list[str] = []
        """Failures noted by this rank, for ``Communicator.noted``."""

    @classmethod
    def of(cls, mpi: Any) -> Working:
        """The ranks with cells of an mpi4py communicator; collective at the first call."""
        number = mpi.py2f()
        if number not in _kept:
            _kept[number] = mpi, cls(mpi)
        return _kept[number][1]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Entrywise sums over the ranks with cells, returned on all ranks."""
        TRAFFIC.reductions += 1
        result = np.empty_like(values)
        if self.is_first:
            asleep(self._first.Irecv(result, 1))
            return result
        self.among.Allreduce(values, result)
        if self.among.rank == 0:
            self._sent = [request for request in self._sent if not request.Test()]
            self._sent.append(self._first.Isend(result.copy(), 0))  # the request keeps the copy
        return result


def asleep(request: Any) -> None:
    """Wait for a request of mpi4py without keeping the processor busy."""
    pause = _SHORTEST
    while not request.Test():
        time.sleep(pause)
        pause = min(_GROWTH * pause, _LONGEST)


_kept: dict[int, tuple[Any, Working]] = {}
"""Working ranks by MPI's number of a communicator.  The communicator is kept too, so that its number is not
reused.  (An attribute of MPI's communicator would hang the process at its end, when mpi4py calls an
interpreter that is gone.)"""


class Communicator:
    """The ranks that hold a mesh.

    Every method is collective: all ranks call it, in equal order, and get equal results.

    Parameters
    ----------
    mpi : communicator of mpi4py, or None
        mpi4py's communicator; None for one process.
    """

    def __init__(self, mpi: Any = None) -> None:
        self.mpi = mpi
        self.size: int = 1 if mpi is None else mpi.size
        self.rank: int = 0 if mpi is None else mpi.rank

    @property
    def working(self) -> Any:
        """mpi4py's communicator of the ranks with cells, or of the first rank alone; None without MPI."""
        return None if self.mpi is None else Working.of(self.mpi).among

    @property
    def is_idle(self) -> bool:
        """Whether this is the first of several ranks, which has no cells."""
        return self.is_distributed and self.is_first

    @classmethod
    def of(cls, mesh: Mesh) -> Communicator:
        """The ranks of a mesh."""
        return cls(mesh.comm.mpi4py if mesh.comm.size > 1 else None)

    @classmethod
    def world(cls) -> Communicator:
        """All processes that mpirun started; without mpirun one process, and MPI is not loaded.

        Raises MPIError if mpirun started several processes and mpi4py is missing or belongs to another MPI.
        """
        started = max((int(os.environ[n]) for n in _SIZES if os.environ.get(n, "").isdigit()), default=1)
        if started == 1 and "mpi4py.MPI" not in sys.modules:
            return cls()
        try:
            from mpi4py import MPI
        except (ImportError, RuntimeError) as error:  # RuntimeError: the MPI library is missing
            message = f"mpirun started {started} processes, but mpi4py does not load ({error})"
            raise MPIError(message) from error
        size = MPI.COMM_WORLD.size
        if size < started:
            raise MPIError(
                f"mpirun started {started} processes, but mpi4py knows {size}, since mpi4py and mpirun "
                "belong to different installations of MPI; expected one installation (see ngvisco info "
                "--parallel)"
            )
        return cls(MPI.COMM_WORLD if size > 1 else None)

    @property
    def is_distributed(self) -> bool:
        return self.size > 1

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that prints messages and writes files."""
        return self.rank == 0

    def total(self, value: float) -> float:
        """Sum of a number over the ranks."""
        return value if self.size == 1 else self._reduced(value, "SUM")

    def totals(self, values: np.ndarray) -> np.ndarray:
        """Entrywise sums of an array over the ranks."""
        return values if self.size == 1 else self._reduced(np.ascontiguousarray(values), "SUM")

    def most(self, values: np.ndarray | float) -> float:
        """The largest of all ranks' values; a rank may have none.  NaN counts as larger than any number."""
        local = np.asarray(values, dtype=float)
        if self.size == 1:
            return float(local.max())
        largest = float(local.max(initial=-np.inf))
        is_number = largest == largest  # MPI's maximum may drop NaN
        extremes = self._reduced(np.array([largest if is_number else np.inf, float(not is_number)]), "MAX")
        return float("nan") if extremes[1] else float(extremes[0])

    def least(self, values: np.ndarray | float) -> float:
        """The least of all ranks' values; a rank may have none.  NaN counts as less than any number."""
        return -self.most(-np.asarray(values, dtype=float))

    def largest(self, values: np.ndarray) -> np.ndarray:
        """Entrywise maximum over the ranks; values must not be NaN."""
        return values if self.size == 1 else self._reduced(np.ascontiguousarray(values), "MAX")

    def any(self, value: bool | np.bool_) -> bool:
        """Whether ``value`` is true on some rank."""
        return bool(value) if self.size == 1 else bool(self._reduced(int(value), "MAX"))

    def all(self, value: bool | np.bool_) -> bool:
        """Whether ``value`` is true on every rank."""
        return not self.any(not value)

    def products(self, several: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Inner products, (n,), of vectors (n, entries) with ``vector``; one rank alone holds each entry."""
        return several @ vector if self.size == 1 else Working.of(self.mpi).sums(several @ vector)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Inner product of two vectors over the ranks with cells; one rank alone holds each entry."""
        return float(self.products(a[None], b)[0])

    def norm(self, values: np.ndarray) -> float:
        """Euclidean norm of a vector over the ranks with cells; one rank alone holds each entry."""
        return float(np.linalg.norm(values)) if self.size == 1 else float(np.sqrt(self.dot(values, values)))

    def _reduced(self, value: Any, name: str) -> Any:
        from mpi4py import MPI

        TRAFFIC.reductions += 1
        values = value if isinstance(value, np.ndarray) else np.array([value], dtype=float)
        result = np.empty_like(values)
        request = self.mpi.Iallreduce(values, result, getattr(MPI, name))
        if self.is_first:
            asleep(request)
        else:
            request.Wait()
        return result if isinstance(value, np.ndarray) else float(result[0])

    def gathered(self, value: Any) -> list[Any]:
        """All ranks' objects, in the order of the ranks."""
        return [value] if self.size == 1 else self.mpi.allgather(value)

    @contextlib.contextmanager
    def together(self, *kinds: type[BaseException]) -> Iterator[None]:
        """Context for local work of each rank; an error of these kinds on one rank is raised on all."""
        if self.size == 1:
            yield
            return
        error: BaseException | None = None
        try:
            yield
        except kinds as raised:
            error = raised
        together = self.agree(error)
        if together is not None:
            raise together from error

    def agree(self, error: BaseException | None) -> BaseException | None:
        """The error of the lowest rank that has one, returned on all ranks; None if no rank has an error."""
        if self.size == 1 or not self.any(error is not None):
            return error
        if error is not None and not can_be_copied(error):
            error = RuntimeError(f"{type(error).__name__}: {error}")
        together: BaseException = next(entry for entry in self.gathered(error) if entry is not None)
        vars(together)[OF_ALL_RANKS] = True
        return together

    def note(self, text: str) -> None:
        """Note a failure of this rank, which sends NaN to the ranks that wait for its numbers."""
        Working.of(self.mpi).notes.append(text)

    def forget_notes(self) -> None:
        """Delete the notes of this rank."""
        if self.mpi is not None:
            Working.of(self.mpi).notes.clear()

    def noted(self) -> list[str]:
        """Notes of all ranks, each text once."""
        notes = [] if self.mpi is None else self.gathered(Working.of(self.mpi).notes)
        return list(dict.fromkeys(text for of_rank in notes for text in of_rank))

    def on_first(self, work: Callable[[], Result]) -> Result:
        """Return the result of the first rank's ``work`` on every rank, or raise its error on every rank."""
        if self.size == 1:
            return work()
        with self.together(BaseException):
            result = work() if self.is_first else None
        return self.mpi.bcast(result)

    def warn(self, message: str, category: type[Warning], stacklevel: int = 1) -> None:
        """Warn on the first rank; a warning that filters turn into an error is raised on all ranks.

        ``stacklevel`` counts as in ``warnings.warn``: 1 is the caller.
        """
        self.on_first(lambda: warnings.warn(message, category, stacklevel + 3))

    @contextlib.contextmanager
    def held_by_first(self, context: AbstractContextManager[Any]) -> Iterator[None]:
        """Context that the first rank alone enters; an error at entering is raised on every rank."""
        with contextlib.ExitStack() as stack:

            def enter() -> None:
                stack.enter_context(context)

            self.on_first(enter)
            yield

    def settled(self, code: int) -> int:
        """Wait until all ranks have ended, and return the largest of their exit codes.

        A rank that has failed alone waits some seconds for the others, and then aborts them.
        """
        if self.size == 1:
            return code
        everyone, waited = self.mpi.Ibarrier(), 0.0
        while not everyone.Test():
            time.sleep(_LOOK)
            waited += _LOOK
            if code and waited > _PATIENCE:
                self.abort(code)
        return int(self.most(code))

    def abort(self, code: int) -> None:
        """End all ranks at once with an exit code, after an error on one rank alone."""
        if self.mpi is not None:
            self.mpi.Abort(code)

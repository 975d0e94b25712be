"""The ranks with cells among themselves, and the first one, which has none and follows them asleep.

In a sum over cells the first rank has no share: the others reduce it and send it on to the first one, for
which none of them waits.  MPI's own waiting keeps a processor busy, which is one of theirs where there are
as many ranks with cells as processors: the first rank looks, and sleeps in between.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

_SHORTEST, _LONGEST, _GROWTH = 2e-5, 1e-3, 1.5
"""Seconds between two looks of a rank that waits asleep, and by how much they grow from look to look."""

_kept: dict[int, tuple[Any, Working]] = {}
"""By MPI's number of a communicator, which is kept too, so that no other gets its number.  (With MPI's own
attributes of communicators a process does not end: mpi4py asks for an interpreter that has gone.)"""


class Working:
    """The ranks of a communicator that have cells; made once for a communicator, collectively."""

    def __init__(self, mpi: Any) -> None:
        self.is_first = mpi.rank == 0
        self.among = mpi.Split(int(not self.is_first), mpi.rank)
        """Their communicator; on the first rank one of its own."""
        self._first = mpi.Dup()
        self._sent: list[Any] = []
        self.notes: list[str] = []
        """Of this rank, for ``Communicator.noted``."""

    @classmethod
    def of(cls, mpi: Any) -> Working:
        """Those of a communicator of mpi4py; collective at the first call."""
        number = mpi.py2f()
        if number not in _kept:
            _kept[number] = mpi, cls(mpi)
        return _kept[number][1]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """The sums of each of some values over the ranks with cells, on all ranks."""
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

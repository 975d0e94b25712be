"""Reductions over the ranks of a mesh; on one process each is its argument, at no cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import Mesh


@dataclass
class Traffic:
    """What a rank sent: messages to neighbours, their bytes, and reductions, each of a number or two."""

    messages: int = 0
    bytes: int = 0
    reductions: int = 0


class Communicator:
    """The ranks that hold a mesh.

    Every method but the properties is collective: all ranks call it, in the same order, and get the same.

    Attributes
    ----------
    size, rank : int
    traffic : Traffic
        Of this rank so far, with the exchanges that were made with it (``ngvisco.parallel.exchange``).
    """

    def __init__(self, comm: Any) -> None:
        """``comm`` is that of a mesh, ``mesh.comm``."""
        self._comm = comm
        self.size, self.rank = int(comm.size), int(comm.rank)
        self.traffic = Traffic()

    @classmethod
    def of(cls, mesh: Mesh) -> Communicator:
        """That of a mesh."""
        return cls(mesh.comm)

    @property
    def is_distributed(self) -> bool:
        return self.size > 1

    @property
    def is_first(self) -> bool:
        """Whether this is the rank that speaks and writes."""
        return self.rank == 0

    @property
    def mpi(self) -> Any:
        """The communicator of mpi4py; there are several ranks."""
        return self._comm.mpi4py

    def total(self, value: float) -> float:
        """The sum over the ranks."""
        if self.size == 1:
            return value
        self.traffic.reductions += 1
        return self._comm.Sum(value)

    def least(self, values: np.ndarray | float) -> float:
        """The least of all ranks' values; a rank may have none, NaN counts as less than any number."""
        return -self.most(-np.asarray(values, dtype=float))

    def most(self, values: np.ndarray | float) -> float:
        """The largest of all ranks' values; a rank may have none, NaN counts as larger than any number."""
        own = np.asarray(values, dtype=float)
        if self.size == 1:
            return float(own.max())
        self.traffic.reductions += 1
        largest = float(own.max(initial=-np.inf))
        # MPI's maximum may drop NaN
        pair = np.array([largest if largest == largest else 0.0, float(largest != largest)])
        result = np.empty(2)
        self.mpi.Allreduce(pair, result, _operation("MAX"))
        return float("nan") if result[1] else float(result[0])

    def any(self, value: bool) -> bool:
        """Whether it is so on some rank."""
        if self.size == 1:
            return bool(value)
        self.traffic.reductions += 1
        return bool(self._comm.Max(int(value)))

    def all(self, value: bool) -> bool:
        """Whether it is so on every rank."""
        return not self.any(not value)

    def norm(self, values: np.ndarray) -> float:
        """The Euclidean norm of what the ranks hold together, each entry on one of them."""
        if self.size == 1:
            return float(np.linalg.norm(values))
        return float(np.sqrt(self.total(float(values @ values))))

    def from_first(self, value: Any) -> Any:
        """The first rank's object on every rank."""
        return value if self.size == 1 else self.mpi.bcast(value if self.is_first else None)

    def gathered(self, value: Any) -> list[Any] | None:
        """All ranks' objects on the first one, None on others."""
        return [value] if self.size == 1 else self.mpi.gather(value)

    def agree(self, error: BaseException | None) -> BaseException | None:
        """The error that all ranks end with where some have one: that of the lowest rank which has one."""
        if self.size == 1 or not self.any(error is not None):
            return error
        found: list[BaseException | None] = self.mpi.allgather(error)
        return next(one for one in found if one is not None)


def _operation(name: str) -> Any:
    from mpi4py import MPI

    return getattr(MPI, name)

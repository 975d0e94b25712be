"""The one primitive of distributed vectors: what ranks share of a vector's unknowns is summed up.

``ParallelDofs().Proc2Dof(r)`` lists the unknowns shared with rank r in the same order on both sides.  Each
rank sends its own values of them and adds what it gets in the order of the ranks, so that all ranks which
share an unknown have bit for bit the same sum.

A vector is *summed* where all ranks that share an unknown have the same value of it, that of one process, and
*in parts* where their sum is that value, as what each rank's cells make of a residual.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, FESpace, GridFunction, Parameter, Region

from ngvisco.parallel.communicator import TRAFFIC, Communicator


class Owned(ABC):
    """Unknowns of this rank, each of which one of the ranks that have it owns.

    Parameters
    ----------
    count : int
        How many there are on this rank.
    neighbours : iterable of int
        Ranks that have some of them too.
    """

    def __init__(self, count: int, neighbours: Iterable[int], communicator: Communicator) -> None:
        self.count, self.neighbours, self.communicator = count, frozenset(neighbours), communicator
        self.is_distributed = communicator.is_distributed

    @property
    @abstractmethod
    def owned(self) -> np.ndarray:
        """Which ones this rank owns, (unknowns,)."""

    @abstractmethod
    def of_owners(self, values: np.ndarray) -> np.ndarray:
        """For every unknown the value of the rank that owns it; collective between neighbours."""

    def numbers(self, chosen: np.ndarray) -> tuple[np.ndarray, int]:
        """Numbers of the unknowns that are ``chosen`` among these of all ranks, and how many they are.

        Those that a rank owns follow each other, rank after rank; others have no number.  Collective.
        """
        own = chosen & self.owned
        counts = self.communicator.gathered(int(np.count_nonzero(own)))
        numbers = np.zeros(self.count)
        numbers[own] = sum(counts[: self.communicator.rank]) + np.arange(np.count_nonzero(own))
        return self.of_owners(numbers).astype(np.int64), sum(counts)


class Exchange(Owned):
    """Sums of unknowns over the ranks that share them; on one process nothing is done.

    Parameters
    ----------
    count : int
        Unknowns of this rank.
    shared : mapping of ranks to arrays of int
        Unknowns shared with each neighbour, in the same order on both.
    """

    def __init__(self, count: int, shared: Mapping[int, np.ndarray], communicator: Communicator) -> None:
        self.shared = {rank: numbers for rank, numbers in shared.items() if len(numbers)}
        super().__init__(count, self.shared, communicator)

    @classmethod
    def of(cls, space: FESpace, communicator: Communicator) -> Exchange:
        """The exchange of a space's unknowns; ``communicator`` is that of its mesh."""
        if not communicator.is_distributed:
            return cls(space.ndof, {}, communicator)
        return cls.of_dofs(space.ParallelDofs(), space.ndof, communicator)

    @classmethod
    def of_dofs(cls, dofs: Any, count: int, communicator: Communicator) -> Exchange:
        """The exchange of NGSolve's ``ParallelDofs``."""
        others = [rank for rank in range(communicator.size) if rank != communicator.rank]
        shared = {rank: np.array(dofs.Proc2Dof(rank), dtype=np.int64) for rank in others}
        return cls(count, shared, communicator)

    def part(self, numbers: np.ndarray) -> Exchange:
        """The exchange of some of the unknowns, as a vector of these alone.

        What is shared of them has to be chosen, in the same order, on all ranks that share it.
        """
        if not self.shared:
            return Exchange(len(numbers), {}, self.communicator)
        place = np.full(self.count, -1, dtype=np.int64)
        place[numbers] = np.arange(len(numbers))
        shared = {rank: place[own] for rank, own in self.shared.items()}
        chosen = {rank: own[own >= 0] for rank, own in shared.items()}
        return Exchange(len(numbers), chosen, self.communicator)

    @cached_property
    def owned(self) -> np.ndarray:
        """Where this rank is the lowest of those that hold the unknown, (unknowns,)."""
        mine = np.ones(self.count, dtype=bool)
        for rank, numbers in self.shared.items():
            if rank < self.communicator.rank:
                mine[numbers] = False
        return mine

    @cached_property
    def places(self) -> np.ndarray:
        """The unknowns that other ranks hold too, (shared unknowns,)."""
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *self.shared.values()]))

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        return self.sum(np.where(self.owned, values, 0.0)) if self.shared else values

    def sum(self, values: np.ndarray) -> np.ndarray:
        """The sums of all ranks' values, (..., unknowns); collective between neighbours."""
        if not self.shared:
            return values
        got = self._got({rank: values[..., own] for rank, own in self.shared.items()})
        result = np.array(values)
        result[..., self.places] = 0.0
        for rank in sorted([*got, self.communicator.rank]):  # the same order on every rank
            if rank == self.communicator.rank:
                result[..., self.places] += values[..., self.places]
            else:
                result[..., self.shared[rank]] += got[rank]
        return result

    def others(self, values: np.ndarray) -> np.ndarray:
        """The other ranks' values of the shared unknowns in place of ``values``, (..., shared unknowns).

        For unknowns that two ranks share, as those of facets.
        """
        among = {rank: np.searchsorted(self.places, own) for rank, own in self.shared.items()}
        result, got = np.zeros_like(values), self._got({rank: values[..., at] for rank, at in among.items()})
        for rank, where in among.items():
            result[..., where] += got[rank]
        return result

    def _got(self, values: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Send arrays to the neighbours, and return those that they sent."""
        mpi = self.communicator.mpi
        sent = {rank: np.ascontiguousarray(part) for rank, part in values.items()}
        got = {rank: np.empty_like(part) for rank, part in sent.items()}
        requests = [mpi.Irecv(part, rank) for rank, part in got.items()]
        requests += [mpi.Isend(part, rank) for rank, part in sent.items()]
        for request in requests:
            request.Wait()
        TRAFFIC.messages += len(sent)
        TRAFFIC.bytes += sum(part.nbytes for part in sent.values())
        return got

    def products(self, several: np.ndarray, one: np.ndarray) -> np.ndarray:
        """Inner products of summed vectors ``several`` (n, unknowns) with ``one``, (n,); collective."""
        if not self.is_distributed:
            return several @ one
        return self.communicator.products(several, np.where(self.owned, one, 0.0))

    def norm(self, values: np.ndarray, where: slice = slice(None)) -> float:
        """The Euclidean norm of a summed vector, or of a part of it; collective."""
        own = values[where]
        return self.communicator.norm(own[self.owned[where]] if self.is_distributed else own)

    def length(self, where: slice = slice(None)) -> int:
        """The number of unknowns on all ranks, or of a part of them; collective."""
        return int(self.communicator.total(int(np.count_nonzero(self.owned[where]))))


class Halo:
    """Cells of other ranks across the facets that a rank shares; none on one process.

    A rank counts them after its own, in the order of the facets, those across two facets twice.  Cells take
    values from these; what they give to the rows of these goes back to their ranks.

    Parameters
    ----------
    facets : Exchange
        Of one value a facet.
    beside : (shared facets,) array of int
        This rank's cell at each of ``facets.places``.
    cells : int
        Of this rank.
    """

    def __init__(self, facets: Exchange, beside: np.ndarray, cells: int) -> None:
        self.facets, self.beside, self.cells = facets, beside, cells
        self.count = cells + len(beside)
        """Cells of this rank and those beyond."""

    def swapped(self, values: np.ndarray) -> np.ndarray:
        """The other rank's values for each shared facet in place of ``values``, (shared facets, ...)."""
        return np.moveaxis(self.facets.others(np.moveaxis(values, 0, -1)), -1, 0)

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of cells, (cells, ...), and after them those of the cells beyond."""
        if not len(self.beside):
            return values
        return np.concatenate([values, self.swapped(values[self.beside])])

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of cells, (cells, ...), with what other ranks have of them, of ``rows`` (count, ...)."""
        if not len(self.beside):
            return rows
        result = rows[: self.cells].copy()
        np.add.at(result, self.beside, self.swapped(rows[self.cells :]))
        return result


class HaloUnknowns(Owned):
    """Unknowns of cells and of those beyond, equally many to each, one after the other.

    Matrices of these in parts have rows of cells beyond where this rank's cells couple such with each other.
    """

    def __init__(self, halo: Halo, per_cell: int) -> None:
        super().__init__(halo.count * per_cell, halo.facets.neighbours, halo.facets.communicator)
        self.halo, self.per_cell = halo, per_cell
        self.of_cells = halo.cells * per_cell
        """How many are those of this rank's cells."""

    @cached_property
    def owned(self) -> np.ndarray:
        return np.arange(self.count) < self.of_cells

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        return self.with_others(values[..., : self.of_cells])

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), and after them those of the cells beyond."""
        return self._by_cells(self.halo.with_others, values)

    def of_cells_alone(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), and zeros for the cells beyond."""
        beyond = np.zeros((*values.shape[:-1], self.count - self.of_cells), values.dtype)
        return np.concatenate([values, beyond], axis=-1)

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of this rank's cells with what other ranks have of them, of ``rows`` (..., count)."""
        return self._by_cells(self.halo.added, rows)

    def _by_cells(self, function: Callable[[np.ndarray], np.ndarray], values: np.ndarray) -> np.ndarray:
        """A function of (cells, functions, ...) for values (..., unknowns)."""
        if self.count == self.of_cells:
            return values
        by_cells = values.reshape(*values.shape[:-1], -1, self.per_cell)
        result = np.moveaxis(function(np.moveaxis(by_cells, (-2, -1), (0, 1))), (0, 1), (-2, -1))
        return np.ascontiguousarray(result).reshape(*result.shape[:-2], -1)


class Interpolation:
    """NGSolve's ``Set`` of functions of a continuous space, over ranks the same to the bit; collective.

    ``Set`` projects element by element and averages what elements share.  Over ranks NGSolve adds their parts
    in the order in which they come, which rounds three of them in one way or another.  So ranks that share an
    unknown with a third one set in turns, in which the others have zeros, and the turns are added in order.
    """

    def __init__(self, space: FESpace) -> None:
        self._turn, self._turns = _turns(Exchange.of(space, Communicator.of(space.mesh)))
        self._takes_part = Parameter(1.0)

    def __call__(
        self, function: GridFunction, value: CoefficientFunction, where: Region | None = None
    ) -> None:
        """Set a function of the space to values, on a part of the boundary where that is given."""
        if self._turns == 1:
            function.Set(value, definedon=where)
            return
        coefficients = function.vec.FV().NumPy()
        result = np.zeros_like(coefficients)
        for turn in range(self._turns):
            self._takes_part.Set(float(turn == self._turn))
            function.Set(self._takes_part * value, definedon=where)
            result += coefficients
        coefficients[:] = result


def _turns(exchange: Exchange) -> tuple[int, int]:
    """This rank's turn, not that of any that shares an unknown with it and a third, and their number."""
    if not exchange.is_distributed:
        return 0, 1
    is_crowded = exchange.sum(np.ones(exchange.count)) > 2
    near = [rank for rank, numbers in exchange.shared.items() if is_crowded[numbers].any()]
    turns: list[int] = []
    for rank, others in enumerate(exchange.communicator.gathered(near)):
        taken = {turns[other] for other in others if other < rank}
        turns.append(min(set(range(len(taken) + 1)) - taken))
    return turns[exchange.communicator.rank], max(turns) + 1

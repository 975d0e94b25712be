"""The one primitive of distributed vectors: unknowns that ranks share are summed over these ranks.

``ParallelDofs().Proc2Dof(r)`` lists the unknowns shared with rank r in equal order on both sides.  Each rank
sends its values of the shared unknowns and adds the received values in the order of the ranks.  Therefore all
ranks that share an unknown have bit for bit equal sums.

A vector is *summed* if every rank that shares an unknown has its full value, as on one process.  A vector is
*in parts* if the full value is the sum over these ranks, as for a residual assembled on each rank's cells.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import CF, VERTEX, CoefficientFunction, FESpace, GridFunction, Parameter, Region

from ngvisco.parallel.communicator import TRAFFIC, Communicator


class Owned(ABC):
    """Unknowns of this rank; each shared unknown is owned by one of the ranks that share it.

    Parameters
    ----------
    count : int
        Number of unknowns on this rank.
    neighbours : iterable of int
        Ranks that share some of the unknowns.
    """

    def __init__(self, count: int, neighbours: Iterable[int], communicator: Communicator) -> None:
        self.count, self.neighbours, self.communicator = count, frozenset(neighbours), communicator
        self.is_distributed = communicator.is_distributed

    @property
    @abstractmethod
    def owned(self) -> np.ndarray:
        """Whether this rank owns each unknown, (unknowns,)."""

    @abstractmethod
    def of_owners(self, values: np.ndarray) -> np.ndarray:
        """Value of each unknown on the rank that owns it; collective between neighbours."""

    def numbers(self, chosen: np.ndarray) -> tuple[np.ndarray, int]:
        """Global numbers of the ``chosen`` unknowns, and their count over all ranks; collective.

        The numbers of the unknowns of one owner are consecutive, rank after rank.
        """
        mine = chosen & self.owned
        counts = self.communicator.gathered(int(np.count_nonzero(mine)))
        numbers = np.zeros(self.count)
        numbers[mine] = sum(counts[: self.communicator.rank]) + np.arange(np.count_nonzero(mine))
        return self.of_owners(numbers).astype(np.int64), sum(counts)


class Exchange(Owned):
    """Sums of unknowns over the ranks that share them; on one process values stay as they are.

    Parameters
    ----------
    count : int
        Number of unknowns of this rank.
    shared : mapping of ranks to arrays of int
        Unknowns shared with each neighbour, in equal order on both ranks.
    """

    def __init__(self, count: int, shared: Mapping[int, np.ndarray], communicator: Communicator) -> None:
        self.shared = {rank: numbers for rank, numbers in shared.items() if len(numbers)}
        super().__init__(count, self.shared, communicator)

    @classmethod
    def of(cls, space: FESpace, communicator: Communicator) -> Exchange:
        """The exchange of a space's unknowns over the ``communicator`` of its mesh."""
        if not communicator.is_distributed:
            return cls(space.ndof, {}, communicator)
        return cls.of_dofs(space.ParallelDofs(), space.ndof, communicator)

    @classmethod
    def of_dofs(cls, dofs: Any, count: int, communicator: Communicator) -> Exchange:
        """The exchange of unknowns given by NGSolve's ``ParallelDofs``."""
        ranks = [rank for rank in range(communicator.size) if rank != communicator.rank]
        shared = {rank: np.array(dofs.Proc2Dof(rank), dtype=np.int64) for rank in ranks}
        return cls(count, shared, communicator)

    def part(self, numbers: np.ndarray) -> Exchange:
        """The exchange of the unknowns with these ``numbers`` alone.

        All ranks that share an unknown have to choose it, in equal order.
        """
        if not self.shared:
            return Exchange(len(numbers), {}, self.communicator)
        place = np.full(self.count, -1, dtype=np.int64)
        place[numbers] = np.arange(len(numbers))
        shared = {rank: place[unknowns] for rank, unknowns in self.shared.items()}
        chosen = {rank: unknowns[unknowns >= 0] for rank, unknowns in shared.items()}
        return Exchange(len(numbers), chosen, self.communicator)

    @cached_property
    def owned(self) -> np.ndarray:
        """Whether this rank is the lowest that has the unknown, (unknowns,)."""
        if not self.shared:
            return np.broadcast_to(np.True_, self.count)  # one byte of memory
        mine = np.ones(self.count, dtype=bool)
        for rank, numbers in self.shared.items():
            if rank < self.communicator.rank:
                mine[numbers] = False
        return mine

    @cached_property
    def places(self) -> np.ndarray:
        """The unknowns that this rank shares with other ranks, (shared unknowns,)."""
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *self.shared.values()]))

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        return self.sum(np.where(self.owned, values, 0.0)) if self.shared else values

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sums of all ranks' values, (..., unknowns); collective between neighbours."""
        if not self.shared:
            return values
        got = self._got({rank: values[..., unknowns] for rank, unknowns in self.shared.items()})
        result = np.array(values)
        result[..., self.places] = 0.0
        for rank in sorted([*got, self.communicator.rank]):  # the order is the same on every rank
            if rank == self.communicator.rank:
                result[..., self.places] += values[..., self.places]
            else:
                result[..., self.shared[rank]] += got[rank]
        return result

    def others(self, values: np.ndarray) -> np.ndarray:
        """Values of the shared unknowns on the neighbouring rank, (..., shared unknowns).

        Each unknown has to be shared by two ranks only, as unknowns of facets are.
        """
        among = {rank: np.searchsorted(self.places, unknowns) for rank, unknowns in self.shared.items()}
        result, got = np.zeros_like(values), self._got({rank: values[..., at] for rank, at in among.items()})
        for rank, where in among.items():
            result[..., where] += got[rank]
        return result

    def _got(self, values: dict[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Send arrays to the neighbours, and return the arrays received from them, by rank."""
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

    def products(self, several: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Inner products, (n,), of summed vectors ``several``, (n, unknowns), with ``vector``; collective."""
        if not self.is_distributed:
            return several @ vector
        return self.communicator.products(several, np.where(self.owned, vector, 0.0))

    def norm(self, values: np.ndarray, where: slice = slice(None)) -> float:
        """Euclidean norm of a summed vector, or of a slice of the vector; collective."""
        part = values[where]
        return self.communicator.norm(part[self.owned[where]] if self.is_distributed else part)

    def length(self, where: slice = slice(None)) -> int:
        """Number of unknowns on all ranks, or of a slice of the unknowns; collective."""
        return int(self.communicator.total(int(np.count_nonzero(self.owned[where]))))


class Halo:
    """The halo cells: cells of other ranks across the facets that a rank shares; none on one process.

    Halo cells are numbered after the rank's own cells, in the order of the facets; a cell across two facets
    is counted twice.  A rank receives values of halo cells, and sends back contributions to the rows of these
    cells.

    Parameters
    ----------
    facets : Exchange
        Exchange of one value per facet.
    beside : (shared facets,) array of int
        This rank's cell at each of ``facets.places``.
    cells : int
        Number of this rank's cells.
    """

    def __init__(self, facets: Exchange, beside: np.ndarray, cells: int) -> None:
        self.facets, self.beside, self.cells = facets, beside, cells
        self.count = cells + len(beside)
        """Number of own and halo cells."""

    def swapped(self, values: np.ndarray) -> np.ndarray:
        """Exchange ``values`` of shared facets, (shared facets, ...), for the values of the other rank."""
        return np.moveaxis(self.facets.others(np.moveaxis(values, 0, -1)), -1, 0)

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of own cells, (cells, ...), followed by values of the halo cells."""
        return np.concatenate([values, self.swapped(values[self.beside])]) if len(self.beside) else values

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of own cells, (cells, ...), from ``rows``, (count, ...), plus other ranks' contributions."""
        if not len(self.beside):
            return rows
        result = rows[: self.cells].copy()
        np.add.at(result, self.beside, self.swapped(rows[self.cells :]))
        return result


class HaloUnknowns(Owned):
    """Unknowns of own and halo cells, in the order of the cells, with an equal number for each cell.

    A matrix in parts has rows of halo cells if this rank's cells couple halo cells with each other.
    """

    def __init__(self, halo: Halo, per_cell: int) -> None:
        super().__init__(halo.count * per_cell, halo.facets.neighbours, halo.facets.communicator)
        self.halo, self.per_cell = halo, per_cell
        self.of_cells = halo.cells * per_cell
        """Number of unknowns of this rank's own cells."""

    @cached_property
    def owned(self) -> np.ndarray:
        return np.arange(self.count) < self.of_cells

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        return self.with_others(values[..., : self.of_cells])

    def with_others(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), followed by values of the halo cells."""
        return self._by_cells(self.halo.with_others, values)

    def of_cells_alone(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's cells, (..., unknowns), followed by zeros for the halo cells."""
        beyond = np.zeros((*values.shape[:-1], self.count - self.of_cells), values.dtype)
        return np.concatenate([values, beyond], axis=-1)

    def added(self, rows: np.ndarray) -> np.ndarray:
        """Rows of this rank's cells with other ranks' contributions added; ``rows`` is (..., count)."""
        return self._by_cells(self.halo.added, rows)

    def _by_cells(self, function: Callable[[np.ndarray], np.ndarray], values: np.ndarray) -> np.ndarray:
        """Apply a function of arrays (cells, functions, ...) to values (..., unknowns)."""
        if self.count == self.of_cells:
            return values
        by_cells = values.reshape(*values.shape[:-1], -1, self.per_cell)
        result = np.moveaxis(function(np.moveaxis(by_cells, (-2, -1), (0, 1))), (0, 1), (-2, -1))
        return np.ascontiguousarray(result).reshape(*result.shape[:-2], -1)


_LEAST = 0.1
"""A bound below 1/4, the least share of a vertex's value that ``Set`` keeps, in cells of four vertices."""


class Interpolation:
    """NGSolve's ``Set`` of functions of a continuous space, reproducible to the bit over ranks; collective.

    ``Set`` projects element by element and averages shared unknowns.  NGSolve adds the ranks' parts in the
    order of the messages, so that the sum of three parts is rounded in varying ways.  Ranks that share an
    unknown with two others therefore call ``Set`` in turns, with zeros on all other ranks, and the results
    are added in the order of the turns.

    A cell that meets its own periodic image has the unknown of a vertex twice: ``Set`` then adds the vertex's
    value once, but divides by the number of times. Applied to the function 1, ``Set`` gives the share that it
    keeps of each value.  Edges and faces of one cell are never images of each other.
    """

    def __init__(self, space: FESpace) -> None:
        communicator = Communicator.of(space.mesh)
        self._turn, self._turns = _turns(Exchange.of(space, communicator))
        self._takes_part = Parameter(1.0)
        self._is_periodic = communicator.total(len(list(space.mesh.GetPeriodicNodePairs(VERTEX)))) > 0

    def __call__(
        self, function: GridFunction, value: CoefficientFunction, where: Region | None = None
    ) -> None:
        """Set a function of the space to values, everywhere or in the region ``where``."""
        if self._is_periodic:
            self._set(function, CF((1.0,) * value.dim), where)
            kept = function.vec.FV().NumPy().copy()
            self._set(function, value, where)
            function.vec.FV().NumPy()[:] /= np.where(kept > _LEAST, kept, 1.0)
        else:
            self._set(function, value, where)

    def _set(self, function: GridFunction, value: CoefficientFunction, where: Region | None) -> None:
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
    """This rank's turn, and the number of turns.  Ranks that share an unknown with two or more others have
    different turns."""
    if not exchange.is_distributed:
        return 0, 1
    is_crowded = exchange.sum(np.ones(exchange.count)) > 2
    near = [rank for rank, numbers in exchange.shared.items() if is_crowded[numbers].any()]
    turns: list[int] = []
    for rank, neighbours in enumerate(exchange.communicator.gathered(near)):
        used = {turns[neighbour] for neighbour in neighbours if neighbour < rank}
        turns.append(min(set(range(len(used) + 1)) - used))
    return turns[exchange.communicator.rank], max(turns) + 1

"""The one primitive of distributed vectors: what ranks share of a space's unknowns is summed up.

``ParallelDofs().Proc2Dof(r)`` lists the unknowns shared with rank r in the same order on both sides.  Each
rank sends its own values of them and adds what it gets, so that all ranks which share an unknown have the
same sum up to its order, which is that of the ranks: bit for bit the same.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import FESpace

from ngvisco.parallel.communicator import TRAFFIC, Communicator


class Exchange:
    """Sums of a space's unknowns over the ranks that share them; on one process nothing is done.

    Parameters
    ----------
    space : FESpace
        Of a distributed mesh, or any.
    communicator : Communicator
        That of the mesh.
    """

    def __init__(self, space: FESpace, communicator: Communicator) -> None:
        self.communicator, self.count = communicator, space.ndof
        self.shared: dict[int, np.ndarray] = {}
        """Unknowns shared with each neighbour."""
        if communicator.is_distributed:
            dofs = space.ParallelDofs()
            for rank in range(communicator.size):
                if rank != communicator.rank and len(own := dofs.Proc2Dof(rank)):
                    self.shared[rank] = np.array(own, dtype=np.int64)

    @cached_property
    def owned(self) -> np.ndarray:
        """Where this rank is the lowest of those that hold the unknown, (unknowns,)."""
        mine = np.ones(self.count, dtype=bool)
        for rank, numbers in self.shared.items():
            if rank < self.communicator.rank:
                mine[numbers] = False
        return mine

    def of_owners(self, values: np.ndarray) -> np.ndarray:
        """Of every unknown the value of the rank that owns it; collective between neighbours."""
        return self.sum(np.where(self.owned, values, 0.0)) if self.shared else values

    def sum(self, values: np.ndarray) -> np.ndarray:
        """The sums of all ranks' values, (..., unknowns); collective between neighbours."""
        if not self.shared:
            return values
        mpi = self.communicator.mpi
        sent = {rank: np.ascontiguousarray(values[..., own]) for rank, own in self.shared.items()}
        got = {rank: np.empty_like(part) for rank, part in sent.items()}
        requests = [mpi.Irecv(part, rank) for rank, part in got.items()]
        requests += [mpi.Isend(part, rank) for rank, part in sent.items()]
        for request in requests:
            request.Wait()
        TRAFFIC.messages += len(sent)
        TRAFFIC.bytes += sum(part.nbytes for part in sent.values())
        result = np.array(values)
        result[..., self._all_shared] = 0.0
        for rank in sorted([*got, self.communicator.rank]):  # the same order on every rank
            if rank == self.communicator.rank:
                result[..., self._all_shared] += values[..., self._all_shared]
            else:
                result[..., self.shared[rank]] += got[rank]
        return result

    @cached_property
    def _all_shared(self) -> np.ndarray:
        return np.unique(np.concatenate(list(self.shared.values())))

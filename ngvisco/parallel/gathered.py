"""A small problem of all ranks: every rank gathers and solves the whole problem.

Each rank gets equal data in an equal order, and therefore equal bits of the solution, without a message in
the solver.  The problem must be small compared with a step, such as a problem with one unknown per vertex.
"""

import numpy as np
import scipy.sparse as sp

from ngvisco.parallel.exchange import Exchange


class Gathered:
    """Unknowns of all ranks, in one numbering; on one process all arrays stay as they are.

    Parameters
    ----------
    exchange : Exchange
        Exchange of this rank's unknowns.
    """

    def __init__(self, exchange: Exchange) -> None:
        self.ranks, self._is_distributed = exchange.communicator, exchange.is_distributed
        self._numbers, self.count = exchange.numbers(np.ones(exchange.count, dtype=bool))

    def matrix(self, part: sp.csr_matrix) -> sp.csr_matrix:
        """The sum of all ranks' parts of a matrix, (count, count), from this rank's part; collective."""
        if not self._is_distributed:
            return part
        entries = part.tocoo()
        mine = entries.data, self._numbers[entries.row], self._numbers[entries.col]
        data, rows, columns = (
            np.concatenate(all_of) for all_of in zip(*self.ranks.gathered(mine), strict=True)
        )
        return sp.coo_matrix((data, (rows, columns)), shape=(self.count, self.count)).tocsr()

    def sum(self, values: np.ndarray) -> np.ndarray:
        """Sums of all ranks' values, (count,), from values in parts, (unknowns,); collective."""
        return self._joined(values, np.add, 0.0)

    def least(self, values: np.ndarray) -> np.ndarray:
        """Least value of each unknown on any rank, (count,), from values, (unknowns,); collective."""
        return self._joined(values, np.minimum, np.inf)

    def here(self, values: np.ndarray) -> np.ndarray:
        """Values of this rank's unknowns, (unknowns,), from the values of all unknowns, (count,)."""
        return values[self._numbers] if self._is_distributed else values

    def _joined(self, values: np.ndarray, how: np.ufunc, start: float) -> np.ndarray:
        if not self._is_distributed:
            return values
        result = np.full(self.count, start)
        for numbers, of_rank in self.ranks.gathered((self._numbers, values)):
            how.at(result, numbers, of_rank)
        return result

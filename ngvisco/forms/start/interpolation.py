"""Interpolation in spaces of continuous functions: NGSolve's ``Set``, over ranks the same to the bit.

``Set`` projects element by element and averages what elements share.  Over ranks NGSolve adds their parts in
the order in which they come, which rounds three of them in one way or another.  So ranks that share an
unknown with a third one set in turns, in which the others have zeros, and the turns are added in their order.
"""

import numpy as np
from ngsolve import CoefficientFunction, FESpace, GridFunction, Parameter, Region

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange


class Interpolation:
    """Sets functions of a space; collective."""

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

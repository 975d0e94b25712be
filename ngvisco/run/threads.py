"""Threads of a computation: NGSolve's for assembly, and one for the BLAS of the direct solver.

NGSolve's task threads wait actively; a BLAS that starts its own threads beside them takes the cores from
both (measured beside other work on two cores: the swirl demo in 9 min 52 s against 2 min 10 s).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ngsolve import TaskManager
from threadpoolctl import ThreadpoolController

_controller: list[ThreadpoolController] = []


@contextmanager
def computing() -> Iterator[None]:
    """Within: NGSolve's task manager runs, BLAS libraries use one thread; restored on leaving."""
    if not _controller:  # made late, when NGSolve and NumPy have loaded their libraries
        _controller.append(ThreadpoolController())
    with _controller[0].limit(limits=1, user_api="blas"), TaskManager():
        yield

"""Threads of a computation: NGSolve's for assembly, one for arrays and the BLAS.

NGSolve's task threads wait actively; a BLAS that starts its own threads beside them takes the cores from
both (measured beside other work on two cores: the swirl demo in 9 min 52 s against 2 min 10 s).  Array
products have one thread, which NGSolve's workers must not disturb: ``on_arrays`` ends these.  Sent to sleep,
they would be waited for by what NGSolve does meanwhile: 6.6 ms in place of 0.2 for a factorisation's solution
with 2,754 unknowns.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from ngsolve import TaskManager
from pyngcore import GetNumThreads, SetNumThreads, SuspendTaskManager
from threadpoolctl import ThreadpoolController

_controller: list[ThreadpoolController] = []
_managers: list[TaskManager] = []  # ours, while its workers run


@contextmanager
def computing() -> Iterator[None]:
    """Within: NGSolve's task manager runs, BLAS libraries use one thread; restored on leaving."""
    if not _controller:  # made late, when NGSolve and NumPy have loaded their libraries
        _controller.append(ThreadpoolController())
    with _controller[0].limit(limits=1, user_api="blas"):
        if _managers or GetNumThreads() > 1:  # it runs: ours, or one of the caller's
            yield
            return
        manager = TaskManager()
        with manager:
            _managers.append(manager)
            try:
                yield
            finally:
                _managers.remove(manager)


@contextmanager
def on_arrays() -> Iterator[None]:
    """Within: NGSolve works alone, also at a factorisation, whose bits would be chance's by several threads.

    Workers of a task manager of the caller's sleep.
    """
    if not _managers:
        with SuspendTaskManager():
            yield
        return
    manager, threads = _managers.pop(), GetNumThreads()
    manager.__exit__(None, None, None)
    SetNumThreads(1)
    try:
        with TaskManager():
            yield
    finally:
        SetNumThreads(threads)
        manager.__enter__()
        _managers.append(manager)

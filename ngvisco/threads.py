"""Threads of a computation: NGSolve's for assembly, one for the BLAS, those that share arrays' parts.

NGSolve's task threads wait actively; a BLAS that starts its own threads beside them takes the cores from
both (measured beside other work on two cores: the swirl demo in 9 min 52 s against 2 min 10 s).  What
works on arrays must not be disturbed by NGSolve's workers: ``on_arrays`` ends these.  Sent to sleep, they
would be waited for by what NGSolve does meanwhile: 6.6 ms in place of 0.2 for a factorisation's solution with
2,754 unknowns.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import RLock
from typing import TypeVar

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


_Part = TypeVar("_Part")
_Result = TypeVar("_Result")

ALONE = RLock()
"""Held by the one of some workers that asks NGSolve for something, or makes what all of them read."""


class Workers:
    """Threads that share parts of a mesh, each of which is worked on by arrays alone."""

    def __init__(self, threads: int | None = None, beside: int = 1) -> None:
        """Start the threads; by default ``NGVISCO_THREADS``, or the processors over ``beside`` processes that
        share them."""
        if threads is None:
            own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
            threads = int(os.environ.get("NGVISCO_THREADS", 0)) or max(1, own // beside)
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def map(self, work: Callable[[_Part], _Result], parts: Sequence[_Part]) -> list[_Result]:
        """``work`` of every part, in order."""
        if self._pool is None or len(parts) < 2:
            return [work(part) for part in parts]
        others = [self._pool.submit(copy_context().run, work, part) for part in parts[1:]]
        return [work(parts[0]), *(each.result() for each in others)]

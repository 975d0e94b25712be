"""Threads of a computation: NGSolve's for assembly, one for the BLAS, and the package's for work on arrays.

NGSolve's task threads wait actively and compete with threads of the BLAS for cores (measured beside other
work on two cores: the swirl demo takes 9 min 52 s with both, 2 min 10 s with one BLAS thread).  Work on
arrays must not compete with NGSolve's workers, so ``on_arrays`` ends the package's workers.  If ``on_arrays``
only suspended these workers, calls of NGSolve would wait for them: a solution with a factorisation of 2,754
unknowns would take 6.6 ms instead of 0.2 ms.

After the import of this package, NGSolve has one thread, unless ``NGS_NUM_THREADS`` is set or the caller
calls ``SetNumThreads`` afterwards.  With one thread, a resumed run is the uninterrupted one bit for bit, and
a small run is not slowed down by other processes: beside a dozen processes on two cores, 36 triangles were
set up in 0.2 s by one thread and in 10 s by two.
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

if "NGS_NUM_THREADS" not in os.environ:
    SetNumThreads(1)

_controller: list[ThreadpoolController] = []
_managers: list[TaskManager] = []  # the package's task manager, while its workers run


@contextmanager
def computing() -> Iterator[None]:
    """Context in which NGSolve's task manager runs and the BLAS uses one thread; restored on leaving."""
    if not _controller:  # made here, after NGSolve and NumPy have loaded their libraries
        _controller.append(ThreadpoolController())
    with _controller[0].limit(limits=1, user_api="blas"):
        if _managers or GetNumThreads() > 1:  # the task manager of the package or of the caller runs
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
    """Context in which NGSolve uses one thread; factorisations are then reproducible to the bit.

    If the caller's task manager runs, its workers are suspended.
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
"""Lock that a worker holds while it calls NGSolve, or while it makes data that all workers use."""


class Workers:
    """Threads that divide the parts of a mesh among themselves, and compute with arrays."""

    def __init__(self, threads: int | None = None, beside: int = 1) -> None:
        """Start the threads. Their default number is ``NGVISCO_THREADS``, or the number of processors divided
        by the number ``beside`` of processes that share them."""
        if threads is None:
            count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
            threads = int(os.environ.get("NGVISCO_THREADS", 0)) or max(1, count // beside)
        self.threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def map(self, work: Callable[[_Part], _Result], parts: Sequence[_Part]) -> list[_Result]:
        """Results of ``work`` for every part, in order.  The calling thread takes the first part."""
        if self._pool is None or len(parts) < 2:
            return [work(part) for part in parts]
        results, left = dict[int, _Result](), iter(range(1, len(parts)))

        def take(index: int | None) -> None:
            while index is not None:
                results[index] = work(parts[index])
                index = next(left, None)

        futures = [
            self._pool.submit(copy_context().run, take, next(left, None))
            for _ in range(min(self.threads, len(parts)) - 1)
        ]
        take(0)
        for future in futures:
            future.result()
        return [results[index] for index in range(len(parts))]

"""Threads of a computation: NGSolve's for assembly, ours for arrays, and one for the BLAS.

NGSolve's task threads wait actively; a BLAS that starts its own threads beside them takes the cores from
both (measured beside other work on two cores: the swirl demo in 9 min 52 s against 2 min 10 s).  Large array
products are shared among as many threads of Python as NGSolve has, which its workers must not keep busy:
``on_arrays`` ends these.  Sent to sleep, they would be waited for by what NGSolve does meanwhile: 6.6 ms in
place of 0.2 for a factorisation's solution with 2,754 unknowns.  Results do not depend on the number of
threads: every row of a product is the work of one.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from functools import partial
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from ngsolve import TaskManager
from pyngcore import GetNumThreads, SetNumThreads, SuspendTaskManager
from threadpoolctl import ThreadpoolController

SMALL = 200_000
"""Multiplications below which a product is not shared: waking a thread takes as long."""

_controller: list[ThreadpoolController] = []
_pools: dict[int, ThreadPoolExecutor] = {}
_managers: list[TaskManager] = []  # ours, while its workers run
_at_leisure: list[int] = []  # how many threads NGSolve had before they were ended
_busy = Event()  # two pieces of work run at once: no thread is left for more


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
    manager, threads, free = _managers.pop(), GetNumThreads(), _count()
    manager.__exit__(None, None, None)
    _at_leisure.append(free)
    SetNumThreads(1)
    try:
        with TaskManager():
            yield
    finally:
        _at_leisure.pop()
        SetNumThreads(threads)
        manager.__enter__()
        _managers.append(manager)


def _count() -> int:
    """Threads that array products may have."""
    return _at_leisure[-1] if _at_leisure else GetNumThreads()


def _pays(size: float) -> bool:
    """Whether work of so many multiplications is worth other threads, of which there are some at leisure."""
    return size >= SMALL and not _busy.is_set() and _count() > 1


def shared(work: Callable[[slice], Any], count: int, size: float) -> None:
    """Call ``work`` with slices that make up range(count), each in a thread of its own.

    Parameters
    ----------
    work : callable
        Takes a slice; large products of NumPy and SciPy in it run at the same time.
    count : int
        What is shared out, cells or rows.
    size : float
        Multiplications in all: small products are not shared.
    """
    if not _pays(size) or count < _count():
        work(slice(0, count))
        return
    threads = _count()
    ends = np.linspace(0, count, threads + 1).astype(int)
    slices = [slice(a, b) for a, b in pairwise(ends)]
    others = [_submit(threads, partial(work, s)) for s in slices[1:]]
    work(slices[0])
    for other in others:
        other.result()


def concurrently(first: Callable[[], Any], second: Callable[[], Any], size: float) -> tuple[Any, Any]:
    """Results of two pieces of work that do not touch each other's arrays, one thread each.

    ``size`` is as for ``shared``; what the pieces share out among threads themselves stays in theirs.
    """
    if not _pays(size):
        return first(), second()
    _busy.set()
    other = _submit(_count(), second)
    try:
        mine = first()
    finally:
        other.exception()  # waits
        _busy.clear()
    return mine, other.result()


def _submit(threads: int, work: Callable[[], Any]) -> Future[Any]:
    """Start ``work`` beside the caller, with the caller's treatment of floating-point errors."""
    if threads not in _pools:
        _pools[threads] = ThreadPoolExecutor(threads - 1, thread_name_prefix="ngvisco")
    return _pools[threads].submit(copy_context().run, work)


def product(matrices: np.ndarray, vectors: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """np.matmul of stacks of small matrices, (count, ., .), shared by the first index."""
    shape = (len(matrices), matrices.shape[1], vectors.shape[2])
    if not _pays(shape[0] * shape[1] * shape[2] * matrices.shape[2]):
        return np.matmul(matrices, vectors, out=out)
    if out is None:
        out = np.empty(shape, np.result_type(matrices, vectors))

    def work(s: slice) -> None:
        np.matmul(matrices[s], vectors[s], out=out[s])

    shared(work, len(matrices), out.size * matrices.shape[2])
    return out

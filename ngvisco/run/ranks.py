"""What one rank of a run meets alone, made known to all of them."""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from ngvisco.errors import NgviscoError
from ngvisco.parallel.communicator import OF_ALL_RANKS, Communicator

if TYPE_CHECKING:
    from ngvisco.run.simulation import Observer, Simulation

_FAILED, _INTERRUPTED = 1, 130


def tell(simulation: Simulation, observer: Observer, what: Callable[..., None], *arguments: object) -> None:
    """Call an observer's method; what it raises on one rank is raised on all of them."""
    ranks = simulation.ranks
    if not ranks.is_distributed:
        what(simulation, *arguments)
        return
    failure: BaseException | None = None
    try:
        if ranks.is_first or not getattr(observer, "on_first_rank", False):
            what(simulation, *arguments)
    except BaseException as error:
        failure = error
    together = ranks.agree(failure)
    if together is not None:
        raise together from failure


def is_to_stop(simulation: Simulation) -> bool:
    """Whether some rank was asked to stop, as by a signal, and now all are."""
    simulation.stop_requested = simulation.ranks.any(simulation.stop_requested)
    return simulation.stop_requested


@contextlib.contextmanager
def ending_all_ranks() -> Iterator[None]:
    """Within: work in which ranks wait for each other; what one of them meets alone ends all."""
    try:
        yield
    except BaseException as error:
        abort_alone(error)
        raise


def abort_alone(error: BaseException, ranks: Communicator | None = None) -> None:
    """End all ranks for what one of them has met in a computation, in which the others wait for it.

    What ngvisco raises is decided by all ranks together, and is not such an error.
    """
    if isinstance(error, NgviscoError) or OF_ALL_RANKS in vars(error):
        return
    ranks = ranks or Communicator.world()
    if ranks.is_distributed:
        traceback.print_exception(error)
        sys.stderr.flush()
        ranks.abort(_INTERRUPTED if isinstance(error, KeyboardInterrupt) else _FAILED)

"""Solutions along a parameter: each is the start value of the next, up to the problem itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ngsolve import BaseVector

from ngvisco.errors import StepError

MAX_CONTINUATION = 20
"""Values of a parameter tried on the way to a start value."""


@dataclass(frozen=True)
class Way:
    """Values of a parameter on the way to 1, where it is the problem itself.

    Parameters
    ----------
    first, retreat, furthest : float
        While nothing is solved, ``first`` is multiplied by ``retreat``, up to ``furthest``.
    ratio : float
        The next value over the last one at most, while steps succeed.
    tries : int
        Values tried in all.
    """

    first: float
    retreat: float
    furthest: float
    ratio: float
    tries: int = MAX_CONTINUATION


def follow(
    solve: Callable[[float], None],
    way: Way,
    state: BaseVector,
    restore: Callable[[BaseVector], None],
    leap: Callable[[], None] | None = None,
) -> None:
    """Solve for a parameter that goes to 1 along ``way``, each time from the solution before.

    Parameters
    ----------
    solve : callable
        Solves for a value from the present ``state``; raises StepError.
    state : BaseVector
        The start value, and the solution in the end.
    restore : callable
        Makes given values the present state.
    leap : callable, optional
        Solves for 1 at once; it is tried from each solution that damped steps do not lead on from.

    Raises
    ------
    StepError
        The last failure, when the way does not lead to 1.
    """
    guess = state.CreateVector()
    guess.data = state
    value, solved, power = way.first, 0.0, 1.0
    failure: StepError | None = None
    for _ in range(way.tries):
        restore(guess)
        try:
            solve(value)
        except StepError as error:
            failure = error
            if not solved and value == way.furthest:
                break
            if not solved:
                value *= way.retreat
                continue
            power /= 2
            if leap is not None:
                restore(guess)
                try:
                    leap()
                    return
                except StepError as fault:
                    failure = fault
        else:
            if value == 1.0:
                return
            guess.data = state
            solved, power = value, min(1.0, 1.5 * power)
        value = solved * way.ratio**power
        if (value < 1.0) == (way.ratio < 1.0):  # at or beyond the end of the way
            value = 1.0
    assert failure is not None
    raise StepError(str(failure))

"""The split solver's iteration: x - f(x), until the increment f is small.

f(x) = P^{-1} R(x) is Newton's increment of the unknowns x but for a coarser rule and a fixed number of
sweeps.  An iterate whose increment is ``growth`` times the smallest one is given up for one nearer to the best.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ngvisco.solver.solution import NewtonIteration, Problem, Status

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options = split.options
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # the smallest increment's size, its iterate, and it
    while len(history) < options.max_iterations:
        fresh = not split.is_factorised
        f, size = split.increment(problem, x, last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        if size <= options.sides and problem.turns():
            split.residual.start()
            last, best = np.inf, (np.inf, x, x)
        elif split.has_converged(f, size, last, best[0]):
            split.residual.put(x - f)
            return Status.CONVERGED
        elif size <= options.split.growth * best[0]:
            best = min(best, (size, x, f), key=lambda one: one[0])
            split.wear(f, size)
            x, last = x - f, size
        elif best[0] == np.inf:
            return Status.NOT_FINITE
        elif halvings == options.split.halvings:
            return Status.STALLED
        else:
            halvings += 1
            x, last = best[1] - 0.5**halvings * best[2], np.inf
            split.reset()
    return Status.TOO_MANY_ITERATIONS

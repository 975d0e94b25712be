"""The split solver's iteration: x - f(x), until the increment f is small.

f(x) = P^{-1} R(x) is Newton's increment of the unknowns x but for a coarser rule and a fixed number of
sweeps.  An iterate at which it is no number, or much longer than the smallest one, is given up for one nearer
to the best.  Where it is slow, Newton-Krylov takes over.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ngvisco.solver.solution import NewtonIteration, Problem, Status
from ngvisco.solver.split.newton_krylov import newton_krylov

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options = split.options.split
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # the smallest increment's size, its iterate, and it
    while len(history) < split.options.max_iterations:
        if len(history) > options.slow and last <= options.krylov.largest:
            return newton_krylov(split, problem, x, history)
        fresh = not split.is_factorised
        f, size = split.increment(problem, x, last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        if size <= options.growth * max(best[0], options.linearised_above):
            new = x - f
            split.unknowns.unpack(new)
            if problem.changes(size):
                split.residual.start()
            elif split.has_converged(f, size, min(last, best[0])):
                split.residual.put(new)
                return Status.CONVERGED
            split.wear(f, size)
            best = min(best, (size, x, f), key=lambda one: one[0])
            x, last = new, size
        elif best[0] == np.inf:
            return Status.NOT_FINITE
        elif halvings == options.halvings:
            near = best[0] <= options.krylov.largest
            return newton_krylov(split, problem, best[1], history) if near else Status.STALLED
        else:
            halvings += 1
            x, last = best[1] - 0.5**halvings * best[2], np.inf
            split.reset()
    return Status.TOO_MANY_ITERATIONS

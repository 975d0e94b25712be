"""The split solver's iteration x - f(x), until the increment f is small, and Newton-Krylov where it is slow.

f(x) = P^{-1} R(x) is Newton's increment of the unknowns x but for a coarser rule and a fixed number of
sweeps.  Its length is held by its power where a steep flow rule bends it (``Split.evaluated``).  Elsewhere an
iterate at which it is no number, or much longer than the smallest one, is given up for one nearer to the
best.  In Newton-Krylov GMRES takes P^{-1} dR d with complex increments of R (``ReducedResidual.derivative``),
to which P is the preconditioner.  What needs it are creep rate fields (nu > 0), whose coupling to v P leaves
out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ngvisco.algebra.krylov import gmres
from ngvisco.reduced.residual import Evaluation
from ngvisco.solver.problem import NewtonIteration, Problem, Status

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split

TOLERANCE, _DIRECTIONS = 0.01, 40
"""Of Newton-Krylov's linear systems, and derivatives taken for one at most; with 0.1 one of six long steps
failed."""
INNER = 3e-4, 1e-6
"""Tolerances of the flow's and the fields' systems in P, which has to be a linear map: where a flow rule is
steep, P times the derivative has single eigenvalues of 1e2 to 1e4, which multiply what is not linear."""
_ROUNDED = 0.01
"""Tolerances to which an increment has fallen where nothing shortens it any more but rounding, at a steep
flow rule; elsewhere one."""
_FAR = 0.01
"""Increment up to which ``growth`` is over the smallest one."""
_WINDOW, _MIN_DAMPING = 4, 0.05
"""Iterations that shorten an increment to a fifth, or it gives up; smallest step length tried."""


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x``, where the tangent is made anew; the state becomes the solution, or some iterate."""
    options, tolerance = split.options.split, split.options.tolerance
    scale, inner = split.unknowns.scales(x, split.residual.exchange), INNER[split.is_steep]

    def solved(at: Evaluation) -> np.ndarray:
        return split.preconditioner(at, inner, inner)

    def renewed(at: Evaluation) -> tuple[np.ndarray, float]:
        split.renew(problem, at)
        f = solved(at)
        return f, split.size(f)

    at = split.residual(x)
    f, size = renewed(at)
    sizes = [size]
    while len(history) < split.options.max_iterations:
        sharp = split.sharpness
        rounded = max(sharp, _ROUNDED) * tolerance
        derivative = split.residual.derivative(at)

        def along(d: np.ndarray, derivative: Any = derivative, at: Evaluation = at) -> np.ndarray:
            return solved(replace(at, residual=derivative(scale * d))) / scale

        products = split.residual.exchange.products
        d, _ = gmres(along, f / scale, rtol=TOLERANCE, directions=_DIRECTIONS, products=products)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new = split.residual(new_x)
            new_f = solved(new)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < _MIN_DAMPING or size <= rounded:
                return _ends_at(split, x, size <= rounded)
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        at, x, f, size = new, new_x, new_f, new_size
        if problem.changes(size):
            split.residual.start()
            at = split.residual(x)
        elif size <= options.margin * sharp * tolerance:
            return _ends_at(split, x - f, True)
        sizes.append(size)
        window = _WINDOW * (3 if split.norm.shared else 1)  # increments of Pi rise in between
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(0.2 * before, options.rounding):
            return _ends_at(split, x, size <= rounded)
        f, size = renewed(at)
    return Status.TOO_MANY_ITERATIONS


def _ends_at(split: Split, x: np.ndarray, converged: bool) -> Status:
    """Make x, with the unknowns that it determines, the state."""
    split.residual.put(x)
    return Status.CONVERGED if converged else Status.STALLED


def iterate(split: Split, problem: Problem, history: list[NewtonIteration]) -> Status:
    """Iterate from the present state, which becomes the solution, or some iterate; ``history`` grows."""
    options = split.options.split
    x = split.unknowns.pack()
    last, halvings = np.inf, 0
    best = np.inf, x, x  # the smallest increment's size, its iterate, and it
    while len(history) < split.options.max_iterations:
        if len(history) > options.slow and last <= options.krylov_below:
            return newton_krylov(split, problem, x, history)
        x, at, held = split.evaluated(x)
        fresh = not split.is_factorised
        f, size = split.increment(problem, x, at, last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        if held or size <= options.growth * max(best[0], _FAR):
            new = x - f
            split.unknowns.unpack(new)
            if problem.changes(size):
                split.residual.start()
            elif split.has_converged(f, size, min(last, best[0])):
                split.residual.put(new)
                return Status.CONVERGED
            elif split.is_steep and 0.5 * best[0] < size <= options.rounding:
                return newton_krylov(split, problem, new, history)  # single precision ends here
            split.wear(f, size)
            best = min(best, (size, x, f), key=lambda one: one[0])
            x, last = new, size
        elif best[0] == np.inf:
            return Status.NOT_FINITE
        elif halvings == options.halvings:
            near = best[0] <= options.krylov_below
            return newton_krylov(split, problem, best[1], history) if near else Status.STALLED
        else:
            halvings += 1
            x, last = best[1] - 0.5**halvings * best[2], np.inf
            split.give_up()
    return Status.TOO_MANY_ITERATIONS

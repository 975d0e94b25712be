"""Newton-Krylov iteration by the whole derivative of R, where the iteration by P^{-1} R alone is slow.

GMRES takes P^{-1} dR d with complex increments of R (``ReducedResidual.derivative``), to which P is the
preconditioner.  What needs it are creep rate fields (nu > 0), whose coupling to v P leaves out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ngvisco.algebra.krylov import gmres
from ngvisco.reduced.residual import Evaluation
from ngvisco.solver.solution import NewtonIteration, Problem, Status

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def newton_krylov(split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]) -> Status:
    """Iterate from ``x``, where the tangent is made anew; the state becomes the solution, or some iterate."""
    options, tolerance = split.options.split, split.options.tolerance
    krylov, wanted = options.krylov, options.margin * tolerance
    scale = split.unknowns.scales(x, split.residual.exchange)

    def solved(at: Evaluation) -> np.ndarray:
        return split.preconditioner(at, krylov.tolerance * options.forcing)

    def renewed(at: Evaluation) -> tuple[np.ndarray, float]:
        split.renew(problem, at)
        f = solved(at)
        return f, split.size(f)

    at = split.residual(x)
    f, size = renewed(at)
    sizes = [size]
    while len(history) < split.options.max_iterations:
        derivative = split.residual.derivative(at)

        def along(d: np.ndarray, derivative: Any = derivative, at: Evaluation = at) -> np.ndarray:
            return solved(replace(at, residual=derivative(scale * d))) / scale

        products = split.residual.exchange.products
        d, _ = gmres(along, f / scale, rtol=krylov.tolerance, directions=krylov.directions, products=products)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new = split.residual(new_x)
            new_f = solved(new)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < krylov.min_damping:
                return _ends_at(split, x, size <= tolerance)  # by rounding
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        at, x, f, size = new, new_x, new_f, new_size
        if problem.changes(size):
            split.residual.start()
            at = split.residual(x)
        elif size <= wanted:
            return _ends_at(split, x - f, True)
        sizes.append(size)
        window = krylov.window * (3 if split.norm.shared else 1)  # increments of Pi rise in between
        before = sizes[max(len(sizes) - 1 - window, 0)]
        if len(sizes) > window and size > max(0.2 * before, options.rounding):
            return _ends_at(split, x, size <= tolerance)
        f, size = renewed(at)
    return Status.TOO_MANY_ITERATIONS


def _ends_at(split: Split, x: np.ndarray, converged: bool) -> Status:
    """Make x, with the unknowns that it determines, the state."""
    split.residual.put(x)
    return Status.CONVERGED if converged else Status.STALLED

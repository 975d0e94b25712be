"""The split solver's iteration: when it has converged, starts again, or leaves it to Newton-Krylov."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ngvisco.errors import StepError
from ngvisco.solver.options import NewtonIteration
from ngvisco.solver.split.krylov import MARGIN, newton_krylov

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split

SLOW = 24
"""Iterations after which the whole derivative is taken."""

STALLED, WINDOW = 0.3, 4
"""The same where as many iterations as WINDOW shorten the increment by less than this factor: sweeps converge
like the Courant number, so that above one the iteration does not."""

TOO_MANY = {2: 8, 3: 12}
"""Iterations for the flow's linear system after which its preconditioner is made anew, by dimension."""

FAR = 0.5
"""Increment after which the tangent is formed anew: from rest it knows nothing of the curvature of v."""

ROUNDING = 1e-8
"""Increment, relative to the smallest velocities, from which a stall may be rounding."""

RESTARTS = 4
"""New tangents within a step, after which the whole derivative is taken."""


def iterate(split: Split, history: list[NewtonIteration]) -> None:
    """Iterate from the present state, which becomes the solution; ``history`` grows.

    Raises
    ------
    StepError
        When the iteration does not converge; the state is then some iterate.
    """
    wanted = MARGIN * split.options.tolerance
    last = best = np.inf
    best_x, best_f = None, None
    since, restarts = 0, 0  # iterations since the start or a restart, and restarts
    sizes: list[float] = []
    while len(history) < split.options.max_iterations:
        fresh = not split.exists
        x, f, size = split.increment(last)
        history.append(NewtonIteration(size, size / last if last < np.inf else 1.0, 1.0, fresh))
        since += 1
        if size <= wanted:
            split.unknowns.unpack(x - f)
            split.residual()
            return
        if not size <= 2 * max(best, wanted):
            restarts += 1
            if best_x is None or best_f is None:
                break
            if restarts > RESTARTS:
                _take_over(split, best_x, history)
                return
            # from half the step of the best iterate, with a preconditioner of its own
            split.unknowns.unpack(best_x - 0.5**restarts * best_f)
            split.exists, since, last = False, 0, np.inf
            continue
        if (
            size > 0.5 * min(last, best)
            and since > 3
            and size <= ROUNDING
            and split.size(f, coarse=True) <= split.options.tolerance
        ):
            return
        if size < best:
            best, best_x, best_f = size, x, f
        last = size
        sizes.append(size)
        stalled = since > 2 * WINDOW and size > max(STALLED * sizes[-1 - WINDOW], ROUNDING)
        if since > SLOW or stalled:
            _take_over(split, x, history)
            return
        worn = split.preconditioner.iterations > TOO_MANY[split.step.mesh.dim] and size > 1e3 * wanted
        if worn or size > FAR:
            split.exists = False
        split.unknowns.unpack(x - f)
    raise StepError(
        f"the split solver did not converge ({len(history)} iterations, last increment {last:.1e}, "
        f"wanted {wanted:.0e}): take a smaller step or the coupled solver",
        history,
    )


def _take_over(split: Split, x: np.ndarray, history: list[NewtonIteration]) -> None:
    """Go on from ``x`` with the whole derivative."""
    split.unknowns.unpack(x)
    split.residual()
    split.renew()
    newton_krylov(split, x, history)

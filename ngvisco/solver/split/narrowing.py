"""Upwinding made wide about an iterate, and narrowed again to the scheme's.

Where v . n changes its sign on a facet between cells of different z the elastic force jumps across the width
eta of the smoothed sign.  An increment that is larger than eta goes from one side of such a jump to the other
and the next one back: the iteration neither converges nor diverges, and damping it does not help, since the
solution is in between.  Secants find it (``Successive``) unless several points turn round, which no one line
passes in order.  With a width above the increments it converges at once; from there the width is
narrowed, a few increments for each, and every solution is near enough to the next one: v . n stays in the
same part of the jump, so that solutions are nearly linear in the width, along which they are extrapolated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ngvisco.solver.solution import NewtonIteration, Problem

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def narrowed(
    split: Split, problem: Problem, x: np.ndarray, history: list[NewtonIteration]
) -> np.ndarray | None:
    """Unknowns near the solution of ``problem``, from ``x``, by widths that are narrowed to the scheme's.

    None where the widest one is not solved, or steps between widths become too small.  The preconditioner is
    dropped; ``history`` grows.
    """
    options = split.options.split.narrowing
    starts = iter(options.widest)
    width, solved, power = float(next(starts)), 0.0, 1.0
    slope = np.zeros_like(x)
    split.reset()
    try:
        while True:
            wide = problem.widened(width)
            _pose(split, wide)
            near = _near(split, wide, x + (width - solved) * slope, history)
            if near is not None:
                if width == 1.0:
                    return near
                slope = (near - x) / (width - solved) if solved else slope
                x, solved, power = near, width, min(1.0, 1.5 * power)
            elif not solved:
                if (width := float(next(starts, 0))) == 0.0:
                    return None
                continue
            elif power < options.smallest:
                return None
            else:
                power /= 2
            width = max(1.0, solved / options.ratio**power)
    finally:
        _pose(split, problem)
        split.reset()


def _near(split: Split, wide: Problem, x: np.ndarray, history: list[NewtonIteration]) -> np.ndarray | None:
    """Unknowns that solve ``wide`` to a tolerance; None where the iteration does not contract."""
    options = split.options.split.narrowing
    tolerance = options.last if wide.width == 1.0 else options.tolerance
    sizes = [np.inf]
    while len(history) < split.options.max_iterations:
        fresh = not split.is_factorised
        _, f, size = split.increment(wide, x, sizes[-1])
        history.append(NewtonIteration(size, size / sizes[-1] if len(sizes) > 1 else 1.0, 1.0, fresh))
        if size <= tolerance and size <= options.contraction * sizes[-1] < np.inf:
            return x - f
        late = len(sizes) > options.window  # as slow as with the scheme's width: it is not facets, then
        if not size < np.inf or (late and (size > 0.5 * sizes[-options.window] or size <= options.last)):
            return None
        x = x - f
        sizes.append(size)
    return None


def _pose(split: Split, problem: Problem) -> None:
    problem.pose()
    split.residual.start()

"""Newton-Krylov iteration on f(x) = P^{-1} R(x) = 0 where the split solver's is slow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.errors import StepError
from ngvisco.solver.options import NewtonIteration

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split

RELATIVE = 1e-7
"""Length of the difference quotients, relative to |x| in the norm of the unknowns' scales."""

DIRECTIONS = 40
"""Derivatives taken for one Newton increment."""


def newton_krylov(split: Split, x: np.ndarray, history: list[NewtonIteration]) -> None:
    """Iterate from ``x`` until the increment meets the tolerance; the state becomes the solution.

    Raises
    ------
    StepError
        When an increment does not shorten f, or the iterations are used up.
    """
    from ngvisco.solver.split.solver import FORCING, MARGIN

    wanted = MARGIN * split.options.tolerance
    scale = split.unknowns.scales(x)

    def function(at: np.ndarray) -> np.ndarray:
        split.unknowns.unpack(at)
        with np.errstate(all="ignore"):
            return split.preconditioner(split.residual(), 0.01 * FORCING)

    f = function(x)
    size = split._size(f)
    while len(history) < 2 * split.options.max_iterations:

        def derivative(d: np.ndarray, x: np.ndarray = x, f: np.ndarray = f) -> np.ndarray:
            length = np.linalg.norm(d)  # of d in units of the scales
            if length == 0:
                return d
            step = RELATIVE / length
            return (function(x + step * scale * d) - f) / (step * scale)

        operator = LinearOperator((len(x), len(x)), derivative, dtype=float)
        d, _ = gmres(operator, f / scale, rtol=0.1, restart=DIRECTIONS, maxiter=1)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new_f = function(new_x)
            new_size = split._size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < split.options.min_damping:
                if size <= split.options.tolerance:  # differences do not see further
                    split.unknowns.unpack(x)
                    split.residual()
                    return
                raise StepError(
                    f"the split solver did not converge (no step length reduces the increment {size:.1e}): "
                    "take a smaller step or the coupled solver",
                    history,
                )
        history.append(NewtonIteration(new_size, new_size / size, damping, False))
        x, f, size = new_x, new_f, new_size
        if size <= wanted:
            split.unknowns.unpack(x - f)
            split.residual()
            return
    raise StepError(
        f"the split solver did not converge ({len(history)} iterations, last increment {size:.1e}): "
        "take a smaller step or the coupled solver",
        history,
    )

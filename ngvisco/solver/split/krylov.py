"""Newton-Krylov iteration on f(x) = P^{-1} R(x) = 0 where the split solver's is slow.

GMRES takes P^{-1} dR d with the derivative dR of ``Linearisation``, to which P is the preconditioner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from ngvisco.errors import StepError
from ngvisco.solver.options import NewtonIteration
from ngvisco.solver.split.preconditioner import FORCING, Residual

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split

MARGIN = 0.1
"""The increment wanted, in units of the tolerance: what remains is a contraction's share of it."""

DIRECTIONS = 40
"""Derivatives taken for one Newton increment."""

INEXACT = 0.01
"""Tolerance of an increment.

With 0.1 instead the iteration was as fast and failed in one of six steps of 0.1 and 0.3 s on 72 and 230
triangles, where it was made to take over after two iterations.  Differences of P^{-1} R, in place of the
derivative, evaluated R 330 times in a step where this evaluates it 49 times, and took a fifth longer.
"""


def newton_krylov(split: Split, x: np.ndarray, history: list[NewtonIteration]) -> None:
    """Iterate from ``x`` until the increment meets the tolerance; the state becomes the solution.

    Raises
    ------
    StepError
        When an increment does not shorten f, or the iterations are used up.
    """
    wanted = MARGIN * split.options.tolerance
    scale = split.unknowns.scales(x)

    def solved(r: Residual) -> np.ndarray:
        with np.errstate(all="ignore"):
            return split.preconditioner(r, INEXACT * FORCING)

    def function(at: np.ndarray) -> np.ndarray:
        split.unknowns.unpack(at)
        with np.errstate(all="ignore"):  # a step too long may leave the energy's domain
            r = split.residual()
        return solved(r)

    linearisation = split.linearisation()
    f = function(x)
    size = split.size(f)
    while len(history) < split.options.max_iterations:
        linearisation.update()
        operator = LinearOperator(
            (len(x), len(x)), lambda d: solved(linearisation(scale * d)) / scale, dtype=float
        )
        d, _ = gmres(operator, f / scale, rtol=INEXACT, restart=DIRECTIONS, maxiter=1)
        damping = 1.0
        while True:
            new_x = x - damping * scale * d
            new_f = function(new_x)
            new_size = split.size(new_f)
            if new_size <= (1 - 0.25 * damping) * size:
                break
            damping /= 2
            if damping < split.options.min_damping:
                if size <= split.options.tolerance:  # rounding
                    split.unknowns.unpack(x)
                    split.residual()
                    return
                raise StepError(
                    f"the split solver did not converge (no step length reduces the increment {size:.1e}): "
                    "take a smaller step or the coupled solver",
                    history,
                )
        history.append(NewtonIteration(new_size, new_size / size, damping, True))
        x, f, size = new_x, new_f, new_size
        if size <= wanted:
            split.unknowns.unpack(x - f)
            split.residual()
            return
        split.renew()
        f = function(x)
        size = split.size(f)
    raise StepError(
        f"the split solver did not converge ({len(history)} iterations, last increment {size:.1e}): "
        "take a smaller step or the coupled solver",
        history,
    )

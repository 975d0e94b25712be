"""What stands against convergence: the terms that the next increment of a failed iteration comes from.

An increment f is meant to solve R + R' (-f) = 0.  What is left at x - f is then, term by term,

    R(x - f) = (R - R' f) + sum over terms T of [R_T(x - f) - R_T(x) + R_T' f],

what the linear system leaves, and the terms' curvature.  Each part, taken to an increment, is a share of
the next one; where they are small the iteration converges.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ngvisco.forms.term_rows import LINEAR
from ngvisco.physics.increments import TINY
from ngvisco.reduced.residual import Evaluation, Residual
from ngvisco.reduced.rows_by_terms import by_terms

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split


def resistance(split: Split, at: Evaluation, f: np.ndarray) -> dict[str, float]:
    """Sizes of the parts of the increment after f at ``at``; infinite where one is no number.

    The step's state is then another one.
    """
    residual = split.residual
    at = residual(at.x)
    before = by_terms(residual, at)
    residual.derivative(at)  # what forms have of it is formed
    along = residual(at.x + (TINY * 1j) * f)
    slopes = {name: part.imag / TINY for name, part in by_terms(residual, along).items()}
    after = by_terms(residual, residual(at.x - f))
    parts = {name: after[name] - before[name] + slopes[name] for name in before}
    parts[LINEAR] = sum(before.values()) - sum(slopes.values())
    return {name: _size(split, at, part) for name, part in parts.items()}


def _size(split: Split, at: Evaluation, part: np.ndarray) -> float:
    """Of the increment that some rows make, in the iteration's norm."""
    ranks = split.residual.ranks
    if not ranks.all(np.isfinite(part).all()):
        return np.inf
    if not ranks.any(part.any()):
        return 0.0
    u = split.unknowns
    normals = None
    if at.residual.normals is not None:
        normals = part[u.normal_slice].reshape(at.residual.normals.shape)
    z = part[u.slices["z"]].reshape(at.residual.z.shape)
    rows = Residual(part[u.flow_slice], normals, part[u.density_slice], z)
    return split.size(split.preconditioner(replace(at, residual=rows), split.options.split.forcing))

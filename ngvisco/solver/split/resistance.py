"""What stands against convergence: the terms that the next increment of a failed iteration comes from.

An increment f is meant to solve R + R' (-f) = 0.  What is left at x - f is then, term by term,

    R(x - f) = (R - R' f) + sum over terms T of [R_T(x - f) - R_T(x) + R_T' f],

what the linear system leaves, and the terms' curvature.  Each part, taken to an increment, is a share of
the next one; where they are small the iteration converges.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ngvisco.forms.term import Term
from ngvisco.physics.increments import TINY
from ngvisco.reduced.residual import Evaluation, ReducedResidual, Residual

if TYPE_CHECKING:
    from ngvisco.solver.split.solver import Split

REST = "walls and other terms"
"""What has no arrays: terms by their forms, diffusion of z, known sources."""

LINEAR = "the linear system of the increment"
_NAMED, _COUNTS = 3, 0.2
"""Terms that are named, and the share of the largest from which one is."""


def resistance(split: Split, at: Evaluation, f: np.ndarray) -> dict[str, float]:
    """Sizes of the parts of the increment after f at ``at``, largest first; infinite where one is no number.

    The step's state is then another one.
    """
    residual = split.residual
    with np.errstate(all="ignore"):  # x - f may leave the energy's domain
        at = residual(at.x)
        before = by_terms(residual, at)
        residual.derivative(at)  # what forms have of it is formed
        along = residual(at.x + (TINY * 1j) * f)
        slopes = {name: part.imag / TINY for name, part in by_terms(residual, along).items()}
        after = by_terms(residual, residual(at.x - f))
        parts = {name: after[name] - before[name] + slopes[name] for name in before}
        parts[LINEAR] = sum(before.values()) - sum(slopes.values())
        sizes = {name: _size(split, at, part) for name, part in parts.items()}
    return dict(sorted(sizes.items(), key=lambda item: -item[1]))


def in_words(sizes: dict[str, float], before: float) -> str:
    """The largest of them in words, in units of the increment before."""
    largest = max(sizes.values(), default=0.0)
    if not largest > 0:
        return ""
    if largest == np.inf:
        names = [name for name, size in sizes.items() if size == np.inf]
        return f"not a number at the next iterate: {', '.join(names[:_NAMED])}"
    named = [f"{name} ({size / before:.2g})" for name, size in sizes.items() if size >= _COUNTS * largest]
    return f"against it stand, in units of the smallest increment: {', '.join(named[:_NAMED])}"


def _size(split: Split, at: Evaluation, part: np.ndarray) -> float:
    """Of the increment that some rows make, in the iteration's norm."""
    if not np.isfinite(part).all():
        return np.inf
    if not part.any():
        return 0.0
    u = split.unknowns
    normals = None
    if at.residual.normals is not None:
        normals = part[u.normal_slice].reshape(at.residual.normals.shape)
    z = part[u.slices["z"]].reshape(at.residual.z.shape)
    rows = Residual(part[u.flow_slice], normals, part[u.density_slice], z)
    return split.size(split.preconditioner(replace(at, residual=rows), split.options.split.forcing))


def by_terms(residual: ReducedResidual, at: Evaluation) -> dict[str, np.ndarray]:
    """The terms' rows, packed, whose sum is the residual at an evaluation: in cells, and across facets."""
    unknowns = residual.unknowns
    found: dict[str, np.ndarray] = {}

    def add(name: str, rows: dict[str, np.ndarray]) -> None:
        if not rows:
            return
        vector = found.setdefault(name, np.zeros(unknowns.size, at.x.dtype))
        for block, values in rows.items():
            where = unknowns.normal_slice if block == "a" else unknowns.slices[block]
            vector[where] += values.ravel()

    for term in [*residual.claims.at_points, *residual.claims.continuity]:
        add(_named(term), residual.cell_terms.rows([term], at.cells))
        add(f"{_named(term)} across facets", residual.facet_terms.rows([term], at.facets))
    if at.hyper is not None:
        count = at.coefficients["v"].shape[1]
        rows = {"v": at.hyper.rows[:, :count], "a": at.hyper.rows[:, count:]}
        add(_named(residual.claims.hyperviscosity[0]), rows)
    found[REST] = np.concatenate(at.residual.parts()) - sum(found.values())
    return found


def _named(term: Term) -> str:
    """A term by the name of its class: ``elastic force``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", type(term).__name__).lower()

"""The rows of the residual term by term, each under its name."""

from __future__ import annotations

import numpy as np

from ngvisco.forms.term import named
from ngvisco.reduced.residual import Evaluation, ReducedResidual

REST = "walls and other terms"
"""What has no arrays: terms by their forms, diffusion of z, known sources."""


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
        add(named(term), residual.cell_terms.rows([term], at.cells))
        add(f"{named(term)} across facets", residual.facet_terms.rows([term], at.facets))
    if at.hyper is not None:
        count = at.coefficients["v"].shape[1]
        rows = {"v": at.hyper.rows[:, :count], "a": at.hyper.rows[:, count:]}
        add(named(residual.claims.hyperviscosity[0]), rows)
    found = {name: residual.exchange.sum(vector) for name, vector in found.items()}
    found[REST] = np.concatenate(at.residual.parts()) - sum(found.values())
    return found

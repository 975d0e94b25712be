"""Integrals over the cells' sides in the step's state, by arrays, for the ledger.

The ledger needs no values at all points at once, which would take more memory than the iteration. Each
function therefore works on one part of the mesh after another.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ngvisco.forms.impulses import OnSides
from ngvisco.reduced.point_fields import NotAtPointsError
from ngvisco.reduced.residual import CellPart, ReducedResidual


def rows_on_sides(residual: ReducedResidual, integrands: OnSides) -> dict[str, np.ndarray]:
    """Rows of v, of this rank's cells, by the names of the integrands, (unknowns of v,)."""
    c = residual.of_state(residual.facet_terms.names)
    parts = residual.share(lambda part: part.sides.loads_by(integrands, part.sides.fields(c)), residual.parts)
    loads = {name: np.concatenate([of[name] for of in parts], axis=-1) for name in parts[0]}
    return {name: residual.side_op.v.summed(values).ravel() for name, values in loads.items()}


def dissipated_on_sides(residual: ReducedResidual) -> dict[str, float]:
    """The terms' dissipation on the cells' sides, W, by the ledger's names.

    A term is left out if it reads values that arrays at points do not have."""
    c = residual.of_state(residual.facet_terms.names)
    iterated = residual.unknowns.coefficients(residual.unknowns.pack()) | residual.of_state(["hess_square"])

    def totals(part: CellPart) -> dict[str, float]:
        u, powers = part.sides.fields(c), dict[str, Any]()
        for term in residual.at_points:
            try:
                of_term = term.dissipated_on_facets(u)
            except NotAtPointsError:
                continue
            powers |= of_term
        if residual.hyper is not None:
            powers |= residual.hyper.dissipated_on_sides(part.cells, iterated)
        return {name: float((part.sides.op.weights * power.value).sum()) for name, power in powers.items()}

    parts = residual.share(totals, residual.parts)
    return {name: residual.ranks.total(sum(sums[name] for sums in parts)) for name in parts[0]}

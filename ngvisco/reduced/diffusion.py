"""delta Laplace z with its trace eliminated: one constant matrix for every component of strains."""

from __future__ import annotations

import numpy as np
from ngsolve import BilinearForm, FESpace

from ngvisco.algebra.blocks import BlockInverse
from ngvisco.algebra.sparse import apply
from ngvisco.forms.fields import Fields
from ngvisco.forms.points import csr
from ngvisco.forms.regularisation import FieldDiffusion
from ngvisco.forms.system import Step
from ngvisco.reduced.operators import Operators


class FieldDiffusionMatrix:
    """``FieldDiffusion`` is linear and the same for all strains: its form, for one of them."""

    def __init__(self, step: Step, operators: Operators, term: FieldDiffusion) -> None:
        self.strains = step.layout.states.strains
        """Which components diffuse."""
        cell, facet = operators.scalar, step.layout.scalar_facet_space()
        space = FESpace([cell, facet])
        u, w = (
            Fields(step.layout, dict(zip(("z", "z_delta_hat"), parts, strict=True))) for parts in space.TnT()
        )
        form = BilinearForm(space)
        step.quadrature.add(form, term.form(u, w))
        matrix = csr(form.Assemble().mat)
        own, hat = slice(0, cell.ndof), slice(cell.ndof, space.ndof)
        self._hats = BlockInverse(matrix[hat, hat].tocsr())
        self._hats.update(matrix[hat, hat].tocsr())
        inverse = self._hats.matrix()
        self._to_trace = -(inverse @ matrix[hat, own]).tocsr()
        self._from_trace = -(matrix[own, hat] @ inverse).tocsr()
        self.matrix = (matrix[own, own] + matrix[own, hat] @ self._to_trace).tocsr()

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Rows of z, (n, functions)."""
        return self._of_strains(apply(self.matrix, z))

    def trace(self, z: np.ndarray) -> np.ndarray:
        """The trace that belongs to z, (n, functions of facets)."""
        return apply(self._to_trace, z)

    def eliminated(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of rows of the trace (n, .) given beside: the change of the trace, and the rows that z gets."""
        return self._hats(rows), self._of_strains(apply(self._from_trace, rows))

    def _of_strains(self, rows: np.ndarray) -> np.ndarray:
        return rows if self.strains.all() else rows * self.strains[:, None]

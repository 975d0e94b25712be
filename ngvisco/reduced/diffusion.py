"""delta Laplace z; the slope of z is eliminated cell by cell, the traces facet by facet.

The matrices of ``FieldDiffusion`` are constant and the same for every component; they are assembled once.
Only phi''(z) depends on the state.  phi''(z) enters the cells' equations of the slope q,

    (phi''(z) + P) q_j = L_j (zeta + P z),        rows of z:  delta (sum_j L_j^T q_j + C S (zeta + P z)),

where the functions of a cell test the left-hand side.  L_j is the lifted gradient, S the penalty, P the
projection on the directions in which the energy is linear, and C the compliance.  Parameters have no rows
here. The equations of their slopes omit zeta and phi'', and P is one in them.

Over ranks L_j and S also have columns of the cells across shared facets (``Halo``).  The rows of L_j^T in
other ranks' cells are sent to those ranks.

NGSolve's form takes 2 to 4 times as long for the rows, and 30 to 260 times as long for their derivative
(``tests/benchmarks/kernels.py``). ``tests/solver/test_split_agrees.py`` compares solutions with those of the
form.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from ngsolve import BilinearForm, FESpace, VectorValued

from ngvisco.algebra.sparse import apply, inverse_of_blocks, widened
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.points import csr
from ngvisco.forms.system import Step
from ngvisco.forms.terms.regularisation import FieldDiffusion
from ngvisco.parallel.exchange import HaloUnknowns
from ngvisco.reduced.evaluation import Coefficients
from ngvisco.reduced.operators import FacetMass, Operators
from ngvisco.reduced.slope import PointwiseSlope

_INCREMENT = 6e-6
"""Relative increment of z in central differences of phi''(z) q; it is the cube root of the rounding unit."""


class FieldDiffusionRows:
    """The rows of z by the term ``FieldDiffusion``, and their derivative."""

    def __init__(
        self, step: Step, operators: Operators, slope: PointwiseSlope, term: FieldDiffusion, traces: FacetMass
    ) -> None:
        """``traces`` provides the facets' functions and the cells across facets; its inverse matrices are not
        needed."""
        self._op, self._slope, self._dim = operators, slope, step.mesh.dim
        self._delta, curvature = term.law.delta_fields, term.curvature
        self._of_itself = curvature.of_itself if curvature.of_itself.any() else None
        self.strains = curvature.strains
        """Mask of the components that diffuse."""
        self._compliance = curvature.compliance
        cell, facet = step.layout.scalar_space("z"), step.layout.scalar_space("z_hat")
        names = ("zeta", "z_slope", "zeta_delta_hat", "z_slope_hat")
        vectors = [VectorValued(scalar, 1) for scalar in (cell, facet, facet)]
        space = FESpace([vectors[0], VectorValued(cell, step.mesh.dim), *vectors[1:]])
        u, w = (Fields(step.layout, dict(zip(names, parts, strict=True))) for parts in space.TnT())
        form = BilinearForm(space)
        step.quadrature.add(form, term.of_one_component(u, w))
        matrix = csr(form.Assemble().mat)
        ranges = dict(zip(names, map(space.Range, range(4)), strict=True))
        where = {name: slice(r.start, r.stop) for name, r in ranges.items()}

        def block(test: str, trial: str) -> sp.csr_matrix:
            return matrix[where[test], where[trial]].tocsr()

        mean, jump = (traces.summed_blocks(block(name, name)) for name in ("zeta_delta_hat", "z_slope_hat"))
        self._to_mean = -(inverse_of_blocks(mean) @ block("zeta_delta_hat", "zeta")).tocsr()
        self._to_jump = -(inverse_of_blocks(jump) @ block("z_slope_hat", "z_slope")).tocsr()
        self._traces, self._ranks = traces.exchange, traces.exchange.communicator
        self.unknowns = HaloUnknowns(traces.halo, operators.z.blocks.shape[2])
        """Unknowns of one component, including those of other ranks' cells across shared facets."""
        to_means, count, size = self._to_means(traces), self.unknowns.count, cell.ndof

        def with_means(test: str) -> sp.csr_matrix:
            """The matrix from zeta in cells to the rows of ``test``, with the means of zeta as its traces."""
            of_cell = block(test, "zeta")
            return widened(of_cell, of_cell.shape[0], count) + block(test, "zeta_delta_hat") @ to_means

        lifting = -with_means("z_slope")
        self._lifting = [lifting[j * size : (j + 1) * size].tocsr() for j in range(self._dim)]
        self._adjoint = [part.T.tocsr() for part in self._lifting]
        self._penalty = with_means("zeta").tocsr()
        blocks = operators.z.blocks  # (cells, points, functions)
        weighted = operators.weights.reshape(*blocks.shape[:2], 1) * blocks
        cells, points, q = blocks.shape
        self._products = np.einsum("cpk,cpl->cklp", weighted, blocks).reshape(cells, q * q, points)

    def _to_means(self, traces: FacetMass) -> sp.csr_matrix:
        """The matrix from zeta in cells, including other ranks' cells across facets, to the means of zeta on
        facets."""
        halo, q = traces.halo, self.unknowns.per_cell
        of_cell = widened(self._to_mean, self._to_mean.shape[0], self.unknowns.count)
        facets = traces.unknowns[traces.of_facets.places]  # (shared facets, functions)
        if not len(facets):
            return of_cell
        count, size = facets.shape
        numbers = halo.beside, halo.cells + np.arange(count)
        here, beyond = (q * cells[:, None] + np.arange(q) for cells in numbers)
        rows = np.repeat(facets, q, axis=1).ravel()
        parts = np.asarray(self._to_mean[rows, np.tile(here, (1, size)).ravel()]).reshape(count, size, q)
        received = halo.swapped(parts).ravel()
        columns = np.tile(beyond, (1, size)).ravel()
        return (of_cell + sp.csr_matrix((received, (rows, columns)), shape=of_cell.shape)).tocsr()

    def laplacian(self, inverse_mass: sp.csr_matrix) -> sp.csr_matrix:
        """delta Laplace of one component for phi'' = 1, which approximates the rows for smooth z.

        On each rank the sum is over that rank's cells. Columns are numbered as in ``unknowns``.
        """
        square = sum(L.T @ inverse_mass @ L for L in self._lifting)
        return (self._delta * (square + widened(self._penalty, *square.shape))).tocsr()

    def slopes(self, z_values: np.ndarray, c: Coefficients) -> dict[str, np.ndarray]:
        """The eliminated unknowns by name, (components, functions).

        ``z_values`` is z at the cells' points, ``c`` has the coefficients of z and zeta.  If z and zeta are
        complex, with increments as imaginary parts, the eliminated unknowns are complex too.
        """
        chi = self._potential(c)
        at = np.ascontiguousarray(z_values.real)
        matrices = self._matrices(at)
        beyond = self.unknowns.with_others(chi)
        gradients = np.stack([apply(L, beyond) for L in self._lifting])  # (dim, n, functions)
        q = self._solve(matrices, np.ascontiguousarray(gradients.real))
        if np.iscomplexobj(chi):
            change = self._changed(at, np.ascontiguousarray(z_values.imag), q)
            q = q + 1j * self._solve(matrices, np.ascontiguousarray(gradients.imag) - change)
        slope = q.transpose(1, 0, 2).reshape(len(chi) * self._dim, q.shape[2])
        normal_parts = apply(self._to_jump, slope.reshape(len(chi), self._dim * q.shape[2]))
        means, normal_parts = self._traces.sum(np.stack([apply(self._to_mean, chi), normal_parts]))
        return {"z_slope": slope, "zeta_delta_hat": means, "z_slope_hat": normal_parts}

    def rows(self, c: Coefficients) -> np.ndarray:
        """Rows of z, (n, functions), from zeta, z and its slope."""
        chi = self._potential(c)
        slope = c["z_slope"].reshape(len(chi), self._dim, -1)
        rows = np.sum([apply(A, slope[:, j]) for j, A in enumerate(self._adjoint)], axis=0)
        rows, beyond = self.unknowns.added(rows), self.unknowns.with_others(chi)
        return self._delta * (self._of_strains(rows) + self._compliance @ apply(self._penalty, beyond))

    def _potential(self, c: Coefficients) -> np.ndarray:
        """The diffusing potential zeta + P z, which is z for parameters."""
        zeta = self._of_strains(c["zeta"])
        return zeta if self._of_itself is None else zeta + self._of_itself @ c["z"]

    def _of_strains(self, rows: np.ndarray) -> np.ndarray:
        return rows if self.strains.all() else rows * self.strains.reshape(-1, *(1,) * (rows.ndim - 1))

    def _matrices(self, z_values: np.ndarray) -> np.ndarray:
        """Inverses of the cells' matrices phi''(z) + P, (cells, n functions, n functions)."""
        n, (cells, points, q) = len(z_values), self._op.z.blocks.shape
        hessian = self._of_strains(self._slope.hessian(z_values)).reshape(n * n, cells, points)
        if self._of_itself is not None:
            hessian = hessian + self._of_itself.reshape(-1, 1, 1)
        tested = self._products @ hessian.transpose(1, 2, 0)  # (cells, functions^2, n^2)
        matrices = tested.reshape(cells, q, q, n, n).transpose(0, 3, 1, 4, 2).reshape(cells, n * q, n * q)
        with self._ranks.together(np.linalg.LinAlgError):
            return np.linalg.inv(matrices)

    def _solve(self, inverses: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Solve the slopes' equations cell by cell; rows and slopes have the shape (dim, n, functions)."""
        dim, n, _ = rows.shape
        q = self._op.z.blocks.shape[2]
        local = rows.reshape(dim, n, -1, q).transpose(2, 1, 3, 0).reshape(len(inverses), n * q, dim)
        increments = (inverses @ local).reshape(-1, n, q, dim)
        return np.ascontiguousarray(increments.transpose(3, 1, 0, 2)).reshape(rows.shape)

    def _changed(self, z: np.ndarray, dz: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Derivative of the slopes' equations along dz: phi'''(z) dz q, tested, (dim, n, functions)."""
        size = float(np.abs(dz).max(initial=0.0))
        if size == 0:
            return np.zeros_like(q)
        step = _INCREMENT * max(float(np.abs(z).max()), 1e-300) / size
        ahead, behind = (self._slope.derivative(z + s * step * dz) for s in (1, -1))
        values = [self._op.z(np.ascontiguousarray(q_j)) for q_j in q]
        changes = [self._of_strains(ahead(v) - behind(v)) / (2 * step) for v in values]
        return np.stack([self._op.z.test(change) for change in changes])

"""What the transport carries through facets: upwind traces and fluxes at the sides' points.

(See ``UpwindTrace``, ``Kinematics``, ``Continuity`` and ``ElasticForce`` in ``ngvisco.forms``.)
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ngvisco.forms.side_points import SidePoints
from ngvisco.forms.system import Step
from ngvisco.solver.split.blocks import BlockInverse
from ngvisco.solver.split.local import LocalMatrix
from ngvisco.solver.split.operators import Operators, together


class Facets:
    """Traces, fluxes and the elastic force of one step's facets for the present v."""

    def __init__(self, step: Step, operators: Operators) -> None:
        mesh, context = step.mesh, step.context
        self.context = context
        self.points = points = SidePoints(mesh, step.quadrature.facet_degree)
        self.z, self.hat, self.v = (
            LocalMatrix(points.values(space), mesh.ne, points.weights)
            for space in (operators.scalar, step.layout.scalar_facet_space(), operators.velocity)
        )
        self.inner = np.round(points.sample(context.inner))
        # the two sides of an inner facet make one facet
        self.trace_mass = FacetMass(self.hat)
        self.trace_mass.update(points.weights * (1 - 0.5 * self.inner))
        self.density_mass = FacetMass(self.hat)
        self.h = np.repeat(context.h.vec.FV().NumPy(), self.z.per_cell)

    def set_velocity(self, v: np.ndarray, with_density: bool) -> None:
        """Evaluate v . n, the upwinding, and what depends on these alone."""
        eta = self.context.eta.Get()
        self.through = np.einsum("ip,ip->p", self.points.normals, self.v(v))
        self.normal_velocity = a = self.inner * self.through
        modulus = np.sqrt(a * a + eta * eta)
        self.inflow = 0.5 * (self.inner - a / modulus)
        self.carried = self.through * self.inflow
        self.up, self.down = 0.5 * (modulus + a), 0.5 * (modulus - a)
        if with_density:
            self.density_mass.update(self.points.weights * self.down)

    def set_fields(self, z: np.ndarray, z_hat: np.ndarray) -> None:
        """Evaluate z, put its upwind trace into ``z_hat``, and keep the jump z_hat - z."""
        values = self.z(z)
        z_hat[:] = self.trace_mass.solve(self.hat.test((1 - self.inflow) * values))
        self.jump = self.hat(z_hat)
        self.jump -= values

    def from_mean(self, zeta: np.ndarray, where: np.ndarray) -> np.ndarray:
        """How far zeta is from the means of both sides, on the boundary from itself, (n, points there).

        ``where`` are all the sides' points of some facets.
        """
        values = together(self.z.matrix[where], zeta)
        shares = self.points.weights[where] * (1 - 0.5 * self.inner[where])
        return values - self.trace_mass.fitted(values, shares, where)

    def fields(self) -> np.ndarray:
        """sum_K int_{dK} (v . n) n^- (z_hat - z) : G, rows of z."""
        return self.z.test(self.carried * self.jump)

    def set_density(self, rho: np.ndarray, rho_hat: np.ndarray) -> None:
        """Evaluate rho and put its upwind trace into ``rho_hat``."""
        self.rho = self.z(rho)
        rho_hat[:] = self.density_mass.solve(self.hat.test(self.up * self.rho))
        self.rho_hat = self.hat(rho_hat)

    def density(self) -> np.ndarray:
        """sum_K int_{dK} F_hat q, rows of rho."""
        return self.z.test(self.up * self.rho - self.down * self.rho_hat)

    def elastic_force(self, zeta: np.ndarray) -> np.ndarray:
        """- sum_K int_{dK} (w . n) n^- (z_hat - z) : zeta, rows of v, (dim, unknowns of a component)."""
        density = -self.inflow * np.einsum("np,np->p", self.jump, self.z(zeta))
        return self.v.test(density * self.points.normals)


class FacetMass:
    """sum over sides of int weight u t for functions of facets: small blocks, one a facet."""

    def __init__(self, values: LocalMatrix) -> None:
        matrix = values.matrix
        self._pattern = BlockInverse((abs(matrix).T @ abs(matrix)).tocsr())
        (self.unknowns,) = self._pattern.groups
        facet_of = np.zeros(matrix.shape[1], dtype=np.int64)
        facet_of[self.unknowns.ravel()] = np.repeat(np.arange(len(self.unknowns)), self.unknowns.shape[1])
        first = matrix.indices[matrix.indptr[:-1]]
        self.facet = facet_of[first]
        columns = self.unknowns[self.facet]
        rows = np.repeat(np.arange(matrix.shape[0]), columns.shape[1])
        shapes = np.asarray(matrix[rows, columns.ravel()]).reshape(columns.shape)
        self.shapes = np.ascontiguousarray(shapes.T)  # (unknowns, points)

    def update(self, weights: np.ndarray) -> None:
        """Invert the blocks for the weights (points,)."""
        size, count = self.unknowns.shape[1], len(self.unknowns)
        blocks = np.empty((count, size, size))
        for i in range(size):
            weighted = weights * self.shapes[i]
            for j in range(i + 1):
                blocks[:, i, j] = np.bincount(self.facet, weighted * self.shapes[j], count)
                blocks[:, j, i] = blocks[:, i, j]
        self.inverses = np.linalg.inv(blocks)
        """(facets, functions of a facet, the same)."""

    def fitted(self, values: np.ndarray, weights: np.ndarray, where: np.ndarray) -> np.ndarray:
        """The facets' functions fitted to ``values`` (n, points), by blocks of the last ``update``.

        ``where`` are the sides' points, all of some facets, ``weights`` theirs.
        """
        facets, facet = np.unique(self.facet[where], return_inverse=True)
        shapes = self.shapes[:, where]
        places = (facet, np.arange(len(where)))
        sums = sp.csr_matrix((np.ones(len(where)), places), shape=(len(facets), len(where)))
        loads = np.stack([sums @ (weights * shape * values).T for shape in shapes], axis=1)
        fit = self.inverses[facets] @ loads  # (facets, functions, n)
        return np.einsum("ip,pin->np", shapes, fit[facet])

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Inverse times ``loads`` (..., unknowns)."""
        result = np.zeros_like(loads)
        local = loads[..., self.unknowns][..., None]
        result[..., self.unknowns] = (self.inverses @ local)[..., 0]
        return result

    def inverse(self) -> sp.csr_matrix:
        """The inverse as a sparse matrix."""
        size = self.unknowns.shape[1]
        rows = np.repeat(self.unknowns, size, axis=1).ravel()
        columns = np.tile(self.unknowns, (1, size)).ravel()
        n = self._pattern.n
        return sp.csr_matrix((self.inverses.ravel(), (rows, columns)), shape=(n, n))

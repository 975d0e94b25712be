"""A swirl of an elastic solid in a box, by another method: a mesh moves with the solid.

The displacement u of order 2, on tetrahedra, solves with backward Euler

    rho_0 (v - v_old) / tau = Div P + rho_0 g,  v = (u - u_old) / tau,  P = psi'(F) + J D(L) F^{-T},

where F = I + Grad u, L = (Grad v) F^{-1}, psi is the neo-Hookean energy per referential volume of
``nv.ReferentialNeoHookean``, D a Newtonian stress, and u n = 0 on all walls of the unit box.  Newton's method
assembles the derivative in each iteration.  The code takes from the package only the mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as la
from ngsolve import TET, IntegrationRule, Mesh

DENSITY, BULK, SHEAR, VISCOSITY, GRAVITY = 1.0, 10.0, 10.0, 0.01, 1.0
"""kg/m^3, Pa, Pa (2 G_e), Pa s for bulk and shear alike, m/s^2."""
_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_CONVERGED, _MOST = 1e-10, 20
"""Largest increment of u in the box at which Newton's method ends, and the largest number of its
iterations."""
_TINY = 1e-30

Blocks: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Ends of rows, columns, and blocks of three unknowns of a node, (blocks, 3, 3)."""
Solver: TypeAlias = Callable[[Blocks, np.ndarray], tuple[np.ndarray, int]]
"""Solves with a matrix of blocks and a right-hand side; returns the solution and the number of iterations."""


def factorised(blocks: Blocks, right: np.ndarray) -> tuple[np.ndarray, int]:
    """Solve by a factorisation."""
    ends, columns, values = blocks
    matrix = sp.bsr_matrix((values, columns, ends), shape=(len(right),) * 2)
    return la.splu(matrix.tocsc(), options={"SymmetricMode": True}, permc_spec="MMD_AT_PLUS_A").solve(
        right
    ), 1


class LagrangianSwirl:
    """The motion of the solid in the unit box, by steps of ``tau``, s.

    Since the start, ``iterations`` counts the iterations of Newton's method, and ``directions`` the
    iterations of the linear solver.
    """

    def __init__(
        self,
        mesh: Mesh,
        tau: float,
        solver: Callable[[np.ndarray], Solver] = lambda _: factorised,
        shear: float = SHEAR,
    ) -> None:
        """``solver`` makes the solver of the linear systems from the nodes' places at rest, (nodes, 3)."""
        self._tau, self._shear, self.iterations, self.directions = tau, shear, 0, 0
        vertices = np.array([vertex.point for vertex in mesh.vertices])
        corners = np.array([[v.nr for v in cell.vertices] for cell in mesh.Elements()])
        pairs = np.sort(np.stack([corners[:, pair] for pair in _EDGES], axis=1), axis=2)
        edges, of_cells = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
        self._nodes = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        self._cells = np.hstack([corners, len(vertices) + of_cells.reshape(-1, len(_EDGES))])
        self._slopes, self._weights, shapes, fine = _rules(vertices[corners])
        x, y, z = self._nodes.T
        height = (1 + z) / 2
        swirl = np.sin(np.pi * x) * np.cos(np.pi * y), -np.cos(np.pi * x) * np.sin(np.pi * y)
        self.v = np.stack([height * swirl[0], height * swirl[1], 0 * z], axis=1)
        self.u = np.zeros_like(self.v)
        self._free = np.minimum(self._nodes, 1 - self._nodes) > 1e-9
        products = np.einsum("qa,qb->qab", shapes, shapes).reshape(len(shapes), -1)
        self._masses = DENSITY * (fine @ products).reshape(-1, 10, 10)
        self._solver = solver(self._nodes)
        self._matrix = _Matrix(self._cells, len(self._nodes), self._free)

    @property
    def kinetic(self) -> float:
        """The kinetic energy, J."""
        v = self.v[self._cells]
        return float(0.5 * np.einsum("cai,cab,cbi->", v, self._masses, v))

    def _stress(self, F: np.ndarray, before: np.ndarray) -> np.ndarray:
        """The first Piola stress at points, (9, points), from F now and at the step's begin."""
        cofactors = _cofactors(F)
        J = (F[:3] * cofactors[:3]).sum(axis=0)
        inverse = cofactors / J  # F^{-T}
        power = J ** (-2 / 3)
        P = BULK * (J - 1) * cofactors
        P += self._shear * power * (F - (F * F).sum(axis=0) / 3 * inverse)
        rate = ((F - before) / self._tau).reshape(3, 3, -1)
        L = np.einsum("ikp,jkp->ijp", rate, inverse.reshape(3, 3, -1))
        stress = VISCOSITY * (L + L.transpose(1, 0, 2))
        pressure = VISCOSITY / 3 * np.trace(L)
        for i in range(3):
            stress[i, i] += pressure
        P += np.einsum("ikp,kjp->ijp", stress, cofactors.reshape(3, 3, -1)).reshape(9, -1)
        return P

    def _gradient(self, u: np.ndarray) -> np.ndarray:
        """F at the points, (9, cells times points)."""
        F = np.matmul(u[self._cells].transpose(0, 2, 1)[:, None], self._slopes)  # cells, points, i, j
        return np.eye(3).reshape(9, 1) + F.reshape(-1, 9).T

    def advance(self) -> None:
        """Make a step.  Raises RuntimeError if Newton's method does not converge."""
        tau, old, v_old = self._tau, self.u, self.v
        before, u = self._gradient(old), old + tau * v_old
        down = GRAVITY * np.array([0.0, 0.0, 1.0])
        for _ in range(_MOST):
            F = self._gradient(u)
            inertia = ((u - old) / tau - v_old) / tau + down
            loads = np.matmul(self._masses, inertia[self._cells])
            loads += self._tested(self._stress(F, before))
            right = np.zeros_like(u)
            np.add.at(right, self._cells, loads)
            tangent = self._matrix.assembled(self._tangent(F, before))
            change, directions = self._solver(tangent, (right * self._free).ravel())
            u = u - change.reshape(-1, 3)
            self.iterations += 1
            self.directions += directions
            if abs(change).max() <= _CONVERGED:
                break
        else:
            raise RuntimeError(f"no step of {tau:g} s")
        self.u, self.v = u, (u - old) / tau

    def _tested(self, P: np.ndarray) -> np.ndarray:
        """Loads of the stress, (cells, 10, 3)."""
        cells, points = self._slopes.shape[:2]
        P = (P * self._weights).T.reshape(cells, points, 3, 3)
        loads: np.ndarray = np.matmul(self._slopes, P.swapaxes(2, 3)).sum(axis=1)
        return loads

    def _tangent(self, F: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Element matrices, (cells, 10, 3, 10, 3)."""
        cells, points = self._slopes.shape[:2]
        A = np.empty((F.shape[1], 9, 9))
        for k in range(9):
            along = F.astype(complex)
            along[k] += 1j * _TINY
            A[:, :, k] = (self._stress(along, before).imag / _TINY * self._weights).T
        A = A.reshape(cells, points, 3, 3, 3, 3)  # cells, points, i, j, k, l
        left = np.einsum("cqaj,cqijkl->cqaikl", self._slopes, A, optimize=True)
        right = self._slopes.transpose(0, 1, 3, 2)  # cells, points, l, b
        result = np.matmul(left.reshape(cells, points, 90, 3), right).sum(axis=1)
        result = result.reshape(cells, 10, 3, 3, 10).transpose(0, 1, 2, 4, 3)
        for i in range(3):
            result[:, :, i, :, i] += self._masses / self._tau**2
        return result


def _cofactors(F: np.ndarray) -> np.ndarray:
    """Cofactors of matrices, (9, points)."""
    a, b, c = F.reshape(3, 3, -1)
    return np.concatenate([np.cross(s, t, axis=0) for s, t in ((b, c), (c, a), (a, b))])


def _rules(corners: np.ndarray) -> tuple[np.ndarray, ...]:
    """Slopes, (cells, points, 10, 3), and weights of a rule of degree 2; shapes, (points, 10), and weights,
    (cells, points), of a rule of degree 4."""
    along = np.stack([corners[:, i] - corners[:, 3] for i in range(3)], axis=2)
    volumes, inverse = abs(np.linalg.det(along)), np.linalg.inv(along)
    of_coordinates = np.concatenate([inverse, -inverse.sum(axis=1, keepdims=True)], axis=1)
    coarse, fine = IntegrationRule(TET, 2), IntegrationRule(TET, 4)
    bary = np.array([_barycentric(point) for point in coarse.points])
    by_bary = np.zeros((len(bary), 10, 4))
    for i in range(4):
        by_bary[:, i, i] = 4 * bary[:, i] - 1
    for n, (i, j) in enumerate(_EDGES, 4):
        by_bary[:, n, i], by_bary[:, n, j] = 4 * bary[:, j], 4 * bary[:, i]
    slopes = np.einsum("qab,cbj->cqaj", by_bary, of_coordinates)
    bary = np.array([_barycentric(point) for point in fine.points])
    shapes = np.hstack([bary * (2 * bary - 1), *(4 * bary[:, [i]] * bary[:, [j]] for i, j in _EDGES)])
    weights = np.outer(volumes, coarse.weights).ravel()
    return slopes, weights, shapes, np.outer(volumes, fine.weights)


def _barycentric(point: tuple[float, ...]) -> list[float]:
    return [*point, 1 - sum(point)]


class _Matrix:
    """Assembles element matrices into a matrix of blocks of three; rows of held unknowns are the identity."""

    def __init__(self, cells: np.ndarray, nodes: int, free: np.ndarray) -> None:
        keys = (cells[:, :, None] * nodes + cells[:, None, :]).ravel()
        unique, self._places = np.unique(keys, return_inverse=True)
        self._columns = (unique % nodes).astype(np.int32)
        self._ends = np.searchsorted(unique, nodes * np.arange(nodes + 1)).astype(np.int32)
        self._free = free[cells].astype(float)
        self._diagonal = np.flatnonzero(unique // nodes == unique % nodes)
        self._held = (~free).astype(float)

    def assembled(self, elements: np.ndarray) -> Blocks:
        """The matrix of all cells."""
        blocks = np.empty((len(self._columns), 3, 3))
        for i in range(3):
            for j in range(3):
                one = elements[:, :, i, :, j] * self._free[:, :, None, i] * self._free[:, None, :, j]
                blocks[:, i, j] = np.bincount(self._places, one.ravel(), len(blocks))
            blocks[self._diagonal, i, i] += self._held[:, i]
        return self._ends, self._columns, blocks

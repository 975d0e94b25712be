"""A soft disc in an incompressible fluid by another method: Lagrangian triangles immersed in a fixed grid.

Fluid and solid have one density and one viscosity, and differ only by the elastic stress:

    rho (dt v + div(v (x) v)) = -grad p + mu Laplace v + f,   div v = 0,   dt X = v(X),

with f the nodal forces -dW/dX of linear triangles, W = G/2 (|F|^2 - 2 - 2 ln det F) per referential area. The
method is that of H. Zhao, J. B. Freund and R. D. Moser, J. Comput. Phys. 227 (2008). The kernel between nodes
and grid is Peskin's, four cells wide, or the kernel of Roma, Peskin and Berger (1999), three cells wide.
Velocities are on the sides of N x N cells. Steps are by Heun's method, with projections by cosine transforms.
A kernel smears the disc's rim over its cells: errors are of first order in 1/N, and ``limit`` extrapolates.
The code shares no line with the solver.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from scipy.fft import dctn, idctn
from scipy.spatial import Delaunay

Width: TypeAlias = Literal[3, 4]
_SPACING = 0.6  # ratio of the distance of the triangles' nodes to the size of the grid's cells


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A unit box, 1 m, of density 1 kg/m^3 with a disc: its centre and radius, m, and shear modulus G, Pa.

    ``viscosity`` is mu everywhere, Pa s.  ``lid`` is the speed of the wall y = 1 m, m/s, while the other
    walls are at rest; with None all walls slip.  ``vortex`` is psi_0, m^2/s, in the start velocity (d_y psi,
    -d_x psi), psi = psi_0 sin 2 pi x sin 2 pi y.
    """

    centre: tuple[float, float]
    radius: float
    shear_modulus: float
    viscosity: float
    lid: float | None = None
    vortex: float = 0.0


CAVITY = Problem(centre=(0.6, 0.5), radius=0.2, shear_modulus=0.1, viscosity=0.01, lid=1.0)
"""The lid-driven cavity of K. Sugiyama et al., J. Comput. Phys. 230 (2011), arXiv:1009.3609."""


def computed(problem: Problem, cells: int, times: np.ndarray, width: Width = 4) -> np.ndarray:
    """A row for each of the ``times``, s, the first of which is 0, on N = ``cells`` cells, with a kernel of
    ``width`` cells.

    A row has the time, the disc's centroid x, y, m, and area, m^2, and the kinetic and elastic energy, J/m.
    """
    run = Immersed(problem, cells, width)
    rows = [run.row(0.0)]
    for start, end in pairwise(times):
        steps = math.ceil((end - start) / run.longest_step)
        for _ in range(steps):
            run.advance((end - start) / steps)
        rows.append(run.row(end))
    return np.array(rows)


def limit(rows: Mapping[int, np.ndarray]) -> np.ndarray:
    """Rows for 1/N -> 0 by a polynomial in 1/N through the rows of each N."""
    powers = np.vander([1 / cells for cells in rows], increasing=True)
    extrapolated: np.ndarray = np.tensordot(np.linalg.inv(powers)[0], np.stack(list(rows.values())), 1)
    return extrapolated


class Immersed:
    """State of the method: velocities u (N+1, N), v (N, N+1) on sides of cells, positions X (nodes, 2)."""

    def __init__(self, problem: Problem, cells: int, width: Width = 4) -> None:
        self.problem, self.n, self.h = problem, cells, 1 / cells
        self._kernel = _KERNELS[width]
        self.X, self.triangles, self.areas, self._inverse = _disc(problem, _SPACING / cells)
        side, middle = np.arange(cells + 1) * self.h, (np.arange(cells) + 0.5) * self.h
        k, a = 2 * np.pi, problem.vortex * 2 * np.pi
        self.u = a * np.outer(np.sin(k * side), np.cos(k * middle))
        self.v = -a * np.outer(np.cos(k * middle), np.sin(k * side))
        along = (2 * np.cos(np.pi * np.arange(cells) / cells) - 2) / self.h**2
        self._laplace = along[:, None] + along
        self._laplace[0, 0] = 1.0
        speeds = math.sqrt(problem.shear_modulus) + max(1.0, a)
        self.longest_step = min(0.2 * self.h**2 / problem.viscosity, 0.25 * self.h / speeds)
        self._project(self.u, self.v)

    def advance(self, dt: float) -> None:
        """Make one step of Heun's method."""
        du, dv, dX = self._rates(self.u, self.v, self.X)
        u, v, X = self.u + dt * du, self.v + dt * dv, self.X + dt * dX
        self._project(u, v)
        du, dv, dX = self._rates(u, v, X)
        self.u, self.v = 0.5 * (self.u + u + dt * du), 0.5 * (self.v + v + dt * dv)
        self.X = 0.5 * (self.X + X + dt * dX)
        self._project(self.u, self.v)

    def row(self, time: float) -> list[float]:
        corners = self.X[self.triangles]
        areas = 0.5 * np.linalg.det(corners[:, 1:] - corners[:, :1])
        x, y = (areas[:, None] * corners.mean(axis=1)).sum(axis=0) / areas.sum()
        kinetic = 0.5 * self.h**2 * ((self.u**2).sum() + (self.v**2).sum())
        return [time, x, y, areas.sum(), kinetic, self.elastic(self.X)[0]]

    def divergence(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The divergence of velocities on the cells' sides, (N, N), 1/s."""
        return (np.diff(u, axis=0) + np.diff(v, axis=1)) / self.h

    def elastic(self, X: np.ndarray) -> tuple[float, np.ndarray]:
        """The energy W of the triangles, J/m, and the forces on their nodes, N/m."""
        G, corners = self.problem.shear_modulus, X[self.triangles]
        F = np.swapaxes(self._inverse @ (corners[:, 1:] - corners[:, :1]), 1, 2)
        J = np.linalg.det(F)
        energy = 0.5 * G * (self.areas * ((F * F).sum(axis=(1, 2)) - 2 - 2 * np.log(J))).sum()
        P = G * (F - np.swapaxes(np.linalg.inv(F), 1, 2))
        two = -self.areas[:, None, None] * np.swapaxes(P @ self._inverse, 1, 2)  # forces on nodes 1 and 2
        nodal = np.concatenate([-two.sum(axis=1, keepdims=True), two], axis=1)
        nodes = self.triangles.ravel()
        forces = [np.bincount(nodes, nodal[:, :, i].ravel(), len(X)) for i in range(2)]
        return float(energy), np.stack(forces, axis=1)

    def _rates(self, u: np.ndarray, v: np.ndarray, X: np.ndarray) -> tuple[np.ndarray, ...]:
        h, lid = self.h, self.problem.lid
        slips = lid is None
        # with the values beyond a wall the mean at the wall is its velocity, or the shear stress is zero
        U = np.pad(u, ((0, 0), (1, 1)), mode="edge") * (1.0 if slips else _mirror(u.shape, 1))
        V = np.pad(v, ((1, 1), (0, 0)), mode="edge") * (1.0 if slips else _mirror(v.shape, 0))
        U[:, -1] += 0.0 if lid is None else 2 * lid
        centre_u, centre_v = 0.5 * (u[1:] + u[:-1]), 0.5 * (v[:, 1:] + v[:, :-1])
        corner = 0.25 * (U[:, 1:] + U[:, :-1]) * (V[1:] + V[:-1])
        du, dv = np.zeros_like(u), np.zeros_like(v)
        nu = self.problem.viscosity / h**2
        du[1:-1] = -(np.diff(centre_u**2, axis=0) + np.diff(corner[1:-1], axis=1)) / h
        du[1:-1] += nu * (u[2:] + u[:-2] + U[1:-1, 2:] + U[1:-1, :-2] - 4 * u[1:-1])
        dv[:, 1:-1] = -(np.diff(centre_v**2, axis=1) + np.diff(corner[:, 1:-1], axis=0)) / h
        dv[:, 1:-1] += nu * (v[:, 2:] + v[:, :-2] + V[2:, 1:-1] + V[:-2, 1:-1] - 4 * v[:, 1:-1])
        forces = self.elastic(X)[1] / h**2
        dX = np.empty_like(X)
        for i, (rate, velocity) in enumerate(((du, u), (dv, v))):
            places, weights = self._stencil(X, i, rate.shape)
            spread = np.bincount(places.ravel(), (weights * forces[:, i : i + 1]).ravel(), rate.size)
            rate += spread.reshape(rate.shape)
            dX[:, i] = (velocity.ravel()[places] * weights).sum(axis=1)
        du[[0, -1]], dv[:, [0, -1]] = 0.0, 0.0
        return du, dv, dX

    def _stencil(self, X: np.ndarray, i: int, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the 16 values of v_i about each node, and their weights, (nodes, 16)."""
        offsets = (0.0, 0.5) if i == 0 else (0.5, 0.0)
        at = X / self.h - offsets
        first = np.floor(at).astype(int) - 1
        near = first[:, :, None] + np.arange(4)
        weights = self._kernel(at[:, :, None] - near)
        near = np.clip(near, 0, np.array(shape)[:, None] - 1)
        places = near[:, 0, :, None] * shape[1] + near[:, 1, None, :]
        both = weights[:, 0, :, None] * weights[:, 1, None, :]
        return places.reshape(len(X), 16), both.reshape(len(X), 16)

    def _project(self, u: np.ndarray, v: np.ndarray) -> None:
        """Subtract the gradient part of the velocities, in place."""
        p = dctn(self.divergence(u, v), type=2) / self._laplace
        p[0, 0] = 0.0
        p = idctn(p, type=2)
        u[1:-1] -= np.diff(p, axis=0) / self.h
        v[:, 1:-1] -= np.diff(p, axis=1) / self.h


def _mirror(shape: tuple[int, ...], axis: int) -> np.ndarray:
    """Factors of a padded array: -1 in the first and last place along the axis, else 1."""
    signs = np.ones(shape[axis] + 2)
    signs[[0, -1]] = -1.0
    return signs[None, :] if axis == 1 else signs[:, None]


def _kernel_of_three(r: np.ndarray) -> np.ndarray:
    """The kernel of Roma, Peskin and Berger, J. Comput. Phys. 153 (1999), with the same two moments."""
    r = np.abs(r)
    inner = (1 + np.sqrt(np.maximum(1 - 3 * r * r, 0))) / 3
    outer = (5 - 3 * r - np.sqrt(np.maximum(1 - 3 * (1 - r) ** 2, 0))) / 6
    return np.where(r < 0.5, inner, np.where(r < 1.5, outer, 0.0))


def _kernel(r: np.ndarray) -> np.ndarray:
    """Peskin's kernel, Acta Numerica 11 (2002), with sum 1 and first moment 0 for any place of the node."""
    r = np.abs(r)
    inner = (3 - 2 * r + np.sqrt(np.maximum(1 + 4 * r - 4 * r * r, 0))) / 8
    outer = (5 - 2 * r - np.sqrt(np.maximum(-7 + 12 * r - 4 * r * r, 0))) / 8
    return np.where(r < 1, inner, np.where(r < 2, outer, 0.0))


_KERNELS = {4: _kernel, 3: _kernel_of_three}
"""Kernels by their width in cells."""


def _disc(problem: Problem, spacing: float) -> tuple[np.ndarray, ...]:
    """Nodes on rings, triangles, their areas, and the inverses of the matrices of their edges."""
    rings = max(4, round(problem.radius / spacing))
    points = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        angle = 2 * np.pi * (np.arange(6 * k) + 0.5 * (k % 2)) / (6 * k)
        points.append(problem.radius * k / rings * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    X = np.concatenate(points)
    triangles = Delaunay(X).simplices
    turned = np.linalg.det(X[triangles[:, 1:]] - X[triangles[:, :1]]) < 0
    triangles[turned] = triangles[turned][:, [0, 2, 1]]
    edges = X[triangles[:, 1:]] - X[triangles[:, :1]]
    areas = 0.5 * np.linalg.det(edges)
    real = areas > 1e-6 * areas.mean()  # Delaunay's triangles of three points on a line have no area
    return X + problem.centre, triangles[real], areas[real], np.linalg.inv(edges[real])

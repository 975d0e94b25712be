"""Outlines of bodies in cells: level lines of a carried distance that cut off the bodies' volumes.

A body's signed distance phi from its outline at the start is carried with the flow, as a discontinuous
polynomial.  In a cell with the fraction theta, the body's part is phi > c. The level c is chosen so that the
part has the share theta of the cell, and therefore the volume that belongs to the body's amount. The outline
in the cell may be curved or consist of several parts: a slot or a film that is thinner than the cell has two
sides. Shares are sums over sub-cells, in which phi is linear.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from ngsolve import ET, CoefficientFunction, Mesh, specialcf

from ngvisco.forms.cut_simplices import level, share_above
from ngvisco.forms.mesh.mesh_arrays import VERTICES
from ngvisco.shapes.fractions import subdivision
from ngvisco.shapes.places import Places, mesh_points

_PIECES = 8
"""Two numbers of equal pieces in which phi is linear: of the edges of a cell, and of the sides of a strip."""


class CarriedDistances(Protocol):
    """Distances of bodies from their outlines, m, > 0 in the body, which the flow carries."""

    def carry(self, tau: float) -> None: ...

    def of(self, name: str, at_start: bool) -> CoefficientFunction: ...


class LevelLines:
    """Level lines phi = c in chosen cells that cut off the share theta of each cell.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Mesh of triangles.
    phi : CoefficientFunction
        Carried distance, > 0 in the body.
    cells : array (cells,)
        Numbers of the cells.
    theta : array (cells,)
        Share of the body in each cell.
    radii : array (cells, 3), optional
        Weights of volumes at the cells' corners.
    """

    def __init__(
        self,
        mesh: Mesh,
        phi: CoefficientFunction,
        cells: np.ndarray,
        theta: np.ndarray,
        radii: np.ndarray | None = None,
    ) -> None:
        # distances relative to each cell, as ``share_above`` expects
        self._mesh, self._phi, self.cells = mesh, phi / specialcf.mesh_size, cells
        corners, self._pieces = subdivision(2, _PIECES)
        self._lambdas = barycentric(corners)
        values = Places(mesh, cells, corners).values(self._phi).reshape(len(cells), len(corners))
        weights = None if radii is None else (radii @ self._lambdas.T)[:, self._pieces]
        self._level = level(values[:, self._pieces], theta, weights)
        self._values = (values - self._level[:, None])[:, self._pieces]

    def projected(self) -> np.ndarray:
        """Integrals of 3 lambda over the part phi > c, divided by the cell's size, (cells, 3 corners)."""
        doubled = [np.concatenate([self._values, self._values[..., [c]]], axis=2) for c in range(3)]
        shares = np.stack([share_above(values) for values in doubled], axis=2)
        return np.asarray(np.einsum("kpc,pce->ke", shares, self._lambdas[self._pieces]) / len(self._pieces))

    def shares(self, ends: np.ndarray, starts: np.ndarray, radii: np.ndarray | None = None) -> np.ndarray:
        """Share of phi > c in strips between a facet and its earlier place, (cells,); nan for no strip.

        ``ends`` are barycentric coordinates of both corners of the facet. ``starts`` are those of the matter
        at the corners before the step, (cells, 2, 3). Parts of a strip beyond the facet do not count.
        ``radii`` are weights of volumes at the cells' corners.
        """
        s = np.linspace(0, 1, _PIECES + 1)
        along, back = (of[..., None] for of in np.meshgrid(s, s, indexing="ij"))
        corner = [(1 - back) * ends[:, None, None, c] + back * starts[:, None, None, c] for c in (0, 1)]
        lambdas = (1 - along) * corner[0] + along * corner[1]
        reference = lambdas @ np.array(VERTICES[ET.TRIG])[:, :2]
        points = mesh_points(self._mesh, np.repeat(self.cells, (_PIECES + 1) ** 2), reference.reshape(-1, 2))
        values = np.asarray(self._phi(points)).reshape(lambdas.shape[:3]) - self._level[:, None, None]
        values, coordinates = _triangles(values[..., None])[..., 0], _triangles(lambdas)
        edges = np.diff(coordinates[..., 1:], axis=-2)
        facet = int(np.argmin(np.abs(ends).sum(axis=(0, 1)))) if len(ends) else 0
        sizes = np.abs(np.linalg.det(edges)) * (coordinates[..., facet].mean(axis=-1) > 0)
        weights = None if radii is None else np.einsum("kptc,kc->kpt", coordinates, radii)
        if weights is not None:
            sizes = sizes * weights.mean(axis=-1)
        whole = sizes.sum(axis=1)
        inside = (share_above(values, weights) * sizes).sum(axis=1)
        return np.where(whole > 0, inside / np.where(whole > 0, whole, 1.0), np.nan)


def barycentric(points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates of points of the reference triangle, in the order of its ``VERTICES``,
    (points, 3)."""
    matrix = np.column_stack([np.array(VERTICES[ET.TRIG])[:, :2], np.ones(3)])
    return np.asarray(np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(matrix))


def _triangles(values: np.ndarray) -> np.ndarray:
    """Values at the corners of both triangles of each square of a lattice, (cells, triangles, 3,
    components)."""
    a, b, c, d = values[:, :-1, :-1], values[:, 1:, :-1], values[:, 1:, 1:], values[:, :-1, 1:]
    both = np.stack([np.stack([a, b, c], axis=3), np.stack([a, c, d], axis=3)], axis=3)
    return both.reshape(len(values), 2 * _PIECES**2, 3, values.shape[-1])

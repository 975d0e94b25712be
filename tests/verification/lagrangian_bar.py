"""A bar of an elastoplastic metal thrown at a rigid wall without friction, by another method: a moving mesh.

Bilinear quadrilaterals move with the bar, a body of revolution or a block in plane strain.  The deviatoric
stress is integrated at 2 x 2 points; the pressure is one for each cell, by the ratio of its volumes, so that
the cells do not lock.  The explicit scheme of central differences has lumped masses.  Per referential volume

    psi = K/2 (J - 1)^2 + G/2 (tr b - 3) + H k^2/2,     det b = 1,

with the isochoric elastic left Cauchy-Green tensor b and the plastic strain k. The stress returns radially to
the yield surface |dev tau| = sqrt(2/3) (sigma_Y + H k) (Simo and Hughes, Computational Inelasticity, 1998,
Box 9.1). A bulk viscosity in proportion to density, speed of sound and size of the cell damps waves as short
as a cell. The code shares no line with the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_POINTS = np.array([[s, t] for s in (-1, 1) for t in (-1, 1)]) / np.sqrt(3)
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
_COURANT, _DAMPING = 0.4, 0.06
"""Ratio of the step to the time of a wave through the least height of a cell, and ratio of the bulk viscosity
to rho c h."""


@dataclass(frozen=True, kw_only=True)
class Metal:
    """A metal: density, bulk and shear modulus, yield stress and slope of the hardening, in consistent
    units."""

    density: float
    bulk: float
    shear: float
    yield_stress: float
    hardening: float


class ThrownBar:
    """The motion of a bar of a ``length`` and a half width or ``radius``, with its foot at the wall y = 0.

    ``x`` are the nodes' places and ``v`` their velocities, (nodes, 2); ``k`` is the plastic strain, (cells,
    4).  ``worked`` is the heat of plastic flow, and ``damped`` the heat of the bulk viscosity.
    """

    def __init__(
        self, metal: Metal, length: float, radius: float, speed: float, across: int, revolution: bool
    ) -> None:
        """``across`` is the number of cells of the half width; the cells are nearly squares."""
        self.metal, self.revolution, self.time, self.worked, self.damped = metal, revolution, 0.0, 0.0, 0.0
        along = round(length / radius * across)
        i, j = np.meshgrid(np.arange(across + 1), np.arange(along + 1))
        self.x = np.stack([radius * i.ravel() / across, length * j.ravel() / along], axis=1)
        first = (np.arange(along)[:, None] * (across + 1) + np.arange(across)).ravel()
        self.cells = np.stack([first, first + 1, first + across + 2, first + across + 1], axis=1)
        self.v = np.zeros_like(self.x)
        self.v[:, 1] = -speed
        s, t = _POINTS[:, None, 0] * _CORNERS[:, 0], _POINTS[:, None, 1] * _CORNERS[:, 1]
        self._shapes = (1 + s) * (1 + t) / 4
        self._slopes = np.stack([_CORNERS[:, 0] * (1 + t), _CORNERS[:, 1] * (1 + s)], axis=2) / 4
        self._start, weights, radii = self._mapped()
        self._volumes = weights
        self._start_radii = radii
        masses = metal.density * np.einsum("cq,qa->ca", weights, self._shapes)
        self.masses = np.bincount(self.cells.ravel(), masses.ravel())
        self.b = np.tile(np.eye(3), (*weights.shape, 1, 1))
        self.k, self._F = np.zeros(weights.shape), self._gradients()
        self._sound = float(np.sqrt((metal.bulk + 4 / 3 * metal.shear) / metal.density))

    def _mapped(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of places by the cells' coordinates, (cells, 4, 2, 2), volumes and radii of points."""
        places = self.x[self.cells]
        slopes = np.einsum("cai,qaj->cqij", places, self._slopes)
        radii = np.einsum("ca,qa->cq", places[..., 0], self._shapes)
        return slopes, np.linalg.det(slopes) * (radii if self.revolution else 1.0), radii

    def _gradients(self) -> np.ndarray:
        """F at the points, (cells, 4, 3, 3)."""
        slopes, _, radii = self._mapped()
        F = np.zeros((*radii.shape, 3, 3))
        F[..., :2, :2] = slopes @ np.linalg.inv(self._start)
        F[..., 2, 2] = radii / self._start_radii if self.revolution else 1.0
        return F

    @property
    def kinetic(self) -> float:
        """The kinetic energy, over 2 pi for a body of revolution."""
        return float(0.5 * (self.masses[:, None] * self.v**2).sum())

    @property
    def stored(self) -> float:
        """The elastic energy and the energy of hardening, over 2 pi for a body of revolution."""
        m, (_, volumes, _) = self.metal, self._mapped()
        J = volumes.sum(axis=1) / self._volumes.sum(axis=1)
        size = np.trace(self.b, axis1=2, axis2=3) - 3
        shear = self._volumes * (m.shear / 2 * size + m.hardening / 2 * self.k**2)
        return float(shear.sum() + (m.bulk / 2 * (J - 1) ** 2 * self._volumes.sum(axis=1)).sum())

    def _forces(self, tau: float) -> np.ndarray:
        """Forces of the stresses at the present places, (nodes, 2), after a step of ``tau``."""
        m, (slopes, volumes, radii) = self.metal, self._mapped()
        F = self._gradients()
        self._flow(F @ np.linalg.inv(self._F))
        self._F = F
        b, J = self.b, volumes.sum(axis=1) / self._volumes.sum(axis=1)
        deviator = m.shear * (b - np.trace(b, axis1=2, axis2=3)[..., None, None] / 3 * np.eye(3))
        by_places = self._slopes @ np.linalg.inv(slopes)  # derivatives of the shapes, (cells, 4, 4, 2)
        of_stress = np.einsum("cqij,cqaj->caqi", deviator[..., :2, :2], by_places)
        forces = np.einsum("cq,caqi->cai", self._volumes, of_stress)
        of_volume = np.einsum("cq,cqai->cai", volumes, by_places)
        if self.revolution:
            hoop = np.einsum("cq,qa->caq", self._volumes / radii, self._shapes)
            forces[..., 0] += (deviator[..., 2, 2][:, None] * hoop).sum(axis=2)
            of_volume[..., 0] += np.einsum("cq,qa->ca", volumes / radii, self._shapes)
        whole = volumes.sum(axis=1)
        rate = (of_volume * self.v[self.cells]).sum(axis=(1, 2)) / whole
        damping = _DAMPING * m.density / J * self._sound * self._height() * rate
        self.damped += tau * float((damping * rate * whole).sum())
        forces += (m.bulk * (J - 1) + damping)[:, None, None] * of_volume
        result = np.zeros_like(self.x)
        np.add.at(result, self.cells, forces)
        return result

    def _height(self) -> np.ndarray:
        """The least height of each cell."""
        places = self.x[self.cells]
        sides = np.linalg.norm(places - np.roll(places, 1, axis=1), axis=2).max(axis=1)
        crossed = places[:, 2:] - places[:, :2]
        return abs(np.linalg.det(crossed)) / 2 / sides

    def _flow(self, change: np.ndarray) -> None:
        """Carry b along a ``change`` of F and return it to the yield surface."""
        m = self.metal
        change = change / np.cbrt(np.linalg.det(change))[..., None, None]
        b = change @ self.b @ change.swapaxes(2, 3)
        third = np.trace(b, axis1=2, axis2=3) / 3
        deviator = b - third[..., None, None] * np.eye(3)
        size = np.linalg.norm(deviator, axis=(2, 3))
        excess = m.shear * size - np.sqrt(2 / 3) * (m.yield_stress + m.hardening * self.k)
        mean = m.shear * third
        flow = np.maximum(excess, 0) / (2 * mean) / (1 + m.hardening / (3 * mean))
        left = 1 - 2 * third * flow / np.maximum(size, 1e-300)
        self.k = self.k + np.sqrt(2 / 3) * flow
        deviator = left[..., None, None] * deviator
        self.b = deviator + self._third(deviator)[..., None, None] * np.eye(3)
        grown = np.sqrt(2 / 3) * flow
        self.worked += m.yield_stress * float((self._volumes * grown).sum())

    @staticmethod
    def _third(deviator: np.ndarray) -> np.ndarray:
        """The third of the trace of the tensor with this deviator and determinant one."""
        norm, third = (deviator**2).sum(axis=(2, 3)) / 2, np.ones(deviator.shape[:2])
        of_third = np.linalg.det(deviator)
        for _ in range(8):  # det(D + p I) = p^3 - |D|^2/2 p + det D
            third = third - (third**3 - norm * third + of_third - 1) / (3 * third**2 - norm)
        return third

    def run(self, until: float) -> None:
        """Move until the time ``until``."""
        while self.time < until - 1e-12:
            tau = min(_COURANT * float(self._height().min()) / self._sound, until - self.time)
            acceleration = -self._forces(tau) / self.masses[:, None]
            self.v = self.v + tau * acceleration
            self.v[np.arange(len(self.x)) % (self.cells[0, 3]) == 0, 0] = 0.0
            touching = (self.x[:, 1] <= 0) & (self.v[:, 1] < 0)
            self.v[touching, 1] = 0.0
            self.x = self.x + tau * self.v
            self.x[:, 1] = np.maximum(self.x[:, 1], 0.0)
            self.time += tau

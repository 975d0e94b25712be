"""An elastic disc thrown at a rigid wall without friction, by another method, whose mesh moves with the
disc.

By symmetry the disc is one of two discs that meet.  The disc is a ``LagrangianSolid`` of order 2, on curved
triangles of the half above the line of flight, neo-Hookean in plane strain. The disc is in empty space, or in
a weightless fluid in a closed box, with one pressure that follows from the fluid's area and U(J) = K/2 (J -
1)^2/J.  The wall pushes a point of the rim with kappa times the depth of the point beyond the wall. Each step
conserves the sum of this spring energy and the disc's energy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import (
    CF,
    BilinearForm,
    Det,
    Grad,
    Id,
    IfPos,
    InnerProduct,
    Integrate,
    Inv,
    Mesh,
    Parameter,
    VectorH1,
    ds,
    dx,
    x,
)

from tests.verification.lagrangian_solid import LagrangianSolid, neo_hookean

_PENALTY = 100.0
"""The factor kappa in units of (K + G)/radius. With this factor, a stress of a tenth of K + G makes a depth
of a thousandth of the radius."""
_STILL = 1e-12
"""Displacement in a step, m, below which a point counts as resting."""


@dataclass(frozen=True, kw_only=True)
class Disc:
    """A disc: radius, m, density, kg/m^3, bulk and shear modulus, Pa, viscosity in bulk and shear, Pa s."""

    radius: float
    density: float
    bulk: float
    shear: float
    viscosity: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Medium:
    """A weightless fluid around the disc: its bulk modulus, Pa, and its area at rest, m^2."""

    bulk: float
    area: float


class ThrownDisc(LagrangianSolid):
    """The motion of a disc whose centre is at the origin at first.

    ``start`` is the velocity, m/s, mirrored about y = 0; ``gap`` the distance of the wall, on the right, m.
    Each step has a row of ``rows``: the time, s, and for the whole disc the momentum along x, kg/s, and the
    kinetic, stored and penalty energies, the energy dissipated by viscosity so far, and the energy of the
    medium, J/m.
    """

    def __init__(
        self,
        disc: Disc,
        start: CF,
        gap: float,
        maxh: float,
        penalty: float = _PENALTY,
        medium: Medium | None = None,
    ) -> None:
        space = VectorH1(_half(disc.radius, maxh), order=2, dirichlety="axis")
        stored = neo_hookean(disc.bulk, disc.shear)
        super().__init__(space, start, stored, disc.density, disc.viscosity)
        self.medium, self._pressure = medium, Parameter(0.0)
        self.rows: list[tuple[float, ...]] = []
        self._stiffness = penalty * (disc.bulk + disc.shear) / disc.radius
        self._beyond: Callable[[CF], CF] = lambda u: _positive(u[0] + x - disc.radius - gap)
        self._accept()

    def run(self, until: float, tau: float) -> np.ndarray:
        """Make steps of ``tau``, s, until ``until``; return ``rows`` as an array."""
        self.advance(until, tau)
        return np.array(self.rows)

    def _iterate(self) -> None:
        self._pressure.Set(self._of_medium(0.5 * (Grad(self._next) + Grad(self.u)))[0])

    def _add_forces(self, form: BilinearForm, u: CF, w: CF) -> None:
        if self.medium is not None:
            F = self._mean_F(u)
            form += self._pressure * Det(F) * InnerProduct(Inv(F).trans, Grad(w)) * dx(bonus_intorder=4)
        before, after = self._beyond(self.u), self._beyond(u)
        # divided by 2 (u - u_old), so that the work is exactly the stored energy
        moved = after * after - before * before
        far = (u[0] - self.u[0]) * (u[0] - self.u[0]) - _STILL**2
        push = self._stiffness * IfPos(far, 0.5 * moved / (u[0] - self.u[0]), 0.5 * (before + after))
        form += (push * w[0]).Compile() * ds("rim", bonus_intorder=6)

    def _of_medium(self, grad_u: CF) -> tuple[float, float]:
        """The medium's pressure, Pa, and energy, J/m, at a displacement."""
        if self.medium is None:
            return 0.0, 0.0
        grown = 2 * float(Integrate(Det(Id(2) + grad_u) - 1, self.mesh, order=8))
        J = 1 - grown / self.medium.area
        half = self.medium.bulk / 2
        return half * (1 / J**2 - 1), half * self.medium.area * (J - 1) ** 2 / J

    def _accept(self) -> None:
        momentum = 2 * self._density * float(Integrate(self.v[0], self.mesh, order=6))
        depth = Integrate(self._beyond(self.u) ** 2 * ds("rim", bonus_intorder=6), self.mesh)
        of_disc = 2 * self.kinetic, 2 * self.stored
        _, of_medium = self._of_medium(Grad(self.u))
        others = self._stiffness * float(depth), 2 * self.dissipated, of_medium
        self.rows.append((self.time, momentum, *of_disc, *others))


def restitution(rows: np.ndarray) -> float:
    """Coefficient of restitution, which is the ratio of the largest backward momentum to the initial
    momentum."""
    momentum = rows[:, 1]
    return float(-momentum.min() / momentum[0])


def _positive(value: CF) -> CF:
    return IfPos(value, value, 0.0)


def _half(radius: float, maxh: float) -> Mesh:
    box = WorkPlane().MoveTo(-2 * radius, 0).Rectangle(4 * radius, 2 * radius).Face()
    half = WorkPlane().Circle(0, 0, radius).Face() * box
    for edge in half.edges:
        edge.name = "axis" if abs(edge.center.y) < 1e-9 * radius else "rim"
    return Mesh(OCCGeometry(half, dim=2).GenerateMesh(maxh=maxh)).Curve(2)

"""An elastic disc thrown at a rigid wall without friction, by another method, whose mesh moves with the
disc.

By symmetry the disc is one of two discs that meet.  Displacements u of order 2, on curved triangles of the
half above the line of flight, solve

    rho_0 dt v = Div P,  dt u = v,  P = psi'(F) + J D(L) F^{-T},  L = (Grad v) F^{-1},  F = I + Grad u,

plane strain, psi = K/2 (J - 1)^2 + G/2 (J^{-2/3} tr F^T F - 3) per referential volume, D a Newtonian stress.
The disc is in empty space, or in a weightless fluid in a closed box, with one pressure that follows from the
fluid's area and U(J) = K/2 (J - 1)^2/J.  The wall pushes with kappa times the depth by which a point of the
rim is beyond it; each step conserves the sum of this spring energy and the disc's.  The time scheme is the
implicit midpoint rule.
The code shares no line with the package.
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
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Integrate,
    Inv,
    Mesh,
    Norm,
    Parameter,
    Trace,
    VectorH1,
    ds,
    dx,
    x,
)

_CONVERGED, _MOST = 1e-11, 60
_PENALTY = 100.0
"""kappa over (K + G)/radius: a stress of a tenth of K + G makes a depth of a thousandth of the radius."""
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


class ThrownDisc:
    """The motion of a disc whose centre is at the origin at first.

    ``start`` is the velocity, m/s, mirrored about y = 0; ``gap`` the distance of the wall, on the right, m.
    Each step has a row of ``rows``: the time, s, and for the whole disc the momentum along x, kg/s, and the
    kinetic, stored and penalty energies, the energy dissipated by viscosity so far, and that of the medium,
    J/m.
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
        self.disc, self._time, self._dissipated = disc, 0.0, 0.0
        self.medium, self._pressure = medium, Parameter(0.0)
        self.rows: list[tuple[float, ...]] = []
        self.mesh = mesh = _half(disc.radius, maxh)
        space = VectorH1(mesh, order=2, dirichlety="axis")
        self.u, self.v, self._next = (GridFunction(space) for _ in range(3))
        self.v.Set(start)
        self._change, self._rows = (self._next.vec.CreateVector() for _ in range(2))
        self._stiffness = penalty * (disc.bulk + disc.shear) / disc.radius
        self._beyond: Callable[[CF], CF] = lambda u: _positive(u[0] + x - disc.radius - gap)
        self._note()

    def _stored(self, F: CF) -> CF:
        """The stored energy psi, with a stretch of one in the third direction."""
        d, J = self.disc, Det(F)
        return d.bulk / 2 * (J - 1) ** 2 + d.shear / 2 * (J ** (-2 / 3) * (InnerProduct(F, F) + 1) - 3)

    def _viscous(self, F: CF, grad_v: CF) -> tuple[CF, CF]:
        """The viscous stress J D(L), and L."""
        L = grad_v * Inv(F)
        shear = 0.5 * (L + L.trans) - Trace(L) / 3 * Id(2)
        return self.disc.viscosity * Det(F) * (Trace(L) * Id(2) + 2 * shear), L

    def run(self, until: float, tau: float) -> np.ndarray:
        """Make steps of ``tau``, s, until ``until``; return ``rows`` as an array."""
        form, space = self._equations(tau), self.u.space
        change, rows, end = self._change, self._rows, self._next.vec
        for _ in range(round((until - self._time) / tau)):
            end.data = self.u.vec + tau * self.v.vec
            for _ in range(_MOST):
                self._pressure.Set(self._of_medium(0.5 * (Grad(self._next) + Grad(self.u)))[0])
                form.Apply(end, rows)
                form.AssembleLinearization(end)
                change.data = form.mat.Inverse(space.FreeDofs(), "umfpack") * rows
                end.data -= change
                if Norm(change) <= _CONVERGED * (1 + Norm(end)):
                    break
            else:
                raise RuntimeError(f"no step of {tau:g} s from {self._time:g} s")
            self._dissipated += tau * self._power(tau)
            change.data = 2 / tau * (end - self.u.vec) - self.v.vec
            self.v.vec.data, self.u.vec.data = change, end
            self._time += tau
            self._note()
        return np.array(self.rows)

    def _equations(self, tau: float) -> BilinearForm:
        form = BilinearForm(self.u.space)
        u, w = self.u.space.TnT()
        F = (Id(2) + 0.5 * (Grad(u) + Grad(self.u))).MakeVariable()
        flux, _ = self._viscous(F, (Grad(u) - Grad(self.u)) / tau)
        power = InnerProduct(self._stored(F).Diff(F), Grad(w)) + InnerProduct(flux, Grad(w) * Inv(F))
        velocity = (u - self.u) / tau
        inertia = 2 / tau * self.disc.density * InnerProduct(velocity - self.v, w)
        form += (inertia + power).Compile() * dx(bonus_intorder=4)
        if self.medium is not None:
            form += self._pressure * Det(F) * InnerProduct(Inv(F).trans, Grad(w)) * dx(bonus_intorder=4)
        before, after = self._beyond(self.u), self._beyond(u)
        moved = after * after - before * before  # over 2 (u - u_old): stored energy is exactly the work
        far = (u[0] - self.u[0]) * (u[0] - self.u[0]) - _STILL**2
        push = self._stiffness * IfPos(far, 0.5 * moved / (u[0] - self.u[0]), 0.5 * (before + after))
        form += (push * w[0]).Compile() * ds("rim", bonus_intorder=6)
        return form

    def _of_medium(self, grad_u: CF) -> tuple[float, float]:
        """The medium's pressure, Pa, and energy, J/m, at a displacement."""
        if self.medium is None:
            return 0.0, 0.0
        grown = 2 * float(Integrate(Det(Id(2) + grad_u) - 1, self.mesh, order=8))
        J = 1 - grown / self.medium.area
        half = self.medium.bulk / 2
        return half * (1 / J**2 - 1), half * self.medium.area * (J - 1) ** 2 / J

    def _power(self, tau: float) -> float:
        """The power dissipated by viscosity in both halves in the step, W/m."""
        F = Id(2) + 0.5 * (Grad(self._next) + Grad(self.u))
        flux, L = self._viscous(F, (Grad(self._next) - Grad(self.u)) / tau)
        return 2 * float(Integrate(InnerProduct(flux, L), self.mesh, order=8))

    def _note(self) -> None:
        d, in_cells = self.disc, (self.v[0], InnerProduct(self.v, self.v))
        momentum, square = (2 * d.density * float(Integrate(of, self.mesh, order=6)) for of in in_cells)
        stored = 2 * float(Integrate(self._stored(Id(2) + Grad(self.u)), self.mesh, order=8))
        depth = Integrate(self._beyond(self.u) ** 2 * ds("rim", bonus_intorder=6), self.mesh)
        of_wall = self._stiffness * float(depth)
        _, of_medium = self._of_medium(Grad(self.u))
        self.rows.append((self._time, momentum, square / 2, stored, of_wall, self._dissipated, of_medium))


def restitution(rows: np.ndarray) -> float:
    """Coefficient of restitution: the largest momentum backwards over the momentum at first."""
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

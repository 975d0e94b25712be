"""The motion of a hyperelastic solid by another method, whose mesh moves with the solid.

Displacements u in a space of vectors solve, in plane strain or in three dimensions,

    rho_0 dt v = Div P,  dt u = v,  P = psi'(F) + J D(L) F^{-T},  L = (Grad v) F^{-1},  F = I + Grad u,

where psi is an energy per referential volume, and D a Newtonian stress. Derived classes add forces.
The time scheme is the implicit midpoint rule. The code shares no line with the package.
"""

from __future__ import annotations

from collections.abc import Callable

from ngsolve import (
    CF,
    BilinearForm,
    Det,
    FESpace,
    Grad,
    GridFunction,
    Id,
    InnerProduct,
    Integrate,
    Inv,
    Norm,
    Trace,
    dx,
)

_CONVERGED, _MOST = 1e-11, 60
"""Ratio of the norms of increment and u below which Newton's method ends, and the largest number of its
iterations."""


def neo_hookean(bulk: float, shear: float) -> Callable[[CF], CF]:
    """The energy K/2 (J - 1)^2 + G/2 (J^{-2/3} tr F^T F - 3) per referential volume, J/m^3.

    In two dimensions the stretch in the third direction is one.
    """

    def stored(F: CF) -> CF:
        J, square = Det(F), InnerProduct(F, F) + 3 - F.dims[0]
        return bulk / 2 * (J - 1) ** 2 + shear / 2 * (J ** (-2 / 3) * square - 3)

    return stored


class LagrangianSolid:
    """The motion of a solid that starts without strain.

    ``start`` is the velocity, m/s; ``stored`` the energy psi by F, J/m^3; ``density`` in kg/m^3,
    ``viscosity`` in Pa s in bulk and shear alike.  ``time`` is in s, and ``dissipated`` the energy that
    viscosity has dissipated, in J, per metre in two dimensions.
    """

    def __init__(
        self,
        space: FESpace,
        start: CF,
        stored: Callable[[CF], CF],
        density: float,
        viscosity: float = 0.0,
    ) -> None:
        self.mesh, self.time, self.dissipated = space.mesh, 0.0, 0.0
        self._energy, self._density, self._viscosity = stored, density, viscosity
        self._identity = Id(self.mesh.dim)
        self.u, self.v, self._next = (GridFunction(space) for _ in range(3))
        self.v.Set(start)
        self._change, self._rows = (self._next.vec.CreateVector() for _ in range(2))

    @property
    def kinetic(self) -> float:
        """The kinetic energy, J, or J/m in two dimensions."""
        return self._density / 2 * float(Integrate(InnerProduct(self.v, self.v), self.mesh, order=6))

    @property
    def stored(self) -> float:
        """The stored energy, J, or J/m in two dimensions."""
        return float(Integrate(self._energy(self._identity + Grad(self.u)), self.mesh, order=8))

    def advance(self, until: float, tau: float) -> None:
        """Make steps of ``tau``, s, until ``until``.  Raises RuntimeError if a step is not solved."""
        form, space = self._equations(tau), self.u.space
        change, rows, end = self._change, self._rows, self._next.vec
        for _ in range(round((until - self.time) / tau)):
            end.data = self.u.vec + tau * self.v.vec
            for _ in range(_MOST):
                self._iterate()
                form.Apply(end, rows)
                form.AssembleLinearization(end)
                change.data = form.mat.Inverse(space.FreeDofs(), "umfpack") * rows
                end.data -= change
                if Norm(change) <= _CONVERGED * (1 + Norm(end)):
                    break
            else:
                raise RuntimeError(f"no step of {tau:g} s from {self.time:g} s")
            if self._viscosity:
                flux, L = self._viscous(self._mean_F(self._next), (Grad(self._next) - Grad(self.u)) / tau)
                self.dissipated += tau * float(Integrate(InnerProduct(flux, L), self.mesh, order=8))
            change.data = 2 / tau * (end - self.u.vec) - self.v.vec
            self.v.vec.data, self.u.vec.data = change, end
            self.time += tau
            self._accept()

    def _iterate(self) -> None:
        """Hook for derived classes, called with each iterate of Newton's method in ``_next``."""

    def _accept(self) -> None:
        """Hook for derived classes, called after each step."""

    def _add_forces(self, form: BilinearForm, u: CF, w: CF) -> None:
        """Add further forces on the body, whose displacement at the end of the step is u, tested by w."""

    def _mean_F(self, u: CF) -> CF:
        """F at the middle of a step with the displacement u at its end."""
        return self._identity + 0.5 * (Grad(u) + Grad(self.u))

    def _viscous(self, F: CF, grad_v: CF) -> tuple[CF, CF]:
        """The viscous stress J D(L), and L."""
        L = grad_v * Inv(F)
        shear = 0.5 * (L + L.trans) - Trace(L) / 3 * self._identity
        return self._viscosity * Det(F) * (Trace(L) * self._identity + 2 * shear), L

    def _equations(self, tau: float) -> BilinearForm:
        form = BilinearForm(self.u.space)
        u, w = self.u.space.TnT()
        F = self._mean_F(u).MakeVariable()
        power = InnerProduct(self._energy(F).Diff(F), Grad(w))
        if self._viscosity:
            flux, _ = self._viscous(F, (Grad(u) - Grad(self.u)) / tau)
            power += InnerProduct(flux, Grad(w) * Inv(F))
        inertia = 2 / tau * self._density * InnerProduct((u - self.u) / tau - self.v, w)
        form += (inertia + power).Compile() * dx
        self._add_forces(form, u, w)
        return form

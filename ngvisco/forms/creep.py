"""Creep with a gradient term: its rate Pi is a field of its own.

    G_m Pi - div(nu |grad Pi|^{q-2} grad Pi) = M,   (n . grad) Pi = 0 on walls
    (paper: ED-Euler-large3, Euler-large-viscoelastodyn+4disc, with + M as the energy balance needs)

Pi is continuous, in the components of an orthonormal basis of R^{3x3}_dev (plane strain in 2D), so that
it is symmetric and trace-free by construction.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngvisco.forms.context import Context, Entry, Integrand
from ngvisco.forms.spaces import Fields
from ngvisco.forms.transport import Transport
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import inner, square


@dataclass(frozen=True)
class CreepRate:
    """int G_m Pi : P + nu |grad Pi|^{q-2} grad Pi : grad P - M : P = 0, M of the projected conjugates.

    P = Pi gives the creep power that the kinematic equations, tested by zeta, take from the stored energy.
    """

    model: Model
    context: Context

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        creep = self.model.creep
        assert creep is not None
        M = Transport(self.model, self.context).mandel(u)
        gradient = creep.gradient_coefficient(square(u.grad_Pi)) * inner(u.grad_Pi, w.grad_Pi)
        return [
            Integrand(creep.G_m * inner(u.parts["Pi"], w.parts["Pi"])),
            Integrand(gradient),
            Integrand(-inner(M, w.Pi)),
        ]

    def entries(self, u: Fields) -> list[Entry]:
        creep = self.model.creep
        assert creep is not None
        size = square(u.grad_Pi)
        gradient = Integrand(creep.gradient_coefficient(size) * size)
        return [
            Entry("dissipation_creep", "dissipation", Integrand(creep.G_m * square(u.parts["Pi"]))),
            Entry("dissipation_creep_gradient", "dissipation", gradient),
        ]

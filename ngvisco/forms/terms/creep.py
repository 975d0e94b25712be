"""Creep with a gradient term: its rate Pi is a field of its own.

    psi'(Pi) - div(nu |grad Pi|^{q-2} grad Pi) = M,   (n . grad) Pi = 0 on walls
    (paper: ED-Euler-large3, Euler-large-viscoelastodyn+4disc, with + M as the energy balance needs)

psi'(Pi) = G_m Pi in the paper; any flow rule with a potential of Pi gives its own.

Pi is continuous, in the components of an orthonormal basis of R^{3x3}_dev (plane strain in 2D), so that
it is symmetric and trace-free by construction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.forms.fields import Fields
from ngvisco.forms.term import PointTerm, Setting, Unknown
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.model import Flow
from ngvisco.physics.tensors import inner, square, trace_free_tensors


@dataclass(frozen=True)
class CreepRate(PointTerm):
    """int psi'(Pi) : P + nu |grad Pi|^{q-2} grad Pi : grad P - M : P = 0, M of the projected conjugates.

    P = Pi gives the creep power that the kinematic equations, tested by zeta, take from the stored energy.
    """

    rule: FlowRule

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown("Pi", "continuous", max(1, setting.m), trace_free_tensors(setting.dim).size),)

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        gradient = self.rule.gradient_coefficient(square(u.grad_Pi))
        z = u.context.rates.read_values(self.rule, u, u.context.rates.flows[0])
        force = trace_free_tensors(u.dim).components(self.rule.force(u.Pi, z))
        return [
            inner(force, w.parts["Pi"]),
            gradient * inner(u.grad_Pi, w.grad_Pi),
            -inner(u.context.rates.mandel_components(u), w.parts["Pi"]),
        ]

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        rates = u.context.rates
        return {
            "dissipation_creep": rates.dissipation(u),
            "dissipation_creep_gradient": rates.gradient_dissipation(u),
        }


@dataclass(frozen=True)
class PlasticStraining(PointTerm):
    """- int dk/dt q in the equation of the plastic strain k, q its test, dk/dt = sqrt(2/3) |Pi|.

    Of a body that is - int n_i dk/dt q in that of K_i = n_i k.  q = zeta_k = phi_h'(k) gives the power that
    hardening stores: ``dissipation_creep`` is without it.
    """

    flow: Flow

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [] if u.context.rates.creeps_at_nodes else self._rows(u, w)

    def nodes(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self._rows(u, w) if u.context.rates.creeps_at_nodes else []

    def _rows(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        rates = u.context.rates
        Pi = rates.creep(u)[rates.flows.index(self.flow)]
        return [-rates.hardening_rate(self.flow, Pi, u) * w.z_tensors[self.flow.plastic_strain]]

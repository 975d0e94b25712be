"""Hyperviscosity div^2(mu |hess v|^{p-2} hess v) as a lifted C0 interior penalty.

(paper: Euler-small-viscoelastodyn+1 with the natural condition hess v : (n x n) = 0 of
Euler-small-BC-hyper.)  v is only continuous; a is the single-valued normal derivative on facets.  The
gradient on facets is then single-valued too, g = grad v + (a - d_n v) x n, and the recovered Hessian
Hs in P_{k-2}, symmetric in its last two indices, is the projection of its distributional gradient,

    int_K Hs : G = -int_K grad v : div G + int_{dK} g : (G n)          for all G,

which on straight cells is int_K hess v : G + int_{dK} (a - d_n v) . (G : n x n): no second derivative
of a shape function is ever evaluated (assembling those took nine tenths of the time in 3D).
The potential, convex because Hs is linear in (v, a), is with j = a - d_n v

    Psi = int psi(|Hs|) + sum_K int_{dK} sigma/(2h) c(|Hs|^2 + |j|^2/h^2 + chi^2) |j|^2,   psi' = c Hs,

where chi, a tenth of a typical |hess v|, keeps a determined where v is nearly affine, and
c(s) = mu_1 + mu s^{(p-2)/2}.  It is made stationary with multipliers: the hyperstress S of the lifting,
and a scalar pair (s, c_s) in P_{2k-4} with s = |Hs|^2, so that all nonlinearity is in scalars (a
Jacobian that couples all components of Hs, grad v and a costs four times as much to assemble):

    int (|Hs|^2 - s) l                                                   = 0   (test of c_s)
    int (c_s - c(s)) t - sum_K int_{dK} sigma/h c'(s + |j|^2/h^2 + chi^2)|j|^2 t = 0   (test of s)
    int (c_s Hs - S) : G                                                 = 0   (test of Hs)
    int Hs : X + int grad v : div X - int_{dK} g : (X n)                 = 0   (test of S)
    -int grad w : div S + int_{dK} (grad w + (b - d_n w) x n) : (S n)
      + sum_K int_{dK} (sigma/h c + sigma/h^3 c' |j|^2) j . (b - d_n w)  = 0   (tests of v and a).

On walls a stays free, which is the natural condition.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.forms.context import Context, Entry, Integrand, negative
from ngvisco.forms.spaces import Fields
from ngvisco.physics.rheology import HyperViscosity
from ngvisco.physics.tensors import inner, square


@dataclass(frozen=True)
class Hyperviscosity:
    """<Psi'(v, a), (w, b)> with its local unknowns; dissipation <Psi', (v, a)>."""

    law: HyperViscosity
    context: Context

    def penalty(self, u: Fields) -> tuple[CoefficientFunction, CoefficientFunction | None]:
        """sigma/h (c(s~), c'(s~) |j|^2) at s~ = s + |j|^2/h^2 + chi^2; the second is None where c' = 0."""
        law, h = self.law, self.context.h
        weight = law.penalty / h
        if law.is_linear:
            return weight * (law.mu + law.mu_1), None
        floor = self.context.curvature * self.context.curvature
        size = u.hess_square + square(u.jump) / (h * h) + floor
        return weight * law.coefficient(size), weight * law.slope(size) * square(u.jump)

    def lifting(self, v: Fields, X: Fields) -> list[Integrand]:
        """-int grad v : div X + int_{dK} (grad v + j x n) : (X n)."""
        n = self.context.normal
        X_n = X.hyperstress_normal(n)
        parts = [Integrand(facets=inner(X_n, v.grad_v)), Integrand(facets=inner(X_n * n, v.jump))]
        if v.layout.discretisation.k > 2:
            parts.append(Integrand(-inner(X.div_hyperstress, v.grad_v)))
        return parts

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        law, h = self.law, self.context.h
        penalty, coupling = self.penalty(u)
        parts = [
            *self.lifting(w, u),
            *negative(self.lifting(u, w)),
            Integrand(inner(u.hess, w.hyperstress)),
            Integrand(-inner(u.hyperstress, w.hess)),
        ]
        jumps = inner(u.jump, w.jump)
        if coupling is None:
            stress = (law.mu + law.mu_1) * u.hess
            return [*parts, Integrand(inner(stress, w.hess), penalty * jumps)]
        coefficient = u.hyper_coefficient - law.coefficient(u.hess_square)
        return [
            *parts,
            Integrand(u.hyper_coefficient * inner(u.hess, w.hess)),
            Integrand((square(u.hess) - u.hess_square) * w.hyper_coefficient),
            Integrand(coefficient * w.hess_square, -coupling * w.hess_square),
            Integrand(facets=(penalty + coupling / (h * h)) * jumps),
        ]

    def coefficient_load(self, u: Fields, t: CoefficientFunction) -> Integrand:
        """int c(s) t + sum_K int_{dK} sigma/h c'(s~)|j|^2 t: the load that c_s is the projection of."""
        _, coupling = self.penalty(u)
        assert coupling is not None
        return Integrand(self.law.coefficient(u.hess_square) * t, coupling * t)

    def entries(self, u: Fields) -> list[Entry]:
        """int c(|Hs|^2)|Hs|^2 and the penalty's share: the paper's int mu |hess v|^p."""
        penalty, coupling = self.penalty(u)
        facets = penalty * square(u.jump)
        cells = (self.law.mu + self.law.mu_1) * square(u.hess)
        if coupling is not None:
            h = self.context.h
            facets = facets + coupling * (u.hess_square + square(u.jump) / (h * h))
            cells = self.law.coefficient(u.hess_square) * u.hess_square
        return [Entry("dissipation_hyper", "dissipation", Integrand(cells, facets))]

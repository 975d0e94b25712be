"""Hyperviscosity div^2(mu |hess v|^{p-2} hess v) as a lifted C0 interior penalty.

(paper: Euler-small-viscoelastodyn+1 with the natural condition hess v : (n x n) = 0 of
Euler-small-BC-hyper.)  v is only continuous; a is the single-valued normal derivative on facets.  The
gradient on facets, g = grad v + (a - d_n v) x n, is then single-valued too. The recovered Hessian Hs in
P_{k-2}, symmetric in its last two indices, is the projection of the distributional gradient of g:

    int_K Hs : G = -int_K grad v : div G + int_{dK} g : (G n)          for all G.

On straight cells the right-hand side is int_K hess v : G + int_{dK} (a - d_n v) . (G : n x n). The form in
use evaluates no second derivatives of shape functions (in 3D, assembling second derivatives took nine tenths
of the time). With j = a - d_n v the potential, convex because Hs is linear in (v, a), is

    Psi = int psi(|Hs|) + sum_K int_{dK} sigma/(2h) c(|Hs|^2 + |j|^2/h^2 + chi^2) |j|^2,   psi' = c Hs,

where chi, a tenth of a typical |hess v|, keeps a determined where v is nearly affine, and
c(s) = mu_1 + mu s^{(p-2)/2}.  Psi is made stationary with multipliers: the hyperstress S of the lifting, and
a scalar pair (s, c_s) in P_{2k-4} with s = |Hs|^2. All nonlinearity is then in scalars. (A Jacobian that
couples all components of Hs, grad v and a costs four times as much to assemble.)

    int (|Hs|^2 - s) l                                                   = 0   (test of c_s)
    int (c_s - c(s)) t - sum_K int_{dK} sigma/h c'(s + |j|^2/h^2 + chi^2)|j|^2 t = 0   (test of s)
    int (c_s Hs - S) : G                                                 = 0   (test of Hs)
    int Hs : X + int grad v : div X - int_{dK} g : (X n)                 = 0   (test of S)
    -int grad w : div S + int_{dK} (grad w + (b - d_n w) x n) : (S n)
      + sum_K int_{dK} (sigma/h c + sigma/h^3 c' |j|^2) j . (b - d_n w)  = 0   (tests of v and a).

On walls a stays free, which is the natural condition.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Integrand, Integrands, PointTerm, tested
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.forms.unknown_values import hessian_basis
from ngvisco.physics.rheology import HyperViscosity
from ngvisco.physics.tensors import inner, square
from ngvisco.words import call


@dataclass(frozen=True)
class Hyperviscosity(PointTerm):
    """Derivative <Psi'(v, a), (w, b)> with its local unknowns; its dissipation is <Psi', (v, a)>."""

    law: HyperViscosity
    kernel, group = "hyperviscosity", ""
    plane_only = "about an axis the second gradient has further terms of v_r/r"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        k, dim = setting.k, setting.dim
        if k < 2:
            reason = ", since the velocity is then linear in cells; a hyperviscosity needs k = 2 or 3"
            expected = (None, " with ", call("Discretisation", k=1), reason)
            raise ParameterError("Model.hyperviscosity", self.law, *expected)
        tensors = dim * hessian_basis(dim).shape[1]
        unknowns = [Unknown("hess", "cells", k - 2, tensors), Unknown("hyperstress", "cells", k - 2, tensors)]
        if not self.law.is_linear:
            unknowns += [Unknown(name, "cells", 2 * k - 4) for name in ("hess_square", "hyper_coefficient")]
        normals = (Unknown(f"a_{i + 1}", "normals", k - 1, trace_of="v", component=i) for i in range(dim))
        return (*unknowns, *normals)

    def projections(self, u: Fields) -> list[tuple[str, Integrands]]:
        if self.law.is_linear:
            return []
        return [
            ("hess_square", tested(square(u.hess))),
            ("hyper_coefficient", lambda t: [self.coefficient_load(u, t)]),
            ("hyperstress", tested(u.hyper_coefficient * u.parts["hess"])),
        ]

    def penalty(self, u: Fields) -> tuple[CoefficientFunction, CoefficientFunction | None]:
        """Penalties sigma/h c(s~) and sigma/h c'(s~) |j|^2; the second is None if c' = 0. s~ is ``size``."""
        law, weight = self.law, self.law.penalty / u.context.h
        if law.is_linear:
            return weight * law.linear(u.z_tensors), None
        penalty = u.once("penalty", lambda: weight * law.coefficient(self.size(u), u.z_tensors))
        return penalty, self.penalty_slope(u) * square(u.jump)

    def penalty_slope(self, u: Fields) -> CoefficientFunction:
        """Slope of the penalty, sigma/h c'(s~)."""
        law, h = self.law, u.context.h
        return u.once("slope of the penalty", lambda: law.penalty / h * law.slope(self.size(u), u.z_tensors))

    def size(self, u: Fields) -> CoefficientFunction:
        """Squared size s~ = s + |j|^2/h^2 + chi^2 on a cell's boundary, 1/(m s)^2."""
        c = u.context
        return u.once(
            "size", lambda: u.hess_square + square(u.jump) / (c.h * c.h) + c.curvature * c.curvature
        )

    def stiffness(self, u: Fields) -> CoefficientFunction:
        """Factor sigma/h c + sigma/h^3 c' |j|^2 of j in the equations of v and a."""
        penalty, coupling = self.penalty(u)
        return penalty if coupling is None else penalty + coupling / (u.context.h * u.context.h)

    def lifting_in_cells(self, v: Fields, X: Fields) -> list[CoefficientFunction]:
        """Cells' part of the lifting, -int grad v : div X, which vanishes for X in P_0."""
        return [-inner(X.div_hyperstress, v.grad_v)] if v.layout.discretisation.k > 2 else []

    def lifting_on_facets(self, v: Fields, X: Fields) -> list[CoefficientFunction]:
        """Facets' part of the lifting, int_{dK} (grad v + j x n) : (X n)."""
        n = v.context.normal
        X_n = X.hyperstress_normal(n)
        return [inner(X_n, v.grad_v), inner(X_n * n, v.jump)]

    def lifting(self, v: Fields, X: Fields) -> list[Integrand]:
        """Lifting -int grad v : div X + int_{dK} (grad v + j x n) : (X n)."""
        cells = [Integrand(part) for part in self.lifting_in_cells(v, X)]
        return [Integrand(facets=part) for part in self.lifting_on_facets(v, X)] + cells

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        law, z = self.law, u.z_tensors
        parts = [
            *self.lifting_in_cells(w, u),
            *(-part for part in self.lifting_in_cells(u, w)),
            inner(u.hess, w.hyperstress),
            -inner(u.hyperstress, w.hess),
        ]
        if law.is_linear:
            return [*parts, law.linear(z) * inner(u.hess, w.hess)]
        return [
            *parts,
            u.hyper_coefficient * inner(u.hess, w.hess),
            (square(u.hess) - u.hess_square) * w.hyper_coefficient,
            (u.hyper_coefficient - law.coefficient(u.hess_square, z)) * w.hess_square,
        ]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        parts = [*self.lifting_on_facets(w, u), *(-part for part in self.lifting_on_facets(u, w))]
        parts.append(self.stiffness(u) * inner(u.jump, w.jump))
        _, coupling = self.penalty(u)
        return parts if coupling is None else [*parts, -coupling * w.hess_square]

    def coefficient_load(self, u: Fields, t: CoefficientFunction) -> Integrand:
        """Load of the projection c_s, int c(s) t + sum_K int_{dK} sigma/h c'(s~)|j|^2 t."""
        _, coupling = self.penalty(u)
        assert coupling is not None
        return Integrand(self.law.coefficient(u.hess_square, u.z_tensors) * t, coupling * t)

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation c(|Hs|^2)|Hs|^2, the paper's mu |hess v|^p."""
        if self.law.is_linear:
            return {_COLUMN: self.law.linear(u.z_tensors) * square(u.parts["hess"])}
        return {_COLUMN: self.law.coefficient(u.hess_square, u.z_tensors) * u.hess_square}

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation by the penalty."""
        penalty, coupling = self.penalty(u)
        share = penalty * square(u.jump)
        if coupling is None:
            return {_COLUMN: share}
        h = u.context.h
        return {_COLUMN: share + coupling * (u.hess_square + square(u.jump) / (h * h))}


_COLUMN = "dissipation_hyper"

"""Terms by which walls enter the system: a multiplier for v.n = 0, traction and friction."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ngsolve import CF, CoefficientFunction

from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.term import Entry, Integrand, PointTerm, Setting, Term, Unknown
from ngvisco.physics.loads import as_vector
from ngvisco.physics.walls import NavierFriction, Traction


class Impenetrability(PointTerm):
    """Multiplier form of v.n = 0 on oblique and curved walls: int_Gamma lambda (w.n) + mu (v.n) = 0.

    lambda is the normal stress of the wall, Pa.  Its power int lambda (v.n) vanishes exactly, by the
    equation's own row mu = lambda, so that it has no entry in the ledger.  Nothing is carried through the
    wall whatever the pointwise residue of v.n (``Upwinding``).
    """

    def __init__(self, walls: Walls) -> None:
        self.indicator = facet_indicator(walls.mesh, walls.multiplied)
        self._walls = walls

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        space = partial(self._walls.multiplier_space, k=setting.k)
        return (Unknown("wall_stress", "walls", space=space),)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        n = u.context.normal
        return [
            self.indicator * u.wall_stress * (w.v * n),
            self.indicator * w.wall_stress * (u.v * n),
        ]


class TangentialStress(PointTerm):
    """-int_Gamma f_t . w_t + int_Gamma c v_t . w_t (paper: rem-f-ne-0) on one wall."""

    def __init__(self, walls: Walls, name: str) -> None:
        self.name = name
        self.indicator, self.region = facet_indicator(walls.mesh, [name]), walls.region([name])
        wall = walls.conditions[name]
        self.f: CoefficientFunction | None = None
        self.friction: CoefficientFunction | None = None
        if isinstance(wall, Traction):
            self.f = as_vector(wall.f, walls.mesh.dim, "Traction.f")
            if wall.friction:
                self.friction = CF(wall.friction)
        elif isinstance(wall, NavierFriction):
            self.friction = CF(wall.coefficient)

    def _traction(self, u: Fields) -> CoefficientFunction:
        return _tangential(u.context.average(self.f, self.region), u.context.normal)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        parts = []
        if self.f is not None:
            parts.append(-self.indicator * (self._traction(u) * w.v))
        if self.friction is not None:
            parts.append(self.indicator * self.friction * (_tangential(u.v, u.context.normal) * w.v))
        return parts

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self.facets(u, w)

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        if self.friction is None:
            return {}
        c, v_t = u.context, _tangential(u.v, u.context.normal)
        friction = c.given(self.indicator) * c.given(self.friction)
        return {f"dissipation_friction_{self.name}": friction * (v_t * v_t)}

    def entries(self, u: Fields) -> list[Entry]:
        if self.f is None:
            return super().entries(u)
        power = Integrand(facets=self.indicator * (self._traction(u) * u.v))
        return [Entry(f"power_traction_{self.name}", "power", power), *super().entries(u)]


def _tangential(a: CoefficientFunction, n: CoefficientFunction) -> CoefficientFunction:
    return a - (a * n) * n


def wall_terms(walls: Walls) -> tuple[Term, ...]:
    """Terms by which walls enter the system; none where the space holds the condition."""
    terms: list[Term] = [Impenetrability(walls)] if walls.multiplied else []
    terms += [
        TangentialStress(walls, name)
        for name, wall in walls.conditions.items()
        if isinstance(wall, (Traction, NavierFriction))
    ]
    return tuple(terms)

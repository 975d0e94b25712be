"""Terms by which walls enter the system: a multiplier for v.n = 0, traction and friction."""

from __future__ import annotations

from ngsolve import CF, CoefficientFunction

from ngvisco.forms.boundaries import facet_indicator
from ngvisco.forms.context import Context, Entry, Integrand, Term
from ngvisco.forms.spaces import Fields
from ngvisco.forms.walls import Walls
from ngvisco.physics.model import as_vector
from ngvisco.physics.walls import NavierFriction, Traction


class Impenetrability:
    """Multiplier form of v.n = 0 on oblique and curved walls: int_Gamma lambda (w.n) + mu (v.n) = 0.

    lambda is the normal stress of the wall, Pa.  Its power int lambda (v.n) vanishes exactly, by the
    equation's own row mu = lambda, so that it has no entry in the ledger.  Nothing is carried through the
    wall whatever the pointwise residue of v.n (Context.normal_velocity).
    """

    def __init__(self, context: Context, walls: Walls) -> None:
        self.context = context
        self.indicator = facet_indicator(walls.mesh, walls.multiplied)

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        n = self.context.normal
        return [
            Integrand(facets=self.indicator * u.wall_stress * (w.v * n)),
            Integrand(facets=self.indicator * w.wall_stress * (u.v * n)),
        ]

    def entries(self, u: Fields) -> list[Entry]:
        return []


class TangentialStress:
    """-int_Gamma f_t . w_t + int_Gamma c v_t . w_t (paper: rem-f-ne-0) on one wall."""

    def __init__(self, context: Context, walls: Walls, name: str) -> None:
        self.context, self.name = context, name
        self.indicator = facet_indicator(walls.mesh, [name])
        wall = walls.conditions[name]
        self.f: CoefficientFunction | None = None
        self.friction: CoefficientFunction | None = None
        if isinstance(wall, Traction):
            f = as_vector(wall.f, walls.mesh.dim, "Traction.f")
            self.f = self._tangential(context.average(f))
            if wall.friction:
                self.friction = CF(wall.friction)
        elif isinstance(wall, NavierFriction):
            self.friction = CF(wall.coefficient)

    def _tangential(self, a: CoefficientFunction) -> CoefficientFunction:
        n = self.context.normal
        return a - (a * n) * n

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        parts = []
        if self.f is not None:
            parts.append(Integrand(facets=-self.indicator * (self.f * w.v)))
        if self.friction is not None:
            parts.append(Integrand(facets=self.indicator * self.friction * (self._tangential(u.v) * w.v)))
        return parts

    def entries(self, u: Fields) -> list[Entry]:
        entries = []
        if self.f is not None:
            power = Integrand(facets=self.indicator * (self.f * u.v))
            entries.append(Entry(f"power_traction_{self.name}", "power", power))
        if self.friction is not None:
            v_t = self._tangential(u.v)
            loss = Integrand(facets=self.indicator * self.friction * (v_t * v_t))
            entries.append(Entry(f"dissipation_friction_{self.name}", "dissipation", loss))
        return entries


def wall_terms(walls: Walls, context: Context) -> tuple[Term, ...]:
    """Terms by which walls enter the system; none where the space holds the condition."""
    terms: list[Term] = [Impenetrability(context, walls)] if walls.multiplied else []
    terms += [
        TangentialStress(context, walls, name)
        for name, wall in walls.conditions.items()
        if isinstance(wall, (Traction, NavierFriction))
    ]
    return tuple(terms)

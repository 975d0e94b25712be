"""Springs between a wall that matter crosses and a rigid ground: a foundation that gives.

On the wall a displacement follows the velocity, dw/dt = v, and the wall is pulled back by

    t = -K w,    K = k_p n x n + k_s (I - n x n),

K in Pa/m.  w lives in the traces of v, so that its equation holds at every point: with w - w_old = tau v

    tau int K w . v = E(w) - E(w_old) + E(w - w_old),    E(w) = 1/2 int K w . w,

what is stored, and what the implicit step dissipates of it.  The mesh does not move: the wall is where the
body is at rest, and w is small beside a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from ngsolve import BND, CF, H1, CoefficientFunction, Compress, FESpace, Integrate, Mesh, VectorValued

from ngvisco.forms.boundary.boundaries import facet_indicator, walls_of
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.term import Entry, Integrand, PointTerm, Setting, Unknown
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.walls import Open


class Springs(PointTerm):
    """int K w . u + int (w - w_old)/tau . q - int v . q on one wall that is ``Open``.

    u tests v, and q tests w.
    """

    def __init__(self, walls: Walls, name: str) -> None:
        wall = walls.conditions[name]
        assert isinstance(wall, Open)
        self.name, self.displacement = name, f"displacement_{name}"
        self.stiffness = wall.stiffness
        self.indicator, self._mesh = facet_indicator(walls.mesh, [name]), walls.mesh
        area = Integrate(CF(1.0), walls.mesh, BND, definedon=walls.region([name]))
        self._size = float(area) ** (1 / (walls.mesh.dim - 1))

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        space = partial(_traces, name=self.name, order=setting.k)
        return (
            Unknown(
                *(self.displacement, "walls", setting.k, setting.dim),
                space=space,
                evolves=True,
                scale=self._size,
                on=self.indicator,
            ),
        )

    def _force(self, w: CoefficientFunction, n: CoefficientFunction) -> CoefficientFunction:
        """K w, Pa."""
        k_p, k_s = self.stiffness
        return k_s * w + ((k_p - k_s) * (w * n)) * n

    def _work(self, a: Fields, b: Fields) -> CoefficientFunction:
        """K w_a . w_b, N/m."""
        force = self._force(a.parts[self.displacement], a.context.normal)
        return self.indicator * (force * b.parts[self.displacement])

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """K w . u, the rows of v."""
        return [self.indicator * (self._force(u.parts[self.displacement], u.context.normal) * w.v)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        q, old = w.parts[self.displacement], u.context.old.parts[self.displacement]
        change = u.context.rate(u.parts[self.displacement] - old)
        return [*self.on_body(u, w), self.indicator * (change * q), -self.indicator * (u.v * q)]

    def entries(self, u: Fields) -> list[Entry]:
        return [Entry(f"stored_springs_{self.name}", "monitor", self.energy(u).integrand)]

    def energy(self, u: Fields) -> Entry:
        return Entry("stored", "energy", Integrand(facets=0.5 * self._work(u, u)))

    def slope(self, b: Fields, d: Fields) -> Integrand:
        return Integrand(facets=self._work(b, d))

    def distance(self, a: Fields, b: Fields) -> Entry:
        change = a.parts[self.displacement] - b.parts[self.displacement]
        half = 0.5 * self.indicator * (self._force(change, a.context.normal) * change)
        return Entry("bregman", "numerical", Integrand(facets=half))


def spring_terms(walls: Walls) -> tuple[Springs, ...]:
    """Those of the walls with a stiffness."""
    return tuple(
        Springs(walls, name)
        for name, wall in walls.conditions.items()
        if isinstance(wall, Open) and any(wall.stiffness)
    )


def _traces(mesh: Mesh, name: str, order: int) -> FESpace:
    """Those of continuous vectors on a wall, of whichever rank its facets are; collective."""
    space = H1(mesh, order=order)
    here = mask_of(space.GetDofs(walls_of(mesh, [name]))).astype(float)
    active = space.GetDofs(walls_of(mesh, [name]))
    for number in np.flatnonzero(Exchange.of(space, Communicator.of(mesh)).sum(here)):
        active[int(number)] = True
    return VectorValued(Compress(space, active), mesh.dim)

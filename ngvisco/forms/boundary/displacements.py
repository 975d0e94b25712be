"""Displacements of walls that matter crosses, and springs that pull these walls back.

The displacement w follows the velocity, dw/dt = v, so that w . n is the integral of v . n over time.  The
mesh does not move: the wall stays at its place in the body at rest, and w has to be small beside a cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from ngsolve import BND, CF, H1, CoefficientFunction, Compress, FESpace, Integrate, Mesh, VectorValued

from ngvisco.forms.boundary.boundaries import walls_of
from ngvisco.forms.boundary.on_wall import OnWall, along_and_across
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.term import Entry, Integrand
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.walls import Open, Passage

if TYPE_CHECKING:
    from ngvisco.forms.boundary.walls import Walls


class Displacement(OnWall):
    """Equation of the displacement w of one wall, int (w - w_old)/tau . q - int v . q = 0, with the test q.

    w is in the space of the traces of v, so that the equation holds at every point.
    """

    acts_by = "nothing"

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        self.displacement = f"displacement_{name}"
        area = Integrate(CF(1.0), walls.mesh, BND, definedon=self.region)
        self._size = float(area) ** (1 / (walls.mesh.dim - 1))

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        traces = partial(_traces, name=self.name, order=setting.k)
        name, k, dim = self.displacement, setting.k, setting.dim
        return (
            Unknown(name, "walls", k, dim, space=traces, evolves=True, scale=self._size, on=self.indicator),
        )

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        q, old = w.parts[self.displacement], u.context.old.parts[self.displacement]
        change = u.context.rate(u.parts[self.displacement] - old)
        return [*self.on_body(u, w), self.indicator * (change * q), -self.indicator * (u.v * q)]


class Springs(Displacement):
    """Displacement of an ``Open`` wall with springs, int K w . u, with the test u of v.

    Springs to a rigid ground, an elastic foundation, pull the wall back by t = -K w,
    K = k_p n x n + k_s (I - n x n) in Pa/m.  With w - w_old = tau v the work of the wall on the
    springs,

        tau int K w . v = E(w) - E(w_old) + E(w - w_old),    E(w) = 1/2 int K w . w,

    is the sum of the change of the stored energy and the dissipation of the implicit step.
    """

    acts_by = "springs"

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        wall = walls.conditions[name]
        assert isinstance(wall, Open)
        self.stiffness = wall.stiffness

    def _work(self, w: CoefficientFunction, q: CoefficientFunction, u: Fields) -> CoefficientFunction:
        """Work K w . q of the springs on the wall."""
        return self.indicator * (along_and_across(self.stiffness, w, u.context.normal) * q)

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self._work(u.parts[self.displacement], w.v, u)]

    def entries(self, u: Fields) -> list[Entry]:
        return [Entry(f"stored_springs_{self.name}", "monitor", self.energy(u).integrand)]

    def energy(self, u: Fields) -> Entry:
        w = u.parts[self.displacement]
        return Entry("stored", "energy", Integrand(facets=0.5 * self._work(w, w, u)))

    def slope(self, b: Fields, d: Fields) -> Integrand:
        return Integrand(facets=self._work(b.parts[self.displacement], d.parts[self.displacement], b))

    def distance(self, a: Fields, b: Fields) -> Entry:
        change = a.parts[self.displacement] - b.parts[self.displacement]
        return Entry("bregman", "numerical", Integrand(facets=0.5 * self._work(change, change, a)))


def displacement_of(walls: Walls, name: str) -> Displacement | None:
    """Displacement term of a wall that matter crosses; None if the wall has neither springs nor
    ``displacement``."""
    wall = walls.conditions[name]
    assert isinstance(wall, Passage)
    if isinstance(wall, Open) and any(wall.stiffness):
        return Springs(walls, name)
    return Displacement(walls, name) if wall.displacement else None


def _traces(mesh: Mesh, name: str, order: int) -> FESpace:
    """Space of the traces of continuous vectors on a wall; the wall's facets may be on other ranks;
    collective."""
    space = H1(mesh, order=order)
    active = space.GetDofs(walls_of(mesh, [name]))
    on_some_rank = Exchange.of(space, Communicator.of(mesh)).sum(mask_of(active).astype(float))
    for number in np.flatnonzero(on_some_rank):
        active[int(number)] = True
    return VectorValued(Compress(space, active), mesh.dim)

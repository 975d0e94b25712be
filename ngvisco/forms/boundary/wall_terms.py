"""Terms by which walls enter the system: multipliers for v.n = 0, given stresses, springs, and what crosses.

For smooth fields B_h(w; z, zeta) = int T : grad w - int phi (w . n) (``ngvisco.forms.terms.transport``): on a
wall that matter crosses the natural condition of the momentum equation would be T n = phi n.  There stands
besides

    + int_Gamma (phi(z) + zeta : (z_hat - z)) (w . n) + 1/2 int_Gamma rho_hat (v . n) v . w - int_Gamma t . w,

the second of these from the skew form of convection.  rho_hat and z_hat are the upwind traces, on the other
side of which is what flows in (``ngvisco.forms.upwinding``).  The first one leaves nothing of the wall's
facets in the elastic force: T n is t whatever flows in.  Where it is given, and not what is inside, z_hat
and z meet in the cell and dissipate, for convex energies,

    d = (phi(z) + zeta : (z_hat - z) - phi(z_hat)) (v . n) >= 0        where v . n < 0.

At w = v, B_h used twice cancels with these facets too:

    E - E_old + tau (D + int d - P) + R = -tau int (phi(z_hat) + 1/2 rho_hat |v|^2) (v . n) + tau int t . v,
    int rho - int rho_old = -tau int rho_hat (v . n),

exactly, whatever flows in; of a material with heat the entropy changes by -tau int s_hat (v . n) besides.
What enters brings energy: at an inlet no sign is promised.  Of bodies each density n_i is carried so.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence
from functools import partial

import numpy as np
from ngsolve import BND, CF, H1, CoefficientFunction, Compress, FESpace, Integrate, Mesh, VectorValued

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.boundaries import facet_indicator, walls_of
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.mesh_arrays import mask_of
from ngvisco.forms.start.variables import Entering, as_shape, entering, entropy_at
from ngvisco.forms.term import Entry, Integrand, PointTerm, Setting, Term, Unknown
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.physics.loads import as_vector
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import if_positive, inner
from ngvisco.physics.walls import NavierFriction, Open, Passage, Traction


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


class OnWall(PointTerm):
    """A term by which one wall acts on the body, beside what it constrains."""

    def __init__(self, walls: Walls, name: str) -> None:
        self.name, self.region = name, walls.region([name])
        self.indicator = facet_indicator(walls.mesh, [name])

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Its rows of v, -t . w with the stress t, Pa, on the facets of the wall."""
        return self.facets(u, w)


class TangentialStress(OnWall):
    """-int_Gamma f_t . w_t + int_Gamma c v_t . w_t (paper: rem-f-ne-0) on one wall."""

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
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


class Carried(OnWall):
    """+ int (phi(z) + zeta : (z_hat - z)) (w . n) + 1/2 int rho_hat (v . n) v . w on one wall.

    See the module's docstring.

    With ``backflow`` (``Open``) the second one has what flows out only,

        1/2 int rho_hat (v . n)^+ v . w,

    so that 1/2 int rho_hat (v . n)^- |v|^2 >= 0 is a dissipation, of v itself: v* may miss the side.
    """

    def __init__(self, walls: Walls, name: str, model: Model) -> None:
        super().__init__(walls, name)
        wall = walls.conditions[name]
        assert isinstance(wall, Passage)
        self.entropy = entropy_in(model.material)
        self.backflow = isinstance(wall, Open) and wall.backflow
        self.material = model.material
        self.given = entering(wall, f"walls[{name!r}]", model)
        """What is given of what flows in, of the place and the time, see ``entering``."""

    def continues(self, name: str) -> bool:
        """Whether nothing of ``"rho"`` or ``"z"`` is given."""
        return self.given.density is None if name == "rho" else self.given.is_of_density_alone

    def entering(
        self, u: Fields, name: str, own: CoefficientFunction, given: Entering
    ) -> CoefficientFunction:
        """What flows in of ``"rho"`` or ``"z"``, on a cell's side: ``own`` where nothing is given.

        ``given`` are the means of ``self.given`` over the step.
        """
        if self.continues(name):
            return own
        given = given.mapped(u.context.given)
        if name == "rho":
            return given.density
        inside = u.layout.states.tensors(lambda: own)
        values = {variable: given.values.get(variable, inside[variable]) for variable in inside}
        if given.temperature is not None:
            values |= entropy_at(self.material, given.temperature, values)
        return u.layout.states.components(values)

    def _through(self, u: Fields) -> CoefficientFunction:
        """v . n on this wall, else 0."""
        c = u.context
        return c.given(self.indicator) * (u.v * c.normal)

    def _outward(self, u: Fields) -> CoefficientFunction:
        """(v . n)^+."""
        through = self._through(u)
        return if_positive(through, through, 0.0 * through)

    def _stored(self, u: Fields) -> CoefficientFunction:
        """phi(z_hat), Pa."""
        at_trace = Fields(u.layout, ChainMap({"z": u.z_hat}, u.parts), u.context)  # type: ignore[arg-type]
        return u.context.rates.stored(at_trace)

    def _tangent(self, u: Fields) -> CoefficientFunction:
        """phi(z) + zeta : (z_hat - z), Pa."""
        return u.context.rates.stored(u) + inner(u.z_hat - u.z, u.zeta)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        kinetic = 0.5 * u.rho_hat * (self._outward(u) if self.backflow else self._through(u))
        return [(c.given(self.indicator) * self._tangent(u)) * (w.v * c.normal), kinetic * (w.v * u.v)]

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """What ``backflow`` adds, 1/2 rho_hat (v . n)^- v . w."""
        flux = u.rho_hat * (self._outward(u) - self._through(u))
        return [0.5 * flux * (u.v * w.v)] if self.backflow else []

    def _mixing(self, u: Fields) -> list[Entry]:
        """What z_hat and z dissipate."""
        lost = (self._tangent(u) - self._stored(u)) * self._through(u)
        return [_beyond(f"dissipation_inflow_{self.name}", lost)]

    def entries(self, u: Fields) -> list[Entry]:
        name, through = self.name, self._through(u)
        flux = u.rho_hat * through
        found = [
            Entry(f"power_kinetic_{name}", "power", Integrand(facets=-0.5 * flux * (u.v * u.v))),
            Entry(f"power_stored_{name}", "power", Integrand(facets=-self._stored(u) * through)),
            *(_beyond(f"dissipation_backflow_{name}", part) for part in self.on_body(u, u)),
            *self._mixing(u),
            Entry(f"inflow_{name}", "flux", Integrand(facets=-flux)),
        ]
        if self.entropy is not None:
            s = self.entropy.unit * u.layout.states.tensors(lambda: u.z_hat)[self.entropy.name]
            carried = Integrand(facets=-s * through)
            found.append(Entry(f"entropy_supply_{name}_carried", "production", carried))
        return found


class GivenStress(OnWall):
    """-int t . w, t = f - p n - Z_p (v . n) n - Z_s v_t, on one wall that is ``Open``."""

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        wall, owner = walls.conditions[name], f"walls[{name!r}]"
        assert isinstance(wall, Open)
        self.pressure = as_shape(f"{owner}.pressure", wall.pressure, ())
        self.f: CoefficientFunction | None = None
        if wall.traction is not None:
            self.f = as_vector(wall.traction, walls.mesh.dim, f"{owner}.traction")
        self.impedance = wall.impedance

    def _traction(self, u: Fields) -> CoefficientFunction:
        """f - p n, averaged over the step, Pa."""
        c = u.context
        load = -c.average(self.pressure, self.region) * c.normal
        return load if self.f is None else load + c.average(self.f, self.region)

    def _resistance(self, u: Fields) -> CoefficientFunction:
        """Z_p (v . n) n + Z_s v_t, Pa."""
        return _along_and_across(self.impedance, u.v, u.context.normal)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        parts = [-self.indicator * (self._traction(u) * w.v)]
        if any(self.impedance):
            parts.append(self.indicator * (self._resistance(u) * w.v))
        return parts

    def entries(self, u: Fields) -> list[Entry]:
        power = Integrand(facets=self.indicator * (self._traction(u) * u.v))
        found = [Entry(f"power_traction_{self.name}", "power", power)]
        if any(self.impedance):
            resisted = self.indicator * (self._resistance(u) * u.v)
            found.append(_beyond(f"dissipation_impedance_{self.name}", resisted))
        return found


def _along_and_across(
    factors: tuple[float, float], a: CoefficientFunction, n: CoefficientFunction
) -> CoefficientFunction:
    """p (a . n) n + s a_t of the factors (p, s)."""
    p, s = factors
    return s * a + ((p - s) * (a * n)) * n


def _beyond(name: str, dissipated: CoefficientFunction) -> Entry:
    return Entry(name, "dissipation", Integrand(facets=dissipated), is_outside=True)


class Springs(OnWall):
    """int K w . u + int (w - w_old)/tau . q - int v . q on one wall that is ``Open``; u tests v, q tests w.

    Springs to a rigid ground, a foundation that gives: the displacement w follows the velocity, dw/dt = v,
    and the wall is pulled back by t = -K w, K = k_p n x n + k_s (I - n x n) in Pa/m.  w lives in the traces
    of v, so that its equation holds at every point: with w - w_old = tau v

        tau int K w . v = E(w) - E(w_old) + E(w - w_old),    E(w) = 1/2 int K w . w,

    what is stored, and what the implicit step dissipates of it.  The mesh does not move: the wall is where
    the body is at rest, and w is small beside a cell.
    """

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        wall = walls.conditions[name]
        assert isinstance(wall, Open)
        self.displacement, self.stiffness = f"displacement_{name}", wall.stiffness
        area = Integrate(CF(1.0), walls.mesh, BND, definedon=self.region)
        self._size = float(area) ** (1 / (walls.mesh.dim - 1))

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (
            Unknown(
                self.displacement,
                "walls",
                setting.k,
                setting.dim,
                space=partial(_traces, name=self.name, order=setting.k),
                evolves=True,
                scale=self._size,
                on=self.indicator,
            ),
        )

    def _work(self, w: CoefficientFunction, q: CoefficientFunction, u: Fields) -> CoefficientFunction:
        """K w . q on the wall."""
        return self.indicator * (_along_and_across(self.stiffness, w, u.context.normal) * q)

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [self._work(u.parts[self.displacement], w.v, u)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        q, old = w.parts[self.displacement], u.context.old.parts[self.displacement]
        change = u.context.rate(u.parts[self.displacement] - old)
        return [*self.on_body(u, w), self.indicator * (change * q), -self.indicator * (u.v * q)]

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


def _traces(mesh: Mesh, name: str, order: int) -> FESpace:
    """Those of continuous vectors on a wall, of whichever rank its facets are; collective."""
    space = H1(mesh, order=order)
    active = space.GetDofs(walls_of(mesh, [name]))
    on_some_rank = Exchange.of(space, Communicator.of(mesh)).sum(mask_of(active).astype(float))
    for number in np.flatnonzero(on_some_rank):
        active[int(number)] = True
    return VectorValued(Compress(space, active), mesh.dim)


def wall_terms(walls: Walls, model: Model) -> tuple[Term, ...]:
    """Terms by which walls enter the system; none where the space holds the condition.

    Raises ParameterError for a model of which it is not known what crosses a wall, and for a missing density
    of what flows in.
    """
    if walls.crossed and (reason := _not_known(model, walls.mesh.dim)) is not None:
        name = walls.crossed[0]
        expected = f"a wall that nothing crosses: {reason}"
        raise ParameterError(f"walls[{name!r}]", walls.conditions[name], expected)
    of = walls.conditions.items()
    return (
        *([Impenetrability(walls)] if walls.multiplied else []),
        *(TangentialStress(walls, name) for name, at in of if isinstance(at, (Traction, NavierFriction))),
        *(Carried(walls, name, model) for name in walls.crossed),
        *(GivenStress(walls, name) for name, at in of if isinstance(at, Open)),
        *(Springs(walls, name) for name, at in of if isinstance(at, Open) and any(at.stiffness)),
    )


def _not_known(model: Model, dim: int) -> str | None:
    """Why nothing can cross a wall with this model, or None."""
    law = model.regularisation
    if model.material.response(dim) is not None:
        return "its energy has no expression, and is not known of what is carried through"
    if law is not None and law.rho_max is not None:
        return "a cut-off density has fluxes of its own (Regularisation.rho_max)"
    if law is not None and (law.delta_density or law.delta_fields):
        return "what diffuses through it is not known (Regularisation.delta_fields, delta_density)"
    return None

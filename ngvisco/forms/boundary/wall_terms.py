"""Terms by which walls enter the system: multipliers for v.n = 0, given stresses, and passages of matter.

For smooth fields B_h(w; z, zeta) = int T : grad w - int phi (w . n) (``ngvisco.forms.terms.transport``).
Without further terms, the natural condition of the momentum equation on a wall that matter crosses would
therefore be T n = phi n.  The terms on such a wall add

    + int_Gamma phi (w . n) + 1/2 int_Gamma j v . w - int_Gamma t . w,

with phi = phi(z). The second term comes from the skew form of convection.  The trace on a wall is the value
inside the body, so that T n = t for any inflow.  Inflowing matter has the values z_in and rho_in. These are
given, or are the values in the middle of the cell. They enter by the transport alone: with a^- = max(-a, 0)

    - int (v . n)^- (z_in - z) : G        in the kinematic equations,
    j = (v . n) rho - (v . n)^- (rho_in - rho)        the flux of mass.

If z_in differs from z, mixing in the cell dissipates, for convex energies,

    d = (v . n)^- (phi(z_in) - phi(z) - zeta : (z_in - z)) >= 0.

At w = v the two uses of B_h cancel on these facets too:

    E - E_old + tau (D + int d - P) + R = -tau int (phi(z) (v . n)^+ - phi(z_in) (v . n)^- + 1/2 j |v|^2)
                                          + tau int t . v,
    int rho - int rho_old = -tau int j,

exactly, for any inflow; with heat, the flux of entropy changes the entropy too.  Inflowing matter brings
energy, so that the energy balance of an inlet has no sign.  With bodies each density n_i is carried in this
way.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import ParameterError
from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.boundary.displacements import displacement_of
from ngvisco.forms.boundary.on_wall import OnWall, along_and_across
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.given_values import as_shape, entering, entropy_at
from ngvisco.forms.term import ENTERING, SKEW, CellMean, Entry, Integrand, PointTerm
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.physics.loads import as_vector
from ngvisco.physics.material import cauchy_stress, conjugates
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.model import Model
from ngvisco.physics.tensors import dev, if_positive, inner
from ngvisco.physics.walls import NavierFriction, Open, Passage, PrescribedNormal, Traction
from ngvisco.words import Mention, Words

HELD_BY_WALLS = "walls"
"""Name, in the ledger, of the impulse of all walls that hold v or the normal part of v."""


class Impenetrability(PointTerm):
    """Multiplier form of v.n = 0 on oblique and curved walls: int_Gamma lambda (w.n) + mu (v.n) = 0.

    lambda is the normal stress of the wall, Pa.  Its power int lambda (v.n) vanishes exactly by the row
    mu = lambda, so that the ledger has no entry for it.  Nothing is carried through the wall
    (``Upwinding``), although v.n is not zero at every point of it.
    """

    couples = "flow"

    def __init__(self, walls: Walls) -> None:
        self.indicator = facet_indicator(walls.mesh, walls.multiplied)
        self._walls = walls
        self.pistons = [Piston(walls, name) for name in walls.pistons if name in walls.multiplied]
        """Terms of the pistons among these walls, on which v.n is given."""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        if setting.k < 2:
            names = ", ".join(map(repr, self._walls.multiplied))
            expected = f"2 or 3, since a multiplier imposes v.n = 0 on the oblique or curved walls {names}"
            raise ParameterError("Discretisation.k", setting.k, expected)
        return (Unknown("wall_stress", "walls", space=partial(self._walls.multiplier_space, k=setting.k)),)

    @property
    def impulse(self) -> str:
        """Name of the impulse of all walls that hold the body."""
        return HELD_BY_WALLS

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        n = u.context.normal
        return [self.indicator * u.wall_stress * (w.v * n), self.indicator * w.wall_stress * (u.v * n)]


class Piston(OnWall):
    """Right-hand side -int_Gamma mu V of ``Impenetrability`` on one oblique or curved wall with v.n = V.

    The power of the wall is -int lambda (v.n).
    """

    acts_by = "nothing"

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        wall = walls.conditions[name]
        assert isinstance(wall, PrescribedNormal)
        self.velocity = as_shape(f"walls[{name!r}].velocity", wall.velocity, ())

    def prescribed(self, mu: CoefficientFunction) -> CoefficientFunction:
        """Integrand mu V at the present time."""
        return self.indicator * self.velocity * mu

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return [-self.indicator * u.context.average(self.velocity, self.region) * w.wall_stress]

    def entries(self, u: Fields) -> list[Entry]:
        power = -self.indicator * u.wall_stress * (u.v * u.context.normal)
        return [Entry(f"power_wall_{self.name}", "power", Integrand(facets=power))]


class TangentialStress(OnWall):
    """Traction and friction -int_Gamma f_t . w_t + int_Gamma c v_t . w_t on one wall (paper: rem-f-ne-0)."""

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
        self.acts_by = "friction" if self.f is None else "traction"

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
    """Passage of matter through one wall, int phi (w . n) + 1/2 int j v . w and the inflow, see the module.

    With ``backflow`` (``Open``) the second integral has the outflow only: 1/2 int rho (v . n)^+ v . w. Then
    1/2 int rho_in (v . n)^- |v|^2 >= 0 is a dissipation.
    """

    couples = "local"
    acts_by = "carried"

    def __init__(self, walls: Walls, name: str, model: Model) -> None:
        super().__init__(walls, name)
        wall = walls.conditions[name]
        assert isinstance(wall, Passage)
        self.entropy = entropy_in(model.material)
        self.backflow = isinstance(wall, Open) and wall.backflow
        self.material = model.material
        self.given = entering(wall, f"walls[{name!r}]", model, walls.mesh)
        """Given state of the inflow, functions of place and time (``entering``)."""
        self.means = self.given
        """Means of ``given`` over the step."""

    def continues(self, name: str) -> bool:
        """Whether the wall prescribes no value of ``name``, which is ``"rho"`` or ``"z"``."""
        return self.given.density is None if name == "rho" else self.given.is_of_density_alone

    def entering(self, u: Fields, name: str) -> CoefficientFunction:
        """Value of ``"rho"`` or ``"z"`` that flows in through a cell's side.

        A quantity that is not given enters with the cell's value but without the cell's slope; with the slope
        the value would grow from step to step.
        """
        inner_value = self._middle(u, name)
        if self.continues(name):
            return inner_value
        given = self.means.mapped(u.context.given)
        if name == "rho":
            return given.density
        inside = u.layout.states.tensors(lambda: inner_value)
        here = u.context.given(self.indicator)  # other walls are left out: means are zero, energies maybe NaN
        values = {name: inside[name] for name in inside}
        values |= {name: inside[name] + here * (value - inside[name]) for name, value in given.values.items()}
        if given.temperature is not None:
            values |= entropy_at(self.material, 1.0 + here * (given.temperature - 1.0), values)
        return u.layout.states.components(values)

    def _middle(self, u: Fields, name: str) -> CoefficientFunction:
        """Value at the middle of the cell."""
        value, reach = u.parts[name], u.context.reach
        return value if reach is None else value - u.gradient(name) * u.context.given(reach)

    def _normal_velocity(self, u: Fields) -> CoefficientFunction:
        """Normal velocity v . n on this wall, else 0."""
        c = u.context
        return c.given(self.indicator) * (u.v * c.normal)

    def _inward(self, u: Fields) -> CoefficientFunction:
        """Inflow speed (v . n)^- on this wall, else 0."""
        v_n = self._normal_velocity(u)
        return if_positive(v_n, 0.0 * v_n, -v_n)

    def deviators(self, u: Fields) -> tuple[CoefficientFunction, CoefficientFunction, CoefficientFunction]:
        """Inflow speed, m/s, and deviators of the elastic stress, Pa, inside and in the inflow; 0 elsewhere.

        Bodies whose energy has no expression enter unstrained, without a deviator.
        """
        material, on_wall, zero = self.material, u.context.given(self.indicator), CF((0.0,) * 9, dims=(3, 3))
        inside, outside = cauchy_stress(material, u.z_tensors, u.zeta_tensors, CF(0.0)), zero
        if StoredMean.name not in u.layout.unknowns:
            z = u.layout.states.tensors(lambda: self.entering(u, "z"))
            outside = cauchy_stress(material, z, conjugates(material, z), CF(0.0))
        return self._inward(u), *(if_positive(on_wall, dev(T), zero) for T in (inside, outside))

    def _added(self, u: Fields, name: str) -> CoefficientFunction:
        """Inflow speed times the difference of inflowing and inner value, of ``"rho"`` or ``"z"``."""
        return self._inward(u) * (self.entering(u, name) - u.parts[name])

    def entering_mass(self, u: Fields) -> CoefficientFunction:
        if "rho" in u.layout.unknowns:
            return self._added(u, "rho")
        return u.layout.states.density(self._added(u, "z"))[0]

    def _mass_flux(self, u: Fields) -> CoefficientFunction:
        """Mass flux j, kg/(m^2 s)."""
        return self._normal_velocity(u) * u.rho - self.entering_mass(u)

    def _carried_momentum(self, u: Fields) -> CoefficientFunction:
        """Mass flux j, or with ``backflow`` its outward part."""
        flux = self._mass_flux(u)
        return if_positive(self._normal_velocity(u), flux, 0.0 * flux) if self.backflow else flux

    def _stored(self, u: Fields) -> CoefficientFunction:
        """Energy phi(z), Pa, on this wall; 0 on other walls, where traces may have no energy
        (``StoredMean``)."""
        if StoredMean.name in u.layout.unknowns:
            return u.parts[StoredMean.name] + inner(u.zeta, u.z - self._middle(u, "z"))
        return if_positive(u.context.given(self.indicator), u.context.rates.stored(u), 0.0)

    def _stored_outside(self, u: Fields) -> CoefficientFunction:
        """Energy phi(z_in), Pa, or its tangent at z if phi has no values on walls."""
        if StoredMean.name in u.layout.unknowns:
            return self._stored(u) + inner(u.zeta, self.entering(u, "z") - u.z)
        outside = {"z": self.entering(u, "z")}
        return self._stored(Fields(u.layout, ChainMap(outside, u.parts), u.context))  # type: ignore[arg-type]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        stored = c.given(self.indicator) * self._stored(u) * (w.v * c.normal)
        return [stored, (0.5 * self._carried_momentum(u)) * (w.v * u.v), -inner(self._added(u, "z"), w.z)]

    def impulses(self, u: Fields, w: Fields) -> dict[str, list[Integrand]]:
        # the skew form of inertia has the other half of the outgoing momentum
        (stored, kinetic, _), half = self.facets(u, w), 0.5 * self._mass_flux(u) * (w.v * u.v)
        carried = [Integrand(facets=kinetic), Integrand(facets=half)]
        return {ENTERING: [Integrand(facets=stored)], SKEW: [Integrand(facets=-half)], self.impulse: carried}

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """The term that ``backflow`` adds, -1/2 j v . w where matter flows in."""
        return [0.5 * (self._carried_momentum(u) - self._mass_flux(u)) * (u.v * w.v)] if self.backflow else []

    def entries(self, u: Fields) -> list[Entry]:
        name, normal_velocity = self.name, self._normal_velocity(u)
        inward, flux = self._inward(u), self._mass_flux(u)
        stored = inward * self._stored_outside(u) - (normal_velocity + inward) * self._stored(u)
        mixing = inward * (self._stored_outside(u) - self._stored(u)) - inner(self._added(u, "z"), u.zeta)
        entries = [
            Entry(f"power_kinetic_{name}", "power", Integrand(facets=-0.5 * flux * (u.v * u.v))),
            Entry(f"power_stored_{name}", "power", Integrand(facets=stored)),
            *(_beyond(f"dissipation_backflow_{name}", part) for part in self.on_body(u, u)),
            replace(_beyond(f"dissipation_inflow_{name}", mixing), has_sign=False),
            Entry(f"inflow_{name}", "flux", Integrand(facets=-flux)),
        ]
        if self.entropy is not None:
            carried = normal_velocity * u.z - self._added(u, "z")
            s = self.entropy.unit * u.layout.states.tensors(lambda: carried)[self.entropy.name]
            entries.append(Entry(f"entropy_supply_{name}_carried", "production", Integrand(facets=-s)))
        return entries


class StoredMean(CellMean):
    """Equation of the cell mean of phi, Pa, for energies that have values only at the points of the cells'
    rule.

    Bodies of different volumetric energies and Yosida's approximation have such energies.  On a wall the mean
    plus zeta : (z - z_K) replaces phi, where z_K is the value at the middle of the cell.  The error of this
    value, and therefore of T n - t, is of second order in the cell's size.
    """

    name = "stored_mean"

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        return (Unknown(self.name, "cells", 0, is_mean=True),)

    def value(self, u: Fields) -> CoefficientFunction:
        return u.context.rates.stored_near(u)


class GivenStress(OnWall):
    """Stress -int t . w on one ``Open`` wall, t = f - p n - Z_p (v . n) n - Z_s v_t."""

    acts_by = "traction"

    def __init__(self, walls: Walls, name: str) -> None:
        super().__init__(walls, name)
        wall, owner = walls.conditions[name], f"walls[{name!r}]"
        assert isinstance(wall, Open)
        self._wall = wall
        self.pressure = as_shape(f"{owner}.pressure", wall.pressure, ())
        self.f: CoefficientFunction | None = None
        if wall.traction is not None:
            self.f = as_vector(wall.traction, walls.mesh.dim, f"{owner}.traction")
        self.impedance = wall.impedance

    def _traction(self, u: Fields) -> CoefficientFunction:
        """Given part f - p n of the stress, averaged over the step, Pa."""
        c = u.context
        load = -c.average(self.pressure, self.region) * c.normal
        return load if self.f is None else load + c.average(self.f, self.region)

    def at(self, u: Fields, n: CoefficientFunction) -> CoefficientFunction:
        """Stress t of the wall and its springs, Pa, at the present time and state, for points of the wall."""
        wall, t = self._wall, -self.pressure * n
        for factors, name in ((wall.impedance, "v"), (wall.stiffness, f"displacement_{self.name}")):
            if any(factors):
                t = t - along_and_across(factors, u.parts[name], n)
        return t if self.f is None else t + self.f

    def _resistance(self, u: Fields) -> CoefficientFunction:
        """Resistance Z_p (v . n) n + Z_s v_t of the wall, Pa."""
        return along_and_across(self.impedance, u.v, u.context.normal)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        parts = [-self.indicator * (self._traction(u) * w.v)]
        if any(self.impedance):
            parts.append(self.indicator * (self._resistance(u) * w.v))
        return parts

    def entries(self, u: Fields) -> list[Entry]:
        power = Integrand(facets=self.indicator * (self._traction(u) * u.v))
        entries = [Entry(f"power_traction_{self.name}", "power", power)]
        if any(self.impedance):
            resisted = self.indicator * (self._resistance(u) * u.v)
            entries.append(_beyond(f"dissipation_impedance_{self.name}", resisted))
        return entries


def _beyond(name: str, dissipated: CoefficientFunction) -> Entry:
    return Entry(name, "dissipation", Integrand(facets=dissipated), is_outside=True)


def passages_of(walls: Walls, model: Model) -> tuple[Carried, ...]:
    """Terms of the walls that matter crosses.

    Raises ParameterError for a model whose flux through such a wall is not known, and for a missing density
    of an inflow.
    """
    if walls.crossed and (reason := _not_known(model)) is not None:
        name = walls.crossed[0]
        expected = ("a wall that nothing crosses, since ", reason)
        raise ParameterError(f"walls[{name!r}]", walls.conditions[name], *expected)
    return tuple(Carried(walls, name, model) for name in walls.crossed)


def wall_terms(
    walls: Walls, model: Model, held: Impenetrability | None, passages: Sequence[Carried]
) -> tuple[PointTerm, ...]:
    """Terms by which walls enter the system; a condition that the space imposes needs no term."""
    named = walls.conditions.items()
    return (
        *(() if held is None else (held, *held.pistons)),
        *(TangentialStress(walls, name) for name, at in named if isinstance(at, (Traction, NavierFriction))),
        *([StoredMean()] if walls.crossed and model.material.response(walls.mesh.dim) is not None else []),
        *passages,
        *(GivenStress(walls, name) for name, at in named if isinstance(at, Open)),
        *(moved for name in walls.crossed if (moved := displacement_of(walls, name)) is not None),
    )


def _not_known(model: Model) -> Words | None:
    """The reason why matter cannot cross a wall with this model; None if it can."""
    law = model.regularisation
    if law is not None and law.rho_max is not None:
        return Words("the flux through other walls is unknown with ", Mention("Regularisation.rho_max"))
    if law is not None and (law.delta_density or law.delta_fields):
        law_name = Mention("Regularisation.delta_fields")
        return Words("the flux through other walls is unknown with ", law_name, " or delta_density")
    return None

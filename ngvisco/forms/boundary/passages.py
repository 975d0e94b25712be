"""Walls that matter crosses: what it carries, and the stress that is given there.

For smooth fields B_h(w; z, zeta) = int T : grad w - int phi (w . n) (``ngvisco.forms.terms.transport``): the
natural condition of the momentum equation would be T n = phi n.  On such a wall there stands besides

    + int_Gamma phi_hat (w . n) + 1/2 int_Gamma rho_hat (v . n) v . w - int_Gamma t . w,

with phi_hat = phi(z_hat), the second of these from the skew form of convection.  rho_hat and z_hat are the
upwind traces, on the other side of which is what flows in (``ngvisco.forms.upwinding``).  At w = v, B_h used
twice cancels with these facets too:

    E - E_old + tau (D - P) + R = -tau int (phi_hat + 1/2 rho_hat |v|^2) (v . n) + tau int t . v,
    int rho - int rho_old = -tau int rho_hat (v . n),

exactly, whatever flows in; of a material with heat the entropy changes by -tau int s_hat (v . n) besides.
What enters brings energy: at an inlet no sign is promised.  Of bodies each density n_i is carried so.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Sequence
from functools import reduce
from operator import add

from ngsolve import CF, CoefficientFunction, Id

from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.forms.boundary.boundaries import facet_indicator
from ngvisco.forms.boundary.walls import Walls
from ngvisco.forms.fields import Fields
from ngvisco.forms.start.variables import as_shape, entropy_at, given_temperature, starting_values
from ngvisco.forms.term import Entry, Integrand, PointTerm, Term
from ngvisco.physics.loads import as_vector
from ngvisco.physics.material import volume_ratio
from ngvisco.physics.materials.thermal import entropy_in
from ngvisco.physics.mixture import AMOUNT, Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import value_at
from ngvisco.physics.tensors import if_positive
from ngvisco.physics.walls import Open, Passage


class Carried(PointTerm):
    """+ int phi_hat (w . n) + 1/2 int rho_hat (v . n) v . w on one wall, see the module's docstring.

    With ``backflow`` (``Open``) the second one has what flows out only,

        1/2 int rho_hat (v . n)^+ v . w,

    so that 1/2 int rho_hat (v . n)^- |v|^2 >= 0 is a dissipation, of v itself: v* may miss the side.
    """

    def __init__(self, walls: Walls, name: str, model: Model) -> None:
        self.name, self.region = name, walls.region([name])
        self.indicator = facet_indicator(walls.mesh, [name])
        wall, owner = walls.conditions[name], f"walls[{name!r}]"
        assert isinstance(wall, Passage)
        self.entropy = entropy_in(model.material)
        self.backflow = isinstance(wall, Open) and wall.backflow
        z, rho = _entering(wall, owner, model)
        self.temperature: CoefficientFunction | None = None
        if self.entropy is not None and self.entropy.name not in wall.values:
            self.temperature = given_temperature(model.material, wall.temperature, owner)
            z[self.entropy.name] = entropy_at(model.material, self.temperature, z)
        elif wall.temperature is not None:
            expected = "none: the material has no temperature, or its entropy is among the values"
            raise ParameterError(f"{owner}.temperature", wall.temperature, expected)
        self.values = {"rho": rho, "z": model.material.states(walls.mesh.dim).components(z)}
        """Of what flows in, of the place and the time."""

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

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        c = u.context
        kinetic = 0.5 * u.rho_hat * (self._outward(u) if self.backflow else self._through(u))
        return [(c.given(self.indicator) * self._stored(u)) * (w.v * c.normal), kinetic * (w.v * u.v)]

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """What ``backflow`` adds, 1/2 rho_hat (v . n)^- v . w."""
        flux = u.rho_hat * (self._outward(u) - self._through(u))
        return [0.5 * flux * (u.v * w.v)] if self.backflow else []

    def entries(self, u: Fields) -> list[Entry]:
        through = self._through(u)
        flux = u.rho_hat * through
        found = [
            Entry(f"power_kinetic_{self.name}", "power", Integrand(facets=-0.5 * flux * (u.v * u.v))),
            Entry(f"power_stored_{self.name}", "power", Integrand(facets=-self._stored(u) * through)),
            *(_beyond(f"dissipation_backflow_{self.name}", part) for part in self.on_body(u, u)),
            Entry(f"inflow_{self.name}", "flux", Integrand(facets=-flux)),
        ]
        if self.entropy is not None:
            s = self.entropy.unit * u.layout.states.tensors(lambda: u.z_hat)[self.entropy.name]
            found.append(
                Entry(f"entropy_supply_{self.name}_carried", "production", Integrand(facets=-s * through))
            )
        return found


def _entering(
    wall: Passage, owner: str, model: Model
) -> tuple[dict[str, CoefficientFunction], CoefficientFunction]:
    """Variables, an entropy at rest, and density, kg/m^3, of what flows in."""
    if model.bodies:
        return _entering_bodies(wall, owner, model)
    if wall.amounts:
        raise ParameterError(f"{owner}.amounts", dict(wall.amounts), "none where there are no bodies")
    z = starting_values(model.material, wall.values, Id(3), owner=owner)
    return z, _density(wall, owner, model, z)


def _entering_bodies(
    wall: Passage, owner: str, model: Model
) -> tuple[dict[str, CoefficientFunction], CoefficientFunction]:
    names = [body.name for body in model.bodies]
    for name in wall.amounts:
        if name not in names:
            raise UnknownNameError(f"{owner}.amounts", name, names)
    if not wall.amounts:
        expected = f"which of the bodies flows in, as {{{names[0]!r}: 1.0}}"
        raise ParameterError(f"{owner}.amounts", {}, expected)
    if wall.density is not None:
        raise ParameterError(f"{owner}.density", wall.density, "none with bodies: it is sum rho_i n_i")
    n = {name: as_shape(f"{owner}.amounts[{name!r}]", wall.amounts.get(name, 0.0), ()) for name in names}
    assert isinstance(model.material, Mixture)
    given = model.material.filled(n, Id(3))
    given |= {K.name: CF(0.0) for K in model.material.plastic_contents.values()}
    for name in wall.values:
        if name.startswith(AMOUNT):
            raise ParameterError(f"{owner}.values", name, f"{name.removeprefix(AMOUNT)!r} in {owner}.amounts")
    z = starting_values(model.material, given | dict(wall.values), Id(3), owner=owner)
    return z, reduce(add, (body.density * n[body.name] for body in model.bodies))


def _density(
    wall: Passage, owner: str, model: Model, z: dict[str, CoefficientFunction]
) -> CoefficientFunction:
    """That of what flows in, kg/m^3."""
    if wall.density is not None:
        return as_shape(f"{owner}.density", wall.density, ())
    rho_R = model.material.referential_density
    if rho_R is None:
        expected = "that of what flows in, kg/m^3: the material has no referential density that tells it"
        raise ParameterError(f"{owner}.density", None, expected)
    return CF(value_at(rho_R, z)) / volume_ratio(model.material, z)


class GivenStress(PointTerm):
    """-int t . w, t = f - p n - Z_p (v . n) n - Z_s v_t, on one wall that is ``Open``."""

    def __init__(self, walls: Walls, name: str) -> None:
        self.name, self.region = name, walls.region([name])
        self.indicator = facet_indicator(walls.mesh, [name])
        wall, owner, dim = walls.conditions[name], f"walls[{name!r}]", walls.mesh.dim
        assert isinstance(wall, Open)
        self.pressure = as_shape(f"{owner}.pressure", wall.pressure, ())
        self.f = None if wall.traction is None else as_vector(wall.traction, dim, f"{owner}.traction")
        self.impedance = wall.impedance

    def _traction(self, u: Fields) -> CoefficientFunction:
        """f - p n, averaged over the step, Pa."""
        c = u.context
        load = -c.average(self.pressure, self.region) * c.normal
        return load if self.f is None else load + c.average(self.f, self.region)

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        parts = [-self.indicator * (self._traction(u) * w.v)]
        if any(self.impedance):
            parts.append(self.indicator * (self._resistance(u) * w.v))
        return parts

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        return self.facets(u, w)

    def _resistance(self, u: Fields) -> CoefficientFunction:
        """Z_p (v . n) n + Z_s v_t, Pa."""
        (Z_p, Z_s), n = self.impedance, u.context.normal
        return Z_s * u.v + ((Z_p - Z_s) * (u.v * n)) * n

    def entries(self, u: Fields) -> list[Entry]:
        power = Integrand(facets=self.indicator * (self._traction(u) * u.v))
        found = [Entry(f"power_traction_{self.name}", "power", power)]
        if any(self.impedance):
            resisted = self.indicator * (self._resistance(u) * u.v)
            found.append(_beyond(f"dissipation_impedance_{self.name}", resisted))
        return found


def _beyond(name: str, dissipated: CoefficientFunction) -> Entry:
    return Entry(name, "dissipation", Integrand(facets=dissipated), is_outside=True)


def passage_terms(walls: Walls, model: Model) -> tuple[Term, ...]:
    """The terms of the walls that matter crosses.

    Raises
    ------
    ParameterError
        For a model whose boundary terms there are not known, and for a missing density of what flows in.
    """
    for name in walls.crossed:
        if (reason := _refused(model, walls.mesh.dim)) is not None:
            condition = walls.conditions[name]
            raise ParameterError(f"walls[{name!r}]", condition, f"a wall that nothing crosses: {reason}")
    terms: list[Term] = [Carried(walls, name, model) for name in walls.crossed]
    named = [name for name in walls.crossed if isinstance(walls.conditions[name], Open)]
    return (*terms, *(GivenStress(walls, name) for name in named))


def _refused(model: Model, dim: int) -> str | None:
    """Why nothing can cross a wall with this model, or None."""
    law = model.regularisation
    if model.material.response(dim) is not None:
        return "its energy has no expression, and is not known of what is carried through"
    if law is not None and law.rho_max is not None:
        return "a cut-off density has fluxes of its own (Regularisation.rho_max)"
    if law is not None and (law.delta_density or law.delta_fields):
        return "what diffuses through it is not known (Regularisation.delta_fields, delta_density)"
    return None

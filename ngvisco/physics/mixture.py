"""One material of several bodies that share a point.

Body i has an energy psi_i(B, J) = f_i(B) + U_i(J) per reference volume (``ReferenceEnergy``) and carries its
densities n_i and X_i = n_i B.  With volume fractions alpha_i in equilibrium of pressure

    phi(n, X) = min over alpha_i of sum n_i psi_i(X_i/n_i, alpha_i/n_i) = sum n_i f_i(X_i/n_i) + V(n):

n psi(X/n, alpha/n) is the perspective of a convex function and jointly convex. The minimum of a sum of
perspectives over alpha is convex, so that phi is convex in all carried densities.  If all U_i' are one
function, V = sum n_i U_i(1/N) with N = sum n_j; else ``ngvisco.physics.equilibrium`` gives V.

If f is linear, n f(X/n) is linear, C : (X - n I).  Any other f has the arguments n + eta (N - n), X + eta (N
- n) I, an affine map that keeps phi convex: an absent body is a trace of matter at rest.  Hardening adds w
phi_h(K/w) with w = (n + delta N)/(1 + delta), which is n phi_h(k) where the body fills the point.  Bodies
with heat have one temperature and one entropy s, and V(n) becomes W(n, s).

A body that breaks (``Damaged``) has its own damage d_i and slope q_i. The damage degrades f_i and U_i alone.
The energy of its cracks has the weight w: where the body is absent, d_i changes no other energy.

For given damages phi is convex in the densities, but the minimum over alpha_i is not convex in d_i. Therefore
all conjugates have the volumes alpha_i that belong to the damages at the step's start (``Material.lagged``),
and d_i grows with held volumes. For given volumes phi is convex in (d_i, q_i), and at least its minimum
over the volumes. Therefore the Bregman distances by the densities and by (d_i, q_i) are >= 0.

Body i has the spin W, the strain rate chi_i D and the creep rate chi_i Pi_i.  The body's fraction determines
chi_i (``taking_part``): where the fraction is <= 0, chi_i is 0, and tensors of the body turn, but neither
stretch nor bear stress.  At an interface, D may have a part that the bodies do not share (``at_interfaces``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from operator import add
from typing import Any

from ngsolve import Det

from ngvisco.errors import NgviscoError, ParameterError
from ngvisco.physics.bodies import (
    AMOUNT,
    BACKING_TRACE,
    TRACE,
    Amount,
    Body,
    Content,
    Fractions,
    Layers,
    Parting,
)
from ngvisco.physics.body_damage import BodyDamage
from ngvisco.physics.body_energies import EnergyPart, InEquilibrium
from ngvisco.physics.equilibrium import MixedHeat
from ngvisco.physics.flow_rules.films import Films
from ngvisco.physics.flow_rules.rule import PlasticContent
from ngvisco.physics.material import ElasticState, Material
from ngvisco.physics.materials.damaged import DAMAGE, Damaged
from ngvisco.physics.materials.perspective import ReferenceEnergy
from ngvisco.physics.materials.thermal import Entropy, Thermal
from ngvisco.physics.parameters import Parameter, distinct, parameters_in
from ngvisco.physics.response import Respond
from ngvisco.physics.tensors import IDENTITY, Tensor, identity_like
from ngvisco.physics.variables import PRESSURE, Jacobian, Values, Variable

_LIGHTEST = "the density, less half of that of the lightest body"
"""Name of the bound on the density. Without this bound the density may fall below that of every body, and
forces of bodies would accelerate such matter."""

_SAME = 1e-9
"""Relative difference below which two volumetric energies count as one function."""


@dataclass(frozen=True, kw_only=True)
class Mixture(Material):
    """The common material of bodies; ``Model`` makes it.

    Raises ParameterError for two different parameters of one name, and for materials without an energy per
    reference volume (``ReferenceEnergy``).
    """

    bodies: tuple[Body, ...]
    """The bodies; a parameter made of a modulus has the body's name as a prefix."""
    carried: tuple[Parameter, ...] = ()
    """Parameters of the other laws of the model."""
    are_apart: bool = False
    """Whether each step ends with a separation of the bodies. A fraction then belongs to a cell that an
    interface cuts, and not to a mixture."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "bodies", tuple(body.with_own_names() for body in self.bodies))
        _ = self.parameters  # raises ParameterError for two parameters of one name

    @cached_property
    def energies(self) -> dict[str, ReferenceEnergy]:
        """The energies psi_i by the bodies' names, without their thermal parts."""
        return {b.name: ReferenceEnergy.of(b.material, f"bodies[{b.name!r}].material") for b in self.bodies}

    @cached_property
    def heat(self) -> MixedHeat | None:
        """The bodies' thermal energies; None without heat.

        The entropy's unit is the first one given, else the largest heat capacity.
        """
        parts = {b.name: b.material for b in self.bodies if isinstance(b.material, Thermal)}
        if not parts:
            return None
        units = [part.entropy_unit for part in parts.values() if part.entropy_unit]
        unit = units[0] if units else max(part.c for part in parts.values())
        return MixedHeat({name: replace(part, entropy_unit=unit) for name, part in parts.items()})

    def amounts(self, z: Values) -> dict[str, Any]:
        """The amounts n_i by the bodies' names."""
        return {body.name: z[AMOUNT + body.name] for body in self.bodies}

    def require(self) -> None:
        """Raise ParameterError for an energy that is not convex per reference volume. Bodies with several
        volumetric energies U_i are also refused if a law needs one U_i."""
        for body in self.bodies:
            psi = self.energies[body.name]
            psi.require()
            softest = min(self.stiffnesses.values())
            if body.parts and not (psi.tensors and 0 < softest < (1 - _SAME) * self.stiffnesses[body.name]):
                expected = " for a fluid, and for a body if no other body is more compressible"
                raise ParameterError(f"bodies[{body.name!r}].parts", True, False, expected)
            elastic = psi.tensors and not body.rules and body.name not in self.damages
            is_alone = sum(other.layered for other in self.bodies) < 2
            if body.layered and (not elastic or self.parting or is_alone):
                expected = (
                    " for fluids, bodies that creep or break, a single body, and beside bodies that part"
                )
                raise ParameterError(f"bodies[{body.name!r}].layered", True, False, expected)
            if psi.reads_parameters_in_volume and not self.has_one_volume:
                expected = "a material whose bulk modulus is a number, or bodies with one volumetric energy"
                raise ParameterError(f"bodies[{body.name!r}].material", body.material, expected)
            laws = {
                "creep" if n is None else f"material.branches.{n}.creep": r for n, r in body.rules.items()
            }
            for name, law in (laws | {"viscosity": body.viscosity}).items():
                if law is not None and PRESSURE in law.reads and not self.has_one_volume:
                    expected = "a law that reads no pressure, or bodies with one volumetric energy"
                    raise ParameterError(f"bodies[{body.name!r}].{name}", law, expected)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of moduli, of the bodies' variables and of the model's other laws."""
        of_materials = (v for body in self.bodies for v in body.material.variables)
        own = (v for v in of_materials if isinstance(v, Parameter) and v != DAMAGE)
        damages = (broken.damage for broken in self.damages.values())
        return distinct((*parameters_in(self.bodies), *self.carried, *own, *damages))

    @cached_property
    def damages(self) -> dict[str, BodyDamage]:
        """The damages of the bodies that break, by the bodies' names."""
        return {b.name: BodyDamage.of(b) for b in self.bodies if isinstance(b.material, Damaged)}

    @property
    def lagged(self) -> frozenset[str]:
        return frozenset(v.name for b in self.damages.values() for v in (b.damage, b.slope))

    @property
    def fractions(self) -> Fractions:
        """The volume fractions theta_i, from the amounts."""
        return Fractions(tuple(body.name for body in self.bodies))

    def contents(self, body: str) -> tuple[Content, ...]:
        """The contents X_i of a body, in the order of its energy's tensors."""
        tensors = self.energies[body].tensors
        scaled = (replace(v, name=f"{v.name}_{body}", exponent=v.exponent - 1) for v in tensors)
        return tuple(Content(v.name, v.kind, v, 1 / len(self.bodies)) for v in scaled)

    @cached_property
    def plastic_contents(self) -> dict[tuple[str, str | None], PlasticContent]:
        """The plastic contents K_i by body and branch; the branch is None in a body without branches."""
        rules = ((body.name, branch, rule) for body in self.bodies for branch, rule in body.rules.items())
        return {
            (name, branch): PlasticContent.of(name if branch is None else f"{branch}_{name}")
            for name, branch, rule in rules
            if rule.hardening is not None
        }

    def contents_of(self, body: str, branch: str | None) -> tuple[str, ...]:
        """Names of the contents X_i of a body's branch; ``branch`` is None for a body without branches."""
        material = next(member.material for member in self.bodies if member.name == body)
        names = material.distortions[branch or ""]
        return tuple(X.name for X in self.contents(body) if X.tensor.name in {f"{n}_{body}" for n in names})

    @property
    def distortions(self) -> dict[str, tuple[str, ...]]:
        owners = ((body.name, branch) for body in self.bodies for branch in body.material.distortions)
        return {f"{branch} {body}".strip(): self.contents_of(body, branch) for body, branch in owners}

    def densities(self, body: str) -> tuple[Variable, ...]:
        """Densities that a body carries: X_i, n_i, and K_i if the body hardens."""
        hardened = {K.name for (owner, _), K in self.plastic_contents.items() if owner == body}
        names = {X.name for X in self.contents(body)} | {AMOUNT + body} | hardened
        return tuple(v for v in self.variables if v.name in names)

    @cached_property
    def variables(self) -> tuple[Variable, ...]:
        contents = (content for body in self.bodies for content in self.contents(body.name))
        share = 1 / len(self.bodies)
        amounts = (Amount(AMOUNT + b.name, density=b.density or 0.0, share=share) for b in self.bodies)
        entropy = () if self.heat is None else (self.heat.entropy,)
        slopes = (broken.slope for broken in self.damages.values())
        return (*contents, *amounts, *self.plastic_contents.values(), *entropy, *slopes, *self.parameters)

    def with_elastic_state(self, state: ElasticState) -> Mixture:
        bodies = (replace(body, material=body.material.with_elastic_state(state)) for body in self.bodies)
        return replace(self, bodies=tuple(bodies))

    def with_carried(self, parameters: Sequence[Parameter]) -> Mixture:
        """The mixture with the further ``parameters`` of the model's other laws that it lacks."""
        more = distinct((*self.parameters, *parameters))[len(self.parameters) :]
        return replace(self, carried=(*self.carried, *more)) if more else self

    @cached_property
    def has_one_volume(self) -> bool:
        """Whether U_i' is one function of J for all bodies, so that V has an expression."""
        first, *energies = self.energies.values()
        if not energies:
            return True
        if self.damages or any(psi.reads_parameters_in_volume for psi in self.energies.values()):
            return False
        size = _SAME * abs(first.pressures).max()
        same = all(abs(psi.pressures - first.pressures).max() <= size for psi in energies)
        return same and (self.heat is None or self.heat.has_one_pressure)

    @cached_property
    def stiffnesses(self) -> dict[str, float]:
        """U_i'' at rest with its thermal part, by the bodies' names, Pa."""
        parts = {} if self.heat is None else self.heat.parts
        of_heat = {name: part.stiffness for name, part in parts.items()}
        return {name: psi.stiffness + of_heat.get(name, 0.0) for name, psi in self.energies.items()}

    def positive(self, z: Values) -> dict[str, Values]:
        """Functions of a state that must be > 0: N; if the U_i differ, sum n_i/U_i'', for a common pressure;
        with heat, sum n_i c_i. If an f_i is nonlinear or a body hardens or breaks, each amount n_i plus half
        of its trace must be > 0, too."""
        n, total = self.amounts(z), self.fractions.total(z)

        def above(share: float, sizes: Sequence[float]) -> Any:
            """The sum of size_i n_i divided by the least size, minus ``share`` times N."""
            pairs = zip(sizes, n.values(), strict=True)
            return reduce(add, ((size / min(sizes) - share) * amount for size, amount in pairs))

        bounds = {"the sum of the amounts": total}
        if not self.has_one_volume:
            bounds["the compliance of the bodies"] = above(0.1, [1 / K for K in self.stiffnesses.values()])
        if self.heat is not None:
            bounds["the heat capacity of the bodies"] = above(0.1, [b.c for b in self.heat.parts.values()])
        nonlinear = not all(psi.is_linear for psi in self.energies.values())
        if nonlinear or self.plastic_contents or self.damages:
            half = 0.5 * (TRACE if nonlinear else BACKING_TRACE)
            bounds |= {f"{AMOUNT}{name} + {half:g} N": value + half * total for name, value in n.items()}
        densities = [body.density or 0.0 for body in self.bodies]
        if max(densities) > 2 * min(densities):
            bounds[_LIGHTEST] = above(0.5, densities)
        return {"": bounds}

    @property
    def where_means_do(self) -> frozenset[str]:
        return frozenset([_LIGHTEST])

    @property
    def summed(self) -> tuple[tuple[str, ...], ...]:
        groups = (
            tuple(v.name for v in self.densities(body.name) if v.name != AMOUNT + body.name)
            for body in self.bodies
        )
        return tuple(group for group in groups if group)

    @property
    def linear(self) -> tuple[str, ...]:
        return tuple(self.linear_contents)

    @cached_property
    def linear_in_shears(self) -> tuple[str, ...]:
        """Names of variables in which the energy of shear and hardening is jointly linear."""
        names = list(self.linear_contents)
        if all(psi.is_linear for psi in self.energies.values()) and not self.plastic_contents:
            names += [AMOUNT + body.name for body in self.bodies]
        return tuple(names if self.heat is None else [*names, self.heat.entropy.name])

    @cached_property
    def linear_contents(self) -> dict[str, str]:
        """Names of the bodies by the names of their X_i, for energies that are linear in X_i."""
        linear = (name for name, psi in self.energies.items() if psi.is_linear)
        return {X.name: name for name in linear for X in self.contents(name)}

    def taking_part(self, z: Values) -> Values:
        if len(self.bodies) == 1:
            return {}
        shares = self._factors(z) if self.are_apart or self.layers is None else self.layers.scaled(z)
        factors = {X.name: share for name, share in shares.items() for X in self.contents(name)}
        return factors | {broken.slope.name: shares[name] for name, broken in self.damages.items()}

    @property
    def _factors(self) -> Callable[[Values], dict[str, Any]]:
        """The function of a state that gives the factors chi_i by the bodies' names."""
        return self.fractions.behind_planes if self.are_apart else self.fractions.taking_part

    def films(self, name: str) -> Films | None:
        """The creep rate of a body in cells that it shares with films of fluid. None if ``are_apart`` is
        False, or if there is a law ``parting``."""
        if not self.are_apart or self.parting is not None:
            return None
        fluids = [b for b in self.bodies if not self.energies[b.name].tensors]
        return Films.of(fluids, self.fractions, self.energies[name].shear_stiffness)

    @cached_property
    def parting(self) -> Parting | None:
        """The law of the bodies that part; None without such bodies."""
        names = frozenset(body.name for body in self.bodies if body.parts)
        return Parting(tuple(self.stiffnesses.items()), names) if names else None

    @cached_property
    def layers(self) -> Layers | None:
        """The law of the layered bodies; None without such bodies."""
        moduli = tuple((b.name, self.energies[b.name].shear_stiffness) for b in self.bodies if b.layered)
        return Layers(moduli, self.fractions, self._factors) if moduli else None

    @property
    def at_interfaces(self) -> Parting | Layers | None:
        return self.parting or self.layers

    def parted(self, z: Values) -> Values:
        shares = {} if self.at_interfaces is None else self.at_interfaces.shares(z)
        return {X.name: share for name, share in shares.items() for X in self.contents(name)}

    def filled(self, shares: Mapping[str, Any], F: Tensor | Mapping[str, Tensor]) -> dict[str, Any]:
        """n_i and X_i by name, for the volume ``shares`` of the bodies and their distortion F. F is one
        distortion for all bodies, or a distortion by the bodies' names."""
        by_body = F if isinstance(F, Mapping) else dict.fromkeys(shares, F)
        values = {AMOUNT + name: share / Det(by_body[name]) for name, share in shares.items()}
        for name, share in shares.items():
            values |= {X.name: share * X.tensor.from_distortion(by_body[name]) for X in self.contents(name)}
        return values

    def at_rest(self, z: Values) -> Values:
        total = self.fractions.total(z)
        hardening = {K.name: z[K.name] / total for K in self.plastic_contents.values()}
        return {**z, **self.filled(self.fractions.at(z), IDENTITY), **hardening}

    def own_names(self, body: str) -> dict[str, str]:
        """Carried names of a body's variables, by the names in the body's energy; only its damage has two."""
        return {DAMAGE.name: self.damages[body].damage.name} if body in self.damages else {}

    def own(self, body: str, z: Values) -> dict[str, Any]:
        """The values ``z``, with the body's own variables also under their names in the body's energy."""
        return {**z, **{name: z[carried] for name, carried in self.own_names(body).items()}}

    def shears(self, z: Values) -> dict[str, Any]:
        """The energies n_i f_i(X_i/n_i), Pa, by the bodies' names. n_i phi_h(K_i/n_i) is added if a body
        hardens, and the energy of cracks if it breaks."""
        energies = self.elastic_shears(z)
        parameters = {v.name: z[v.name] for v in self.parameters}
        for body in self.bodies:
            further = []
            for branch, rule in body.rules.items():
                if rule.hardening is not None:
                    content = z[self.plastic_contents[body.name, branch].name]
                    weight = self.fractions.backed(z, body.name)
                    further.append(rule.hardening.energy(weight, content, parameters))
            if (broken := self.damages.get(body.name)) is not None:
                further.append(broken.surface_energy(z, self.fractions.backed(z, body.name)))
            if further:
                energies[body.name] = reduce(add, further, energies.get(body.name, 0.0))
        return energies

    def elastic_shears(self, z: Values) -> dict[str, Any]:
        """The energies n_i f_i(X_i/n_i) by the names of the bodies with tensors, Pa."""
        total, energies = self.fractions.total(z), {}
        for body in self.bodies:
            psi, n = self.energies[body.name], z[AMOUNT + body.name]
            parameters = self.own(body.name, {v.name: z[v.name] for v in self.parameters})
            one = 1 + 0 * n
            X = {v.name: z[f"{v.name}_{body.name}"] for v in psi.tensors}
            if not X:
                continue
            unit = {name: identity_like(value) for name, value in X.items()}
            size, weight = n, 1
            if not psi.is_linear:
                trace = TRACE * (total - n)
                size, weight = one, n + trace
                inverse = 1 / weight
                X = {name: inverse * (value + trace * unit[name]) for name, value in X.items()}
            X_rest = {name: size * tensor for name, tensor in unit.items()}
            shear = psi.energy({**parameters, **X, "J": one}) - psi.energy({**parameters, **X_rest, "J": one})
            energies[body.name] = weight * shear
        return energies

    def volumetric(self, body: str, z: Values) -> Any:
        """U_i(J), plus u_i(S, J) for a body with heat, Pa per reference volume; ``z`` has J, S and the
        parameters."""
        energy = self.energies[body].volumetric(self.own(body, z))
        return energy if self.heat is None else energy + self.heat.energy(body, z["S"], z["J"])

    def driving(self, body: str, z: Values, J: Any) -> Any:
        """The energy of a body that its damage degrades, Pa; ``J`` is the body's volume."""
        broken = self.damages[body]

        def energy(damage: float) -> Any:
            values = {**z, broken.damage.name: 0 * J + damage}
            return self.elastic_shears(values).get(body, 0.0) + z[AMOUNT + body] * self.volumetric(
                body, {**values, "J": J}
            )

        return (energy(0.0) - energy(1.0)) * (1 / (1 - broken.law.floor))

    def volumes(self, z: Values, J: Any) -> dict[str, Any]:
        """n_i (U_i + u_i) by the bodies' names, Pa, for bodies of one volume J and one temperature."""
        n = self.amounts(z)
        S = {} if self.heat is None else self.heat.entropies(n, z[self.heat.entropy.name], J)
        return {name: n[name] * self.volumetric(name, {**z, "J": J, "S": S.get(name)}) for name in n}

    def energy(self, z: Values) -> Tensor:
        if not self.has_one_volume:
            raise NgviscoError(
                "the common energy of bodies with different volumetric energies is not an expression; use "
                "ngvisco.physics.pointwise.respond(material, dim)"
            )
        return reduce(add, (*self.volumes(z, 1 / self.fractions.total(z)).values(), *self.shears(z).values()))

    @cached_property
    def curved_part(self) -> Material:
        if AMOUNT + self.bodies[0].name not in self.linear_in_shears or self.parameters:
            return self

        def volumetric(z: Values) -> Any:
            return reduce(add, self.volumes(z, 1 / self.fractions.total(z)).values())

        return EnergyPart(volumetric, tuple(v for v in self.variables if isinstance(v, (Amount, Entropy))))

    def response(self, dim: int) -> Respond | None:
        if self.has_one_volume:
            return None

        def shear(z: Values) -> Any:
            return reduce(add, self.shears(z).values(), 0.0 * self.fractions.total(z))

        entropy = () if self.heat is None else (Entropy("S"),)
        of_volume = (Jacobian("J"), *entropy, *self.parameters)
        names = [body.name for body in self.bodies]
        shears = EnergyPart(shear, self.variables, self.linear_in_shears)
        volumetric = [EnergyPart(partial(self.volumetric, name), of_volume) for name in names]
        states = self.states(dim)
        return InEquilibrium(
            states, names, shears, volumetric, self.parameters, self.heat, self.damages, self.driving
        )

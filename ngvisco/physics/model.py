"""The model of a run: a material, its dissipative mechanisms and its loads."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, Self

from ngvisco.errors import ParameterError, declared, require_fields
from ngvisco.physics.bodies import Body, Fractions
from ngvisco.physics.diffusion import Diffusion
from ngvisco.physics.energy_checks import check_energy
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.flow_rules.check import check_rule, check_viscosity
from ngvisco.physics.flow_rules.rule import PLASTIC_CONTENT, Hardening, PlasticContent
from ngvisco.physics.heat import Heat, HeatLaw
from ngvisco.physics.loads import Load, check_name
from ngvisco.physics.material import ElasticState, Material, check_material, part_of
from ngvisco.physics.materials.damaged import Damaged, DamageVariable
from ngvisco.physics.materials.network import Network, rules_of
from ngvisco.physics.materials.thermal import NO_TEMPERATURE, Thermal, entropy_in, warming
from ngvisco.physics.materials.wrapped import carrying
from ngvisco.physics.mixed_viscosity import MixedViscosity, mixed_viscosity
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import parameters_in, told_apart
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import HyperViscosity, Viscosity
from ngvisco.physics.variables import TEMPERATURE, Values
from ngvisco.words import Mention, Words, call


@dataclass(frozen=True)
class CreepMechanism:
    """A flow rule with its own creep rate Pi: the rule of the material, of a branch or of a body."""

    rule: FlowRule
    names: tuple[str, ...]
    """Names of the variables whose rates contain this Pi."""
    conformation: str | None = None
    """Name of the conformation tensor among the ``variables``; None without one."""
    branch: str | None = None
    """Name of the network's branch that flows; None without branches."""
    body: str | None = None
    fractions: Fractions | None = None
    """Volume fractions of the bodies; None without bodies."""

    def share(self, z: Values) -> Any:
        """The body's volume fraction at the point, > 0, the weight of the body's power per volume."""
        return 1.0 if self.fractions is None or self.body is None else self.fractions.positive(z, self.body)

    @property
    def suffix(self) -> str:
        """The suffix of the names of a branch's columns and fields; empty for other mechanisms."""
        return "" if self.branch is None else f"_{self.branch}"

    @property
    def plastic_content(self) -> PlasticContent:
        """The variable of the rule's hardening: K = A k of the material or of a branch, or K_i of a body."""
        owner = "_".join(name for name in (self.branch, self.body) if name is not None)
        return PlasticContent.of(owner) if owner else PLASTIC_CONTENT

    def plastic_strain(self, z: Values) -> tuple[str, Any]:
        """The name of the field of the plastic strain k, and k at a point with the values ``z``."""
        content, amount = self.plastic_content, self.matter(z)
        if self.fractions is not None and self.body is not None:
            amount = self.fractions.backed(z, self.body)
        return content.strain, z[content.name] / amount

    def matter(self, z: Values) -> Any:
        """The reference volume of all matter per actual volume: A, or N for bodies."""
        return z["A"] if self.fractions is None else self.fractions.total(z)

    def amount(self, z: Values) -> Any:
        """The factor of dk/dt in the rate of K: A, or the amount n_i > 0 of the body."""
        return self.share(z) * self.matter(z)


@dataclass(frozen=True, kw_only=True)
class Model:
    """The material, mechanisms and loads of a run.

    Raises ParameterError for a part of the wrong type, for a flow rule or a viscosity that creates energy
    (``check_rule``, ``check_viscosity``), and for two loads or two bodies of one name.  Also refused are a
    body whose energy is not convex per reference volume (``ReferenceEnergy``), variables that do not fit each
    other, and a flow rule that needs a conformation tensor which the material lacks.

    Parameters
    ----------
    material : Material
        Any modulus of its laws may be a function of the initial place, or an expression of carried parameters
        (``Parameter``). The parameters are then among the variables of ``model.material``.  An isotropic
        material at finite strain that leaves ``elastic_state`` open is by B = F F^T with creep or m = 0, else
        by F.
    viscosity : Viscosity, optional
        Any of ``StokesViscosity``, ``LinearViscosity``, ``PowerLaw``, ``Carreau``, ``Cross``,
        ``ActivatedViscosity``.
    hyperviscosity : HyperViscosity, optional
    creep : FlowRule, optional
        None (default) gives the Kelvin-Voigt rheology; with a flow rule the deviatoric part is Jeffreys'.
    loads : sequence of Gravity, CentralGravity or BodyForce
    regularisation : Regularisation, optional
        The paper's regularising terms; None (default) for none of them.
    heat : Heat, optional
        Conduction and sources of heat in a material with a temperature (``Thermal``). With None (default) the
        material is adiabatic: dissipation heats the material, and nothing is conducted.
    diffusion : Diffusion, optional
        Diffusion of a concentration that the material carries, such as a solute.
    bodies : sequence of Body
        Bodies in place of ``material``, ``viscosity`` and ``creep``. The bodies' mixture gives material and
        viscosity (``ngvisco.physics.mixture``), and each body has its own creep.  Isotropic materials that
        leave ``elastic_state`` open are by B.
    """

    material: Material = None  # type: ignore[assignment]
    viscosity: Viscosity | None = None
    hyperviscosity: HyperViscosity | None = None
    creep: FlowRule | None = None
    loads: tuple[Load, ...] = field(default=())
    regularisation: Regularisation | None = None
    bodies: tuple[Body, ...] = field(default=())
    heat: Heat | None = None
    diffusion: Diffusion | None = None

    def __post_init__(self) -> None:
        self._take_bodies()
        require_fields(self)
        _require_names_of_loads(self.loads)
        check_material(self.material)
        names = ("material", "viscosity", "hyperviscosity", "creep")
        reserved = [] if entropy_in(self.material) is None else [TEMPERATURE]
        laws = told_apart((getattr(self, name) for name in names), reserved)
        for name, law in zip(names, laws, strict=True):
            object.__setattr__(self, name, law)
        carried = parameters_in(laws)
        if self.creep is not None and part_of(self.material, Network) is not None:
            raise ParameterError("Model.creep", self.creep, _NO_CREEP)
        if self.creep is not None and self.creep.reads_conjugate and self.material.conformation is None:
            raise ParameterError("Model.creep", self.creep, _no_conformation(self.material))
        material = self.material
        if self.bodies or _flows(self.creep, material):
            material = material.with_elastic_state("B")
        if isinstance(material, Mixture):
            material = material.with_carried(carried)
        else:
            material = carrying(material, carried, self._hardening)
        check_material(material)
        object.__setattr__(self, "material", material)
        if isinstance(material, Mixture):
            object.__setattr__(self, "bodies", material.bodies)
            for body in material.bodies:
                check_material(body.material)
                check_energy(carrying(body.material, parameters_in((body.material,))))
            material.require()
        else:
            check_energy(material)
        self._check_heat_and_damage(material)
        if self.diffusion is not None:
            self.diffusion.require(material)
        for part in (body.material for body in self.bodies) if self.bodies else (material,):
            _require_bulk(part)
        for mechanism in self.mechanisms:
            if mechanism.rule.reads_conjugate and mechanism.conformation is None:
                name, expected = f"branches[{mechanism.branch!r}].creep", _no_conformation(self.material)
                raise ParameterError(name, mechanism.rule, expected)
            check_rule(mechanism.rule, material)
        if self.viscosity is not None:
            check_viscosity(self.viscosity, material)

    def at_order(self, m: int) -> Self:
        """The model in which no elastic state is open, for variables of order ``m``.

        An open elastic state becomes "B" with creep or m = 0, else "F" (``open_state`` has the reason).
        """
        state, _ = open_state(self.creep, self.material, m)
        if self.bodies:
            return self
        material = self.material.with_elastic_state(state)
        if material.variables != self.material.variables:
            return replace(self, material=material)
        return self._of(material)

    def with_bodies_apart(self, are_apart: bool) -> Self:
        """The model whose bodies are separated, or not, at the end of each step."""
        material = self.material
        if not isinstance(material, Mixture) or material.are_apart == are_apart:
            return self
        return self._of(replace(material, are_apart=are_apart))

    def _of(self, material: Material) -> Self:
        """This model with another ``material`` of the same energy; the model's checks are not repeated."""
        settled = copy(self)
        object.__setattr__(settled, "material", material)
        return settled

    @property
    def mechanisms(self) -> tuple[CreepMechanism, ...]:
        """Creep mechanisms of the material, of each branch of a network, or of each body."""
        material = self.material
        if (network := part_of(material, Network)) is not None:
            return tuple(
                CreepMechanism(branch.creep, material.distortions[name], material.conformation_of(name), name)
                for name, branch in network.parts.items()
                if branch.creep is not None and branch.creep.flows and material.distortions[name]
            )
        if not isinstance(material, Mixture):
            names = tuple(v.name for v in material.variables if v.creeps)
            if self.creep is None or not self.creep.flows:
                return ()
            return (CreepMechanism(self.creep, names, material.conformation),)
        rules = [
            (body, branch, rule, material.contents_of(body.name, branch))
            for body in self.bodies
            for branch, rule in body.rules.items()
        ]
        for body in self.bodies:
            names = tuple(X.name for X in material.contents(body.name))
            if names and not body.rules and (films := material.films(body.name)) is not None:
                rules.append((body, None, films, names))
        return tuple(
            CreepMechanism(rule, names, branch=branch, body=body.name, fractions=material.fractions)
            for body, branch, rule, names in rules
            if names
        )

    @property
    def traced(self) -> list[str]:
        """Names of tensors whose creep rate has a trace, so that J does not determine their determinants."""
        return [name for mechanism in self.mechanisms if mechanism.rule.has_trace for name in mechanism.names]

    @property
    def _hardening(self) -> tuple[tuple[PlasticContent, Hardening], ...]:
        """Pairs of plastic content and hardening of the material or of its branches."""
        return tuple(
            (PLASTIC_CONTENT if name is None else PlasticContent.of(name), rule.hardening)
            for name, rule in rules_of(self.material, self.creep).items()
            if rule.hardening is not None
        )

    @property
    def breaks(self) -> bool:
        """Whether the material, or a body, has a damage that grows."""
        return any(isinstance(v, DamageVariable) for v in self.material.variables)

    @property
    def heat_law(self) -> HeatLaw:
        """The conduction and the heat sources of the model and its bodies."""
        parts: dict[str | None, Heat] = {None: self.heat or Heat()}
        parts |= {body.name: body.heat for body in self.bodies if body.heat is not None}
        return HeatLaw(parts, self.material.fractions if isinstance(self.material, Mixture) else None)

    def _check_heat_and_damage(self, material: Material) -> None:
        entropy = entropy_in(material)
        if self.heat is not None and entropy is None:
            raise ParameterError("Model.heat", self.heat, NO_TEMPERATURE)
        is_custom = part_of(material, Thermal) is None and not isinstance(material, Mixture)
        if entropy is not None and is_custom and not (slope := warming(material, entropy)) > 0:
            expected = (
                f"a material whose energy is convex in the entropy, but d theta/d s at rest is {slope:.4g} "
                "K, not > 0"
            )
            raise ParameterError("Model.material", material, expected)
        if self.heat is not None and self.heat.numerical_heating and material.response(3) is not None:
            expected = (
                " for an energy without an expression: the energy of a Yosida approximation, or of bodies "
                "whose pressures are different functions of volume and temperature"
            )
            raise ParameterError("Heat.numerical_heating", True, False, expected)
        if part_of(material, Damaged) is not None and not material.lagged:
            known = Words(call("Damaged", material=...), ", alone or within ", call("Thermal", material=...))
            reason = "; other materials cannot wrap a damaged material"
            raise ParameterError("Model.material", self.material, known, reason)

    def _take_bodies(self) -> None:
        """Check the bodies, and take material and viscosity from their mixture, if there are bodies."""
        object.__setattr__(self, "bodies", declared(Model)["bodies"].taken("Model.bodies", self.bodies))
        if not self.bodies:
            return
        for name in ("material", "viscosity", "creep"):
            value = getattr(self, name)
            # a copy by ``replace`` gets the mixture's material and viscosity as arguments
            if not (value is None or isinstance(value, (Mixture, MixedViscosity))):
                expected = f" with bodies, since each body has its own {name}"
                raise ParameterError(f"Model.{name}", value, None, expected)
        _require_names_and_one_rest(self.bodies)
        names = [body.name for body in self.bodies]
        for name in names:
            if (shorter := name.removesuffix("_momentum")) != name and shorter in names:
                expected = (
                    f"other names, since the centroid of {name!r} and the momentum of {shorter!r} would have "
                    "columns of the same names"
                )
                raise ParameterError("Model.bodies", names, expected)
        law = self.regularisation
        if isinstance(law, Regularisation):
            for name, number, none in (
                ("rho_max", law.rho_max, None),
                ("delta_density", law.delta_density, 0.0),
            ):
                if number != none:
                    why = "the density of bodies is a sum, which is neither cut off nor diffused"
                    raise ParameterError(f"Regularisation.{name}", number, none, f" with bodies, since {why}")
        for body in self.bodies:
            for part, fault in _faults(body, self.bodies):
                raise ParameterError(f"bodies[{body.name!r}].{part}", attrgetter(part)(body), fault)
        mixture = Mixture(bodies=self.bodies)
        object.__setattr__(self, "material", mixture)
        object.__setattr__(self, "viscosity", mixed_viscosity(mixture.bodies, mixture.parting))


MOST_DENSER = 1e10
"""Largest ratio of bodies' densities. Above it, the lighter body's momentum in a cell with both bodies is
below the solver's tolerance, 1e-10."""


def _no_conformation(material: Material) -> str:
    """The expected material in the message about a rule that reads a conformation tensor."""
    name = type(material).__name__
    return f"a rule that reads no conformation tensor, since {name} has none; OldroydB and FENEP have one"


_NO_CREEP = Words(None, " with a Network, whose branches have flow rules of their own")


def _faults(body: Body, bodies: Sequence[Body]) -> Iterable[tuple[str, str]]:
    """Yield the faults of one body among ``bodies``, as pairs of a key and the right value."""
    material, law, heat = body.material, body.creep, body.heat
    if (broken := part_of(material, Damaged)) is not None:
        yield from _faults_of_damage(material, broken, bodies)
    if law is not None and part_of(material, Network) is not None:
        yield "creep", _NO_CREEP
    lightest = min(bodies, key=lambda member: member.density or 0.0)
    if (body.density or 0.0) > MOST_DENSER * (lightest.density or 0.0):
        most = f"at most {MOST_DENSER:g} times that of {lightest.name!r}, {lightest.density:g} kg/m^3"
        yield "density", most
    thermal_law = call("Thermal", material=...)
    warm = [member for member in bodies if entropy_in(member.material) is not None]
    thermal = [member.material for member in warm if isinstance(member.material, Thermal)]
    units = {part.entropy_unit for part in thermal if part.entropy_unit is not None}
    if warm and body not in warm:
        expected = f" as for {warm[0].name!r}, since all bodies have one temperature"
        yield "material", Words(thermal_law, expected)
    if body in warm and not isinstance(material, Thermal):
        expected = ", since the entropy of a body does not follow from other energies"
        yield "material", Words(thermal_law, expected)
    if len(units) > 1:
        expected = f"materials with one entropy_unit, not {sorted(units)}, since bodies share one entropy"
        yield "material", expected
    if heat is not None and not warm:
        yield "heat", NO_TEMPERATURE
    if heat is not None and heat.numerical_heating:
        together = Words(False, ", since the scheme heats all bodies together; see ", Mention("Model.heat"))
        yield "heat.numerical_heating", together
    if getattr(material, "J_min", None) is not None:
        expected = "a material without J_min, since the continued energy is not convex per reference volume; "
        remedy = " around NeoHookean with J_min continues the energy per reference volume"
        yield "material", Words(expected, call("PerReferentialVolume", material=...), remedy)
    for branch, rule in body.rules.items():
        key = "creep" if branch is None else "material"
        if rule.nu:
            yield key, "flow rules with nu = 0, since the creep of several bodies has no gradient term"
        if rule.reads_conjugate or rule.has_trace:
            yield key, "a flow rule that reads no conformation tensor, since bodies have no such tensor"


def _faults_of_damage(
    material: Material, broken: Damaged, bodies: Sequence[Body]
) -> Iterable[tuple[str, str]]:
    """Yield the faults of a body with damage, as pairs of the key and the value that would be right."""
    if broken is not material:
        expected = " itself, since a material that wraps a damaged one does not give the damage of the body"
        yield "material", Words(call("Damaged", material=...), expected)
    if broken.area == "reference":
        yield "material.area", "'actual', since a body does not carry the distortion from its start"
    if broken.breaking is not None:
        yield "material.breaking", "None, since all branches of a body break together"
    if any(entropy_in(member.material) is not None for member in bodies):
        yield "material", "no damage beside heat, since damage grows at held volumes, not at held entropies"


def _require_bulk(material: Material) -> None:
    """Raise ParameterError for a material with the bulk modulus 0 outside of a network's branches."""
    part: object = material
    while (inner := getattr(part, "material", None)) is not None:
        part = inner
    if isinstance(K_e := getattr(part, "K_e", None), float) and K_e == 0:
        expected = (
            "a number > 0; only branches of a Network may have 0, if another branch carries the pressure"
        )
        raise ParameterError(f"{type(part).__name__}.K_e", K_e, expected)


def _require_names_of_loads(loads: Sequence[Any]) -> None:
    """Raise ParameterError for a load with an invalid name, or with the name of an earlier load."""
    for i, load in enumerate(loads):
        check_name(load)
        if (name := load.name) in [earlier.name for earlier in loads[:i]]:
            expected = (
                f"a name that no other load has, since the ledger has a column power_{name} for each load"
            )
            raise ParameterError(f"loads[{i}].name", name, expected)


def _require_names_and_one_rest(bodies: Sequence[Any]) -> None:
    """Raise ParameterError for a body with the name of an earlier one, and for a second body without a
    place."""
    rest = None
    for i, body in enumerate(bodies):
        if body.name in [earlier.name for earlier in bodies[:i]]:
            raise ParameterError(f"bodies[{i}].name", body.name, "a name that no other body has")
        if body.where is None and rest is not None:
            expected = f"a place, since {rest!r} without a place already fills the rest of the domain"
            raise ParameterError(f"bodies[{i}].where", None, expected)
        rest = body.name if body.where is None else rest


def open_state(creep: FlowRule | None, material: Material, m: int) -> tuple[ElasticState, str]:
    """The default elastic state of a material with variables of order ``m``, and the reason for this state.

    With creep of the material or of a branch, the state is "B", because F winds up by creep. For m = 0 it is
    "B", because with constants in cells det F and J drift apart faster than with polynomials, and by F this
    drift frees rest energy.
    """
    if _flows(creep, material):
        return "B", "there is creep"
    return ("B", "m = 0") if m == 0 else ("F", "there is no creep, and m >= 1")


def _flows(creep: FlowRule | None, material: Material) -> bool:
    network = part_of(material, Network)
    branches = () if network is None else network.parts.values()
    return (creep is not None and creep.flows) or any(branch.flows for branch in branches)

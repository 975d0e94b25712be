"""The model of a run: a material, its dissipative mechanisms and its loads."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np
from ngsolve import CF, CoefficientFunction, sqrt, x, y, z

from ngvisco.errors import ParameterError, Quantity, _is_number, as_number, as_place, require_ranges
from ngvisco.physics.bodies import Body
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.flow_rules.check import check_rule, check_viscosity
from ngvisco.physics.flows import Flow
from ngvisco.physics.heat import Heat
from ngvisco.physics.material import ElasticState, Material, check_material
from ngvisco.physics.materials.damaged import damage_in
from ngvisco.physics.materials.hardened import hardened
from ngvisco.physics.materials.heterogeneous import carrying
from ngvisco.physics.materials.thermal import entropy_in, thermal_part, warming
from ngvisco.physics.mixed_heat import HeatLaw, require_heat_of_all
from ngvisco.physics.mixture import MixedViscosity, Mixture, mixed_viscosity
from ngvisco.physics.parameters import parameters_in, told_apart
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import HyperViscosity, Viscosity
from ngvisco.physics.state_function import check_energy
from ngvisco.physics.variables import TEMPERATURE

VectorLike: TypeAlias = CoefficientFunction | Sequence[float | CoefficientFunction]


@dataclass(frozen=True)
class Gravity:
    """Gravity acceleration g: the force density rho g (paper: Euler-small-viscoelastodyn+1).

    Parameters
    ----------
    g : sequence of numbers or coefficient functions, or a vector coefficient function
        Acceleration, a component for each dimension; a function of x and of the run's time.
    name : str
        The ledger's column of its power is power_<name>.
    """

    g: Annotated[VectorLike, Quantity("m/s^2", example=[0.0, -9.81])]
    name: str = "gravity"


@dataclass(frozen=True)
class BodyForce:
    """A force per actual volume.

    Parameters
    ----------
    force : vector
        Force per actual volume, a component for each dimension.
    name
        As for ``Gravity``.
    """

    force: Annotated[VectorLike, Quantity("N/m^3", example=[0.0, "-sin(t)"])]
    name: str = "body_force"


@dataclass(frozen=True, kw_only=True)
class CentralGravity:
    """Gravity towards a centre, g = -strength (r/radius)^exponent e_r, for discs, shells and spheres.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    strength : float
        Acceleration towards the centre at r = radius; negative is outward.
    centre : sequence of two or three numbers
        The centre, a component for each dimension.
    radius : float
        Radius at which the strength holds.
    exponent : float
        The acceleration goes like r^exponent: 0 is constant (a mantle), 1 that inside a homogeneous ball, -2
        that outside (-1 in 2D); below 1 the centre must not be in the domain.
    name
        As for ``Gravity``.
    """

    strength: Annotated[float, Quantity("m/s^2", example=9.81)]
    centre: Annotated[tuple[float, ...], Quantity("m", example=[0.0, 0.0])] = (0.0, 0.0)
    radius: Annotated[float, Quantity("m", "> 0", 1.0)] = 1.0
    exponent: Annotated[float, Quantity("1")] = 0.0
    name: str = "gravity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", as_place("CentralGravity.centre", self.centre))
        require_ranges(self)

    @property
    def g(self) -> CoefficientFunction:
        """The acceleration, a vector of the centre's length."""
        offset = CF(tuple(X - c for X, c in zip((x, y, z), self.centre, strict=False)))
        r = sqrt(offset * offset)
        return -self.strength / self.radius**self.exponent * r ** (self.exponent - 1) * offset


Load = Gravity | CentralGravity | BodyForce


@dataclass(frozen=True, kw_only=True)
class Model:
    """Material and mechanisms of a run.

    Raises ParameterError if a part is of the wrong type, a flow rule or a viscosity gives energy
    (``check_rule``, ``check_viscosity``), two loads or two bodies share a name, the energy of a body is none
    that is convex per reference volume (``ReferenceEnergy``), the material's list of variables makes no
    sense, or the law of creep needs a conformation tensor that the material does not have; UnknownNameError
    if a ``WithQuadratic`` names variables that its material does not have in the form for this model.

    Parameters
    ----------
    material : Material
        Any modulus of its laws may be a function of the initial place or an expression of carried
        parameters (``Parameter``); these are then among the variables of ``model.material``.  Isotropic ones
        at finite strain that leave ``elastic_state`` open are by B = F F^T where there is creep, by F where
        there is none.
    viscosity : Viscosity, optional
        Any of ``StokesViscosity``, ``LinearViscosity``, ``PowerLaw``, ``Carreau``, ``Cross``,
        ``ActivatedViscosity``.
    hyperviscosity : HyperViscosity, optional
    creep : FlowRule, optional
        None (default) is the Kelvin-Voigt rheology, otherwise Jeffreys in the deviatoric part.
    loads : sequence of Gravity, CentralGravity or BodyForce
    regularisation : Regularisation, optional
        None (default) is none of the paper's regularising terms.
    heat : Heat, optional
        How heat is conducted and exchanged, of a material with a temperature (``Thermal``); None (default) is
        adiabatic: its dissipation heats it, and nothing is conducted.
    bodies : sequence of Body
        In place of ``material`` and ``viscosity``, which are then those of the bodies' mixture
        (``ngvisco.physics.mixture``), and of ``creep``, which each body has by itself.  Isotropic materials
        that leave ``elastic_state`` open are by B.
    """

    material: Material = None  # type: ignore[assignment]
    viscosity: Viscosity | None = None
    hyperviscosity: HyperViscosity | None = None
    creep: FlowRule | None = None
    loads: tuple[Load, ...] = field(default=())
    regularisation: Regularisation | None = None
    bodies: tuple[Body, ...] = field(default=())
    heat: Heat | None = None

    def __post_init__(self) -> None:
        self._take_bodies()
        for name, kind in (
            ("material", Material),
            ("viscosity", Viscosity),
            ("hyperviscosity", HyperViscosity),
            ("creep", FlowRule),
            ("regularisation", Regularisation),
            ("heat", Heat),
        ):
            value = getattr(self, name)
            if not (isinstance(value, kind) or (value is None and name != "material")):
                expected = _EXPECTED.get(name, f"a {kind.__name__}")
                raise ParameterError(f"Model.{name}", value, expected)
        if not isinstance(self.loads, (tuple, list)):
            raise ParameterError("Model.loads", self.loads, "a sequence of Gravity or BodyForce objects")
        object.__setattr__(self, "loads", tuple(self.loads))
        for load in self.loads:
            if not isinstance(load, (Gravity, CentralGravity, BodyForce)):
                raise ParameterError("Model.loads", load, "Gravity, CentralGravity or BodyForce objects")
            _check_name(load)
        names = [load.name for load in self.loads]
        if len(set(names)) < len(names):
            raise ParameterError("Model.loads", names, "distinct names")
        check_material(self.material)
        names_of = ("material", "viscosity", "hyperviscosity", "creep")
        taken = [] if entropy_in(self.material) is None else [TEMPERATURE]
        laws = told_apart((getattr(self, name) for name in names_of), taken)
        for name, law in zip(names_of, laws, strict=True):
            object.__setattr__(self, name, law)
        carried = parameters_in(laws)
        if self.creep is not None and self.creep.reads_conjugate and self.material.conformation is None:
            raise ParameterError("Model.creep", self.creep, "a material with a conformation tensor")
        state = "B" if self.bodies else default_elastic_state(self.creep)
        plain = hardened(self.material.with_elastic_state(state), None)
        if isinstance(plain, Mixture):
            material: Material = plain.with_carried(carried)
        else:
            rule = None if self.creep is None else self.creep.hardening
            material = hardened(carrying(plain, carried), rule)
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
        self._check_heat(material)
        self._check_damage(material)
        for flow in self.flows:
            check_rule(flow.rule, material)
        if self.viscosity is not None:
            check_viscosity(self.viscosity, material)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """What creeps: the material, or each of the bodies by its own tensors."""
        if isinstance(self.material, Mixture):
            of = self.material
            creeping = ((b.name, b.creep) for b in self.bodies if b.creep is not None and b.creep.flows)
            return tuple(
                Flow(rule, tuple(X.name for X in of.contents(name)), name, of.fractions)
                for name, rule in creeping
                if of.contents(name)
            )
        if self.creep is None or not self.creep.flows:
            return ()
        return (Flow(self.creep, tuple(v.name for v in self.material.variables if v.creeps)),)

    @property
    def heat_law(self) -> HeatLaw:
        """What the model and its bodies say of heat."""
        parts: dict[str | None, Heat] = {None: self.heat or Heat()}
        parts |= {body.name: body.heat for body in self.bodies if body.heat is not None}
        return HeatLaw(parts, self.material.fractions if isinstance(self.material, Mixture) else None)

    def _check_heat(self, material: Material) -> None:
        if self.heat is not None and entropy_in(material) is None:
            expected = "None for a material without a temperature; nv.Thermal(material=...) gives it one"
            raise ParameterError("Model.heat", self.heat, expected)
        entropy = entropy_in(material)
        own = thermal_part(material) is None and not isinstance(material, Mixture)
        if entropy is not None and own and not (slope := warming(material, entropy)) > 0:
            expected = f"an energy convex in the entropy: at rest d theta/d s is {slope:.4g} K, not > 0"
            raise ParameterError("Model.material", material, expected)
        if self.heat is not None and self.heat.numerical_heating and material.response(3) is not None:
            expected = (
                "False for an energy without an expression, as that of a Yosida approximation, or of bodies "
                "whose pressures are different functions of volume and temperature"
            )
            raise ParameterError("Heat.numerical_heating", True, expected)

    def _check_damage(self, material: Material) -> None:
        if damage_in(material) is not None and not material.lagged:
            expected = (
                "nv.Damaged(...), or that in nv.Thermal(material=...): no other material knows of damage"
            )
            raise ParameterError("Model.material", self.material, expected)

    def _take_bodies(self) -> None:
        """Make material, viscosity and creep those of the bodies, where there are such."""
        if not isinstance(self.bodies, (tuple, list)) or not all(isinstance(b, Body) for b in self.bodies):
            raise ParameterError("Model.bodies", self.bodies, "a sequence of Body objects")
        object.__setattr__(self, "bodies", tuple(self.bodies))
        if not self.bodies:
            return
        for name in ("material", "viscosity", "creep"):
            if (value := getattr(self, name)) is not None and not isinstance(value, _MIXED):
                raise ParameterError(f"Model.{name}", value, "None with bodies, which have theirs")
        names = [body.name for body in self.bodies]
        if len(set(names)) < len(names):
            raise ParameterError("Model.bodies", names, "distinct names")
        for name in names:
            if (other := name.removesuffix("_momentum")) != name and other in names:
                expected = f"distinct columns of bodies; those of {name!r} would be the momentum of {other!r}"
                raise ParameterError("Model.bodies", names, expected)
        for body in self.bodies:
            if damage_in(body.material) is not None:
                expected = "a material without damage: that of one body would be the damage of all"
                raise ParameterError(f"bodies[{body.name!r}].material", body.material, expected)
        if sum(body.where is None for body in self.bodies) > 1:
            without = [body.name for body in self.bodies if body.where is None]
            raise ParameterError("Model.bodies", without, "one body at most without a place, the rest")
        self._require_mass_of_bodies()
        self._require_local_laws_of_bodies()
        mixture = Mixture(bodies=self.bodies)
        object.__setattr__(self, "material", mixture)
        object.__setattr__(self, "viscosity", mixed_viscosity(mixture.bodies))

    def _require_local_laws_of_bodies(self) -> None:
        """Raise ParameterError for a law that bodies cannot have beside others."""
        require_heat_of_all(self.bodies)
        for body in self.bodies:
            if getattr(body.material, "J_min", None) is not None:
                expected = "J_min = None: continued below it, the energy is not convex per reference volume"
                raise ParameterError(f"bodies[{body.name!r}].material", body.material, expected)
            law = body.creep
            if law is None or not law.flows:
                continue
            expected = ""
            if law.nu:
                expected = "nu = 0: the creep of several bodies is local"
            elif law.reads_conjugate or law.has_trace:
                expected = "a flow rule that reads no conformation tensor, which no body has"
            if expected:
                raise ParameterError(f"bodies[{body.name!r}].creep", law, expected)

    def _require_mass_of_bodies(self) -> None:
        """Raise ParameterError where rho moves by other fluxes than the bodies' amounts, whose sum it is, and
        where the momentum of one body is lost beside another's."""
        lightest = min(self.bodies, key=lambda body: body.density or 0.0)
        for body in self.bodies:
            if (body.density or 0.0) > MOST_DENSER * (lightest.density or 0.0):
                expected = (
                    f"at most {MOST_DENSER:g} times that of {lightest.name!r}, {lightest.density:g} kg/m^3"
                )
                raise ParameterError(f"bodies[{body.name!r}].density", body.density, expected)
        law = self.regularisation
        if not isinstance(law, Regularisation):
            return
        for name, value, none in (("rho_max", law.rho_max, None), ("delta_density", law.delta_density, 0.0)):
            if value != none:
                expected = (
                    f"{none} with bodies: the density is the sum of theirs, which nothing cuts off or mixes"
                )
                raise ParameterError(f"Regularisation.{name}", value, expected)


MOST_DENSER = 1e10
"""Ratio of bodies' densities above which the momentum of the lighter one is below the tolerance, 1e-10, of a
solver that sees both in one cell."""

_MIXED = (Mixture, MixedViscosity)
"""What a model with bodies has already, where it is made of another one."""

_EXPECTED = {"viscosity": "a StokesViscosity or another viscosity", "creep": "a Creep or another FlowRule"}


def default_elastic_state(creep: FlowRule | None) -> ElasticState:
    """How a material that leaves it open knows of its elastic state: by B where there is creep, else by F."""
    return "B" if creep is not None and creep.flows else "F"


_NAME = re.compile(r"(?!traction_|wall_)[A-Za-z][A-Za-z0-9_]*")
"""Names of loads: power_<name> is a column's name, and those of walls are power_traction_<wall> and so on."""


def _check_name(load: Load) -> None:
    if not (isinstance(load.name, str) and _NAME.fullmatch(load.name)):
        expected = "a name of letters, digits and _, not beginning with traction_ or wall_"
        raise ParameterError(f"{type(load).__name__}.name", load.name, expected)


def as_vector(value: VectorLike, dim: int, field_name: str) -> CoefficientFunction:
    """A vector coefficient function of length ``dim``, or ParameterError naming the field."""
    if isinstance(value, CoefficientFunction):
        vector = value
    else:
        try:
            parts: tuple[Any, ...] = tuple(np.asarray(value).ravel() if _is_matrix(value) else value)
        except TypeError:
            raise ParameterError(field_name, value, f"a vector of length {dim}") from None
        if not all(isinstance(p, CoefficientFunction) or _is_number(p) for p in parts):
            raise ParameterError(field_name, value, "finite numbers or coefficient functions")
        vector = CF(tuple(p if isinstance(p, CoefficientFunction) else float(p) for p in parts) or 0.0)
    if vector.dim != dim:
        raise ParameterError(field_name, value, f"a vector of length {dim}, not {vector.dim}")
    return vector


def force_of(load: Load, dim: int) -> CoefficientFunction:
    """g (m/s^2) of gravity, or the body force (N/m^3), in ``dim`` dimensions; raises ParameterError."""
    owner = f"loads[{load.name!r}]"
    if isinstance(load, CentralGravity) and len(load.centre) != dim:
        expected = f"{dim} numbers, as many as the mesh has dimensions"
        raise ParameterError(f"{owner}.centre", load.centre, expected)
    if isinstance(load, BodyForce):
        return as_vector(load.force, dim, f"{owner}.force")
    return as_vector(load.g, dim, f"{owner}.g")


def _is_matrix(value: object) -> bool:
    """Whether it is a row or a column of NumPy, (1, n) or (n, 1)."""
    return isinstance(value, np.ndarray) and value.ndim == 2 and 1 in value.shape


def as_tensor(value: object, shape: tuple[int, int]) -> CoefficientFunction | None:
    """An array, or rows of numbers and coefficient functions, as a tensor; None if it is none."""
    entries: list[Any] = []
    try:
        for row in np.asarray(value) if isinstance(value, np.ndarray) else value:  # type: ignore[attr-defined]
            entries += [e if isinstance(e, CoefficientFunction) else as_number(e) for e in row]
            if len(entries) % shape[1]:
                return None
    except TypeError:
        return None
    if len(entries) != shape[0] * shape[1] or any(entry is None for entry in entries):
        return None
    return CF(tuple(entries), dims=shape)

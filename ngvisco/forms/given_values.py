"""Values of a material's variables by name, from given data at the start or at an inflow."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Self, TypeAlias

from ngsolve import CF, L2, CoefficientFunction, Id, Mesh, exp
from ngsolve.fem import NewtonCF

from ngvisco.errors import InitialDataError, ParameterError, as_number, require_known
from ngvisco.physics.bodies import AMOUNT
from ngvisco.physics.loads import as_tensor
from ngvisco.physics.material import (
    Material,
    conjugates,
    part_of,
    rate_power,
    rest_stress_and_modulus,
    volume_ratio,
)
from ngvisco.physics.materials.damaged import DamageSlope
from ngvisco.physics.materials.thermal import NO_TEMPERATURE, Thermal, entropy_in
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.model import Model
from ngvisco.physics.parameters import Parameter, value_at
from ngvisco.physics.signals import time
from ngvisco.physics.tensors import if_positive, log
from ngvisco.physics.variables import Jacobian, LogJacobian, ReciprocalJacobian
from ngvisco.physics.walls import Open, Passage
from ngvisco.words import FUNCTION, Words, call

Given: TypeAlias = Mapping[str, CoefficientFunction]
StartValues: TypeAlias = dict[str, CoefficientFunction]


_VOLUMES = {"J", "A"}
"""Names of variables that determine the volume; an inflow with a given volume needs a density."""

_INVERTED, _STEPS = 1e-12, 100
"""Accepted defect of the scaled pressure; and largest number of Newton steps for the volume."""
_VACUUM = 14.0
"""Logarithm of the finite volume that stands for the infinite volume of a gas at zero pressure."""


def parameter_values(material: Material, given: Given, owner: str = "Initial") -> StartValues:
    """Values of the material's parameters by name: given values, or else the parameters' start values."""
    values = {}
    for variable in material.variables:
        if isinstance(variable, Parameter):
            value = given.get(variable.name, variable.start)
            if value is None:
                expected = f"nv.Parameter({variable.name!r}, start=...), or a value in {owner}.values"
                raise InitialDataError(
                    f"parameter {variable.name}", "no start value is given", expected, f"{owner}.values"
                )
            values[variable.name] = as_shape(f"{owner}.values[{variable.name!r}]", value, ())
    return values


def starting_values(
    material: Material,
    given: Given,
    F: CoefficientFunction,
    further: Iterable[str] = (),
    owner: str = "Initial",
) -> StartValues:
    """Values of all variables by name: given values, or else values that follow from F.

    Raises UnknownNameError for a name that is neither a variable's nor among ``further``.
    """
    values = {v.name: v.from_distortion(F) for v in material.variables}
    told = parameter_values(material, given, owner) | given_values(material, given, further, owner)
    return values | carried_of(material, told)


def carried_of(material: Material, values: StartValues) -> StartValues:
    """Values of a material's variables, in which parameters have the numbers that are carried."""
    parameters = (v for v in material.variables if isinstance(v, Parameter) and v.name in values)
    return values | {v.name: v.carried(values[v.name]) for v in parameters}


def given_values(
    material: Material, given: Given, further: Iterable[str] = (), owner: str = "Initial"
) -> StartValues:
    """The given values of a material's variables, by name.

    Raises UnknownNameError for a name that is neither a variable's nor among ``further``.
    """
    # the damage gradient follows from the damage, and is never given
    shapes = {
        v.name: tuple(v.from_distortion(Id(3)).dims)
        for v in material.variables
        if not isinstance(v, DamageSlope)
    }
    require_known("material variable", given, (*shapes, *further), f"{owner}.values[]")
    return {
        name: as_shape(f"{owner}.values[{name!r}]", given[name], shape)
        for name, shape in shapes.items()
        if name in given
    }


def temperature_for(
    material: Material, temperature: object, given: Given, owner: str
) -> CoefficientFunction | None:
    """The temperature, K, that determines the entropy; by default the reference temperature.

    The result is None for a material without entropy, and if ``given`` has the entropy itself.  Raises
    ParameterError if a temperature is given in one of these two cases; for an entropy that no temperature
    determines; and for bodies without a common reference temperature if none is given.
    """
    field, entropy = f"{owner}.temperature", entropy_in(material)
    if entropy is None or entropy.name in given:
        if temperature is not None:
            beside = Words(None, ", since the given values contain the entropy")
            raise ParameterError(field, temperature, NO_TEMPERATURE if entropy is None else beside)
        return None
    if isinstance(material, Mixture):
        reference = None if material.heat is None else material.heat.reference_temperature
    elif (thermal := part_of(material, Thermal)) is not None:
        reference = thermal.theta_R
    else:
        why = Words(", since a temperature determines the entropy only for ", call("Thermal", material=...))
        raise ParameterError(f"{owner}.values", "no entropy", f"a value of {entropy.name!r}", why)
    if temperature is None and reference is None:
        expected = "a temperature, since the reference temperatures theta_R differ from body to body"
        raise ParameterError(field, None, expected)
    return as_shape(field, reference if temperature is None else temperature, ())


def entropy_at(material: Material, theta: CoefficientFunction, values: Given) -> StartValues:
    """The entropy, by its name, at a temperature, K, and the other variables' values.

    Bodies at one point have a common volume.
    """
    entropy, thermal = entropy_in(material), part_of(material, Thermal)
    assert entropy is not None
    if isinstance(material, Mixture):
        assert material.heat is not None
        volume = 1 / material.fractions.total(values)
        return {entropy.name: material.heat.total(material.amounts(values), log(theta), volume)}
    assert thermal is not None
    return {entropy.name: thermal.start(theta, values["A"])}


def bulk_pressure(
    material: Material, J: CoefficientFunction, given: Given, theta: CoefficientFunction | None = None
) -> CoefficientFunction:
    """Pressure -tr T/3, Pa, at F = J^{1/3} I. ``given`` has variables that are not strains; theta is in K."""
    z: StartValues = {}
    for v in material.variables:
        is_given = not v.is_strain and v.name in given
        # each variable has its own F, so that a derivative by one variable leaves the others fixed
        z[v.name] = given[v.name] if is_given else v.from_distortion(J ** (1 / 3) * Id(3))
    entropy, thermal = entropy_in(material), part_of(material, Thermal)
    if entropy is not None and theta is not None and thermal is not None:
        z[entropy.name] = thermal.start(theta, 1 / J)
    zero = CF((0.0,) * 9, dims=(3, 3))
    return -(rate_power(material, z, conjugates(material, z), Id(3) / 3, zero) + material.energy(z))


def _at_pressure(
    material: Material, p: CoefficientFunction, theta: CoefficientFunction | None, mesh: Mesh
) -> StartValues:
    """Strains of a fluid at a pressure, Pa, by the inverse of its bulk law."""
    logarithm = L2(mesh, order=0).TrialFunction()
    _, modulus = rest_stress_and_modulus(material)
    # Newton's method solves for logarithms: the logarithm of a gas's pressure is linear in that of its volume
    law, target = (
        log(part + (part * part + 1) ** 0.5)
        for part in (bulk_pressure(material, exp(logarithm), {}, theta) / modulus, p / modulus)
    )
    excess = law - target - if_positive(logarithm - _VACUUM, logarithm - _VACUUM, CF(0.0))
    # forms that are linearised cannot contain NewtonCF. With ``time - time``, J counts as a function of
    # time, whose values on facets are computed once a step, outside the forms
    J = exp(NewtonCF(excess, CF(0.0), tol=_INVERTED, maxiter=_STEPS)) + (time - time)
    return {v.name: v.from_distortion(J ** (1 / 3) * Id(3)) for v in material.variables if v.is_strain}


def is_let_in_by_pressure(wall: Passage, material: Material) -> bool:
    """Whether the inflow is a fluid whose state the wall gives by its pressure alone."""
    if not isinstance(wall, Open) or wall.traction is not None or any((*wall.impedance, *wall.stiffness)):
        return False
    if wall.density is not None or wall.values:
        return False
    volumes = Jacobian, ReciprocalJacobian, LogJacobian
    strains = [v for v in material.variables if v.is_strain]
    parameters = {v.name for v in material.variables if not v.is_strain}
    if wall.temperature is not None and (entropy := entropy_in(material)) is not None:
        parameters -= {entropy.name}
    return bool(strains) and all(isinstance(v, volumes) for v in strains) and not parameters


@dataclass(frozen=True)
class Entering:
    """The given state of an inflow: variables by name, density, kg/m^3, temperature, K.

    A quantity that is not given enters with its value inside the body.
    """

    values: StartValues
    density: CoefficientFunction | None = None
    temperature: CoefficientFunction | None = None

    @property
    def is_of_density_alone(self) -> bool:
        """Whether neither a variable nor the temperature is given."""
        return not self.values and self.temperature is None

    def mapped(self, function: Callable[[CoefficientFunction], CoefficientFunction]) -> Self:
        """Return the state with ``function`` applied to all given quantities."""
        density, theta = (f if f is None else function(f) for f in (self.density, self.temperature))
        values = {name: function(value) for name, value in self.values.items()}
        return replace(self, values=values, density=density, temperature=theta)


def entering(wall: Passage, owner: str, model: Model, mesh: Mesh) -> Entering:
    """The given state of matter that flows in through a wall.

    By default bodies enter unstrained; a fluid of known density has its volume at the wall's pressure.

    Raises ParameterError for a volume without a density, and for given values without a use; UnknownNameError
    for unknown names.
    """
    material, given = model.material, dict(wall.values)
    if isinstance(material, Mixture):
        for name in given:
            if name.startswith(AMOUNT):
                expected = f"the amount of {name.removeprefix(AMOUNT)!r} in {owner}.amounts"
                raise ParameterError(f"{owner}.values", name, expected)
        if wall.density is not None:
            expected = "no density with bodies, since the density is the sum of rho_i n_i"
            raise ParameterError(f"{owner}.density", wall.density, expected)
        if wall.amounts:
            names = [body.name for body in model.bodies]
            require_known(f"body in {owner}.amounts", wall.amounts, names, f"{owner}.amounts[]")
            amounts = {n: as_shape(f"{owner}.amounts[{n!r}]", wall.amounts.get(n, 0.0), ()) for n in names}
            plastic = {K.name: CF(0.0) for K in material.plastic_contents.values()}
            given = material.filled(amounts, Id(3)) | plastic | given
    elif wall.amounts:
        raise ParameterError(f"{owner}.amounts", dict(wall.amounts), "no amounts in a model without bodies")
    z = given_values(material, given, owner=owner)
    theta = None
    if wall.temperature is not None:
        theta = temperature_for(material, wall.temperature, wall.values, owner)
    if material.referential_density is not None and is_let_in_by_pressure(wall, material):
        assert isinstance(wall, Open)
        z = _at_pressure(material, as_shape(f"{owner}.pressure", wall.pressure, ()), theta, mesh)
    density = None
    if wall.density is not None:
        density = as_shape(f"{owner}.density", wall.density, ())
    elif _VOLUMES & z.keys():
        if material.referential_density is None:
            expected = (
                "the density of the incoming matter, kg/m^3, since the values contain a volume but the "
                "material has no "
            )
            raise ParameterError(f"{owner}.density", None, expected + "referential density")
        starting = starting_values(material, given | z, Id(3), owner=owner)
        density = CF(value_at(material.referential_density, starting)) / volume_ratio(material, starting)
    return Entering(z, density, theta)


def as_shape(field_name: str, value: object, shape: tuple[int, ...]) -> CoefficientFunction:
    """Return ``value`` as a coefficient function of a shape; raise ParameterError for another shape."""
    expected = {
        0: Words("a number or a scalar ", FUNCTION),
        1: Words("a ", FUNCTION, f" with {len(shape) and shape[0]} components"),
        2: Words("a 3x3 ", FUNCTION, ", also in 2D"),
    }[len(shape)]
    if not shape and (as_number(value) is not None or isinstance(value, float)):
        return CF(float(value))  # type: ignore[arg-type]  # sampling the data finds NaN and inf
    if len(shape) == 2 and not isinstance(value, CoefficientFunction):
        tensor = as_tensor(value, (shape[0], shape[1]))
        value = value if tensor is None else tensor
    if not isinstance(value, CoefficientFunction):
        raise ParameterError(field_name, value, expected)
    if tuple(value.dims) != shape:
        raise ParameterError(field_name, f"shape {tuple(value.dims)}", expected)
    return value

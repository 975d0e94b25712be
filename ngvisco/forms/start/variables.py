"""A material's variables by name from what is given of them, at the start or where matter flows in."""

from collections.abc import Iterable, Mapping

from ngsolve import CF, CoefficientFunction

from ngvisco.errors import InitialDataError, ParameterError, UnknownNameError, as_number
from ngvisco.physics.loads import as_tensor
from ngvisco.physics.material import Material, part_of
from ngvisco.physics.materials.damaged import DamageSlope
from ngvisco.physics.materials.thermal import Thermal, entropy_in
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.parameters import Parameter
from ngvisco.physics.tensors import log

Given = Mapping[str, CoefficientFunction]


def parameter_values(
    material: Material, given: Given, owner: str = "Initial"
) -> dict[str, CoefficientFunction]:
    """Values of the material's parameters by name, where nothing is given those of the start."""
    values = {}
    for variable in material.variables:
        if isinstance(variable, Parameter):
            value = given.get(variable.name, variable.start)
            if value is None:
                expected = f"nv.Parameter({variable.name!r}, start=...), or a value in {owner}.values"
                raise InitialDataError(f"parameter {variable.name}", "no start value", expected)
            values[variable.name] = as_shape(f"{owner}.values[{variable.name!r}]", value, ())
    return values


def starting_values(
    material: Material,
    given: Given,
    F: CoefficientFunction,
    further: Iterable[str] = (),
    owner: str = "Initial",
) -> dict[str, CoefficientFunction]:
    """Values of all variables by name: those given, else what the elastic distortion F says.

    Raises UnknownNameError for a name that is neither a variable's nor among ``further``.
    """
    names = [
        v.name for v in material.variables if not isinstance(v, DamageSlope)
    ]  # it follows from the damage
    for name in given:
        if name not in (*names, *further):
            raise UnknownNameError("material variable", name, [*names, *further])
    values = {v.name: v.from_distortion(F) for v in material.variables}
    values |= parameter_values(material, given, owner)
    for name in set(names) & set(given):
        values[name] = as_shape(f"{owner}.values[{name!r}]", given[name], tuple(values[name].dims))
    return values


def given_temperature(material: Material, given: object, owner: str) -> CoefficientFunction:
    """``owner.temperature``, K, which where it is None is the one of reference.

    Raises ParameterError for a material whose entropy no temperature tells, and bodies that have not one of
    reference.
    """
    known: float | None = None
    if isinstance(material, Mixture):
        known = None if material.heat is None else material.heat.reference_temperature
    elif (thermal := part_of(material, Thermal)) is not None:
        known = thermal.theta_R
    else:
        entropy = entropy_in(material)
        assert entropy is not None
        expected = f"a value of {entropy.name!r}: by a temperature only nv.Thermal knows it"
        raise ParameterError(f"{owner}.values", "no entropy", expected)
    if given is None and known is None:
        expected = "a temperature: those of reference, theta_R, differ from body to body"
        raise ParameterError(f"{owner}.temperature", None, expected)
    return as_shape(f"{owner}.temperature", known if given is None else given, ())


def entropy_at(material: Material, theta: CoefficientFunction, values: Given) -> CoefficientFunction:
    """The entropy of a temperature, K, and the other variables' values; where bodies meet they share the
    volume that all have at a point."""
    if isinstance(material, Mixture):
        assert material.heat is not None
        return material.heat.total(material.amounts(values), log(theta), 1 / material.fractions.total(values))
    thermal = part_of(material, Thermal)
    assert thermal is not None
    return thermal.start(theta, values["A"])


def as_shape(field_name: str, value: object, shape: tuple[int, ...]) -> CoefficientFunction:
    """A coefficient function of this shape, or ParameterError; a number will do for a scalar."""
    expected = {
        0: "a number or a scalar coefficient function",
        1: f"a coefficient function with {len(shape) and shape[0]} components",
        2: "a 3x3 coefficient function, also in 2D",
    }[len(shape)]
    number = as_number(value)
    if not shape and (number is not None or isinstance(value, float)):
        return CF(float(value))  # type: ignore[arg-type]  # NaN and inf are found where data are sampled
    if len(shape) == 2 and not isinstance(value, CoefficientFunction):
        tensor = as_tensor(value, (shape[0], shape[1]))
        value = value if tensor is None else tensor
    if not isinstance(value, CoefficientFunction):
        raise ParameterError(field_name, value, expected)
    if tuple(value.dims) != shape:
        raise ParameterError(field_name, f"shape {tuple(value.dims)}", expected)
    return value

"""Materials of case files that are written otherwise than in scripts: by texts, or by other parameters."""

import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, NewType

from ngvisco.case.energies import RESERVED, UNIT, EnergyExpression, parse_energy
from ngvisco.errors import ParameterError, Quantity, require_names
from ngvisco.expressions import ExpressionError, number
from ngvisco.physics.material import Material
from ngvisco.physics.materials import CustomMaterial, IsotropicStrainEnergy, PerMass, PerReferentialVolume
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    SmallStrain,
    Variable,
)

EnergyText = NewType("EnergyText", str)
"""A text that ``ngvisco.case.energies`` parses."""

_VARIABLES: dict[str, Variable] = {
    "F": Distortion(),
    "H": Cofactor(),
    "B": LeftCauchyGreen(),
    "N": CofactorLeftCauchyGreen(),
    "J": Jacobian(),
    "A": ReciprocalJacobian(),
    "K": LogJacobian(),
    "E": SmallStrain(),
}
_TENSORS: dict[str, type[Variable]] = {
    "F": Distortion,
    "cof(F)": Cofactor,
    "F*trans(F)": LeftCauchyGreen,
    "cof(F*trans(F))": CofactorLeftCauchyGreen,
}
_DEFINED = re.compile(r"([A-Za-z_]\w*)=(?:J\*\*(\([^()]*\)|[+-]?[0-9.]+)\*)?(.+)")
_VARIABLE = (
    f"one of {', '.join(_VARIABLES)}, or NAME = J**(a)*X with a number a and X one of "
    f"{', '.join(_TENSORS)}, as in 'H = J**(-5/6)*F'"
)


def custom_material(
    variables: Annotated[Sequence[str], Quantity(example=["F", "J"])],
    energy: Annotated[EnergyText, Quantity("Pa", example="3*norm2(F)/J**(2/3) + 4*(J + 1/J)")],
    parameters: Annotated[Mapping[str, float] | None, Quantity("any", example={"G": 5.0})] = None,
    per: Literal["volume", "referential volume", "mass"] = "volume",
    rho_R: Annotated[float | None, Quantity("kg/m^3", "> 0", 1000.0)] = None,
) -> Material:
    """A material of the user's own: any variables, and an energy as an expression of them.

    Raises ParameterError for what is no variable, no energy (with the position in the text), or an energy
    that depends on the observer (with the rotation that shows it).

    Parameters
    ----------
    variables : sequence of str
        What is carried: F, H = cof(F), B = F*trans(F), N = cof(F*trans(F)), J = det(F), A = 1/J, K =
        log(J)/J, the small strain E; with a power of J as in "H = J**(-5/6)*F".
    energy : str
        Stored energy of the variables; by per = "mass" in J/kg.
    parameters : mapping of names to numbers, optional
        Numbers that the energy reads by name, as they stand.
    per : str
        What the energy is per: "volume" (the actual one), "referential volume" or "mass"; by the latter two
        what is carried are the tensors over J, and A = 1/J.
    rho_R : float, optional
        Density where J = 1, which an energy per mass needs; with it the initial density and J follow from one
        another.
    """
    carried = tuple(_variable(text) for text in require_names("Custom.variables", variables))
    names = [v.name for v in carried]
    for name in names:
        if name in RESERVED:
            raise ParameterError("Custom.variables", name, f"another name than {', '.join(RESERVED)}")
    if not names:
        raise ParameterError("Custom.variables", variables, f"at least one variable, {_VARIABLE}")
    expression = _energy("Custom", energy, carried, parameters)
    try:
        density = rho_R if per == "volume" else None
        material = CustomMaterial(transported=carried, stored_energy=expression, rho_R=density)
        if per == "volume":
            return material
    except ParameterError as error:
        if error.field == "CustomMaterial.rho_R":
            raise ParameterError("Custom.rho_R", rho_R, error.expected) from error
        if error.field == "CustomMaterial.stored_energy":
            raise ParameterError("Custom.energy", energy, error.expected) from error
        raise ParameterError("Custom.variables", variables, error.expected) from error
    if per == "mass" and rho_R is None:
        raise ParameterError("Custom.rho_R", None, "the referential density, kg/m^3, for an energy per mass")
    try:
        if rho_R is None:
            return PerReferentialVolume(material=material)
        return (PerMass if per == "mass" else PerReferentialVolume)(material=material, rho_R=rho_R)
    except ParameterError as error:
        key, given = ("rho_R", rho_R) if error.field.endswith("rho_R") else ("variables", variables)
        raise ParameterError(f"Custom.{key}", given, error.expected) from error


def isotropic_strain_energy(
    energy: Annotated[EnergyText, Quantity("Pa", example="5*tr(E)**2 + 5*norm2(dev(E))")],
    parameters: Annotated[Mapping[str, float] | None, Quantity("any", example={"G": 5.0})] = None,
) -> IsotropicStrainEnergy:
    """Any convex isotropic energy phi(E) of the small strain, as an expression of E.

    Raises ParameterError for what is no energy (with the position in the text), or one that is not isotropic.

    Parameters
    ----------
    energy : str
        Stored energy per actual volume of the small strain E, isotropic and convex.
    parameters : mapping of names to numbers, optional
        Numbers that the energy reads by name, as they stand.
    """
    expression = _energy("IsotropicStrainEnergy", energy, (SmallStrain(),), parameters)
    try:
        return IsotropicStrainEnergy(strain_energy=lambda E: expression(E=E))
    except ParameterError as error:
        raise ParameterError("IsotropicStrainEnergy.energy", energy, error.expected) from error


def _energy(
    owner: str, text: str, variables: tuple[Variable, ...], parameters: Mapping[str, float] | None
) -> EnergyExpression:
    names = [v.name for v in variables]
    for name, value in (parameters or {}).items():
        if not name.isidentifier() or name in (*names, *RESERVED):
            taken = ", ".join([*names, *RESERVED])
            expected = f"a name of letters, digits and _ that is none of {taken}"
            raise ParameterError(f"{owner}.parameters", name, expected)
        if not abs(value) < float("inf"):
            raise ParameterError(f"{owner}.parameters.{name}", value, "a finite number")
    try:
        return parse_energy(text, variables, parameters)
    except ExpressionError as error:
        expected = f"an expression of {', '.join([*names, *(parameters or {}), UNIT])}: {error}"
        raise ParameterError(f"{owner}.energy", text, expected) from error


def _variable(text: str) -> Variable:
    """The variable of a name or of a definition; raises ParameterError."""
    plain = re.sub(r"\s", "", text)
    if plain in _VARIABLES:
        return _VARIABLES[plain]
    match = _DEFINED.fullmatch(plain)
    if match is None or match[3] not in _TENSORS:
        raise ParameterError("Custom.variables", text, _VARIABLE)
    try:
        exponent = number(match[2]) if match[2] else 0.0
        return _TENSORS[match[3]](name=match[1], exponent=exponent)  # type: ignore[call-arg]
    except (ExpressionError, ParameterError) as error:
        raise ParameterError("Custom.variables", text, f"{_VARIABLE} ({error})") from error

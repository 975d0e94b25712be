"""Laws that a case file gives as texts: energies, laws of the temperature, and materials made of them.

A text is an expression of ``ngvisco.expressions``, of scalars and 3x3 tensors, and is evaluated by this
package, never by Python.  ``reference.md`` lists its parts.
"""

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NewType

import numpy as np
from ngsolve import x

from ngvisco.errors import ParameterError, Quantity, require_names
from ngvisco.expressions import CONSTANTS, Evaluator, ExpressionError, is_tensor, number, syntax_tree
from ngvisco.physics.material import Material
from ngvisco.physics.materials import CustomMaterial, IsotropicStrainEnergy, PerMass, PerReferentialVolume
from ngvisco.physics.materials.thermal import Entropy
from ngvisco.physics.tensors import IDENTITY
from ngvisco.physics.variables import (
    Cofactor,
    CofactorLeftCauchyGreen,
    Concentration,
    Distortion,
    Jacobian,
    LeftCauchyGreen,
    LogJacobian,
    ReciprocalJacobian,
    SmallStrain,
    Variable,
)

EnergyText = NewType("EnergyText", str)
"""An energy written as a text, for ``parse_energy``."""

_IDENTITY = "I"
_RESERVED = (*CONSTANTS, _IDENTITY)
"""Names that variables and parameters cannot have."""

_TENSORS: dict[str, type[Variable]] = {
    "F": Distortion,
    "cof(F)": Cofactor,
    "F*trans(F)": LeftCauchyGreen,
    "cof(F*trans(F))": CofactorLeftCauchyGreen,
}
_KINDS: tuple[Any, ...] = (*_TENSORS.values(), Jacobian, ReciprocalJacobian, LogJacobian, SmallStrain)
_VARIABLES: dict[str, Variable] = {variable.name: variable for variable in (kind() for kind in _KINDS)}
_DEFINED = re.compile(r"([A-Za-z_]\w*)=(?:J\*\*(\([^()]*\)|[+-]?[0-9.]+)\*)?(.+)")
_VARIABLE = (
    f"one of {', '.join(_VARIABLES)}; or 'NAME = amount'; or 'NAME = J**(a)*X' where a is a number and X is "
    f"{', '.join([*_TENSORS][:-1])} or {[*_TENSORS][-1]}, as in 'H = J**(-5/6)*F'"
)


@dataclass(frozen=True)
class EnergyExpression:
    """A checked text as a function of the variables' values: coefficient functions or arrays."""

    text: str
    parameters: Mapping[str, float]
    _tree: ast.expr = field(repr=False, compare=False)

    def __call__(self, **values: Any) -> Any:
        backend = next(iter(values.values()))
        identity = backend.constant(np.eye(3)) if hasattr(backend, "constant") else IDENTITY
        symbols = {**CONSTANTS, _IDENTITY: identity, **self.parameters, **values}
        return Evaluator(self.text, symbols, of_tensors=True).value(self._tree)


def parse_law(text: str) -> Callable[[Any], Any]:
    """The law theta -> value that a text describes; raises ExpressionError like ``parse_energy``."""
    law = parse_energy(text, (Entropy(name="theta"),), what="a law of the temperature")
    return lambda theta: law(theta=theta)


def parse_energy(
    text: str,
    variables: Sequence[Variable],
    parameters: Mapping[str, float] | None = None,
    what: str = "an energy",
) -> EnergyExpression:
    """Check a text completely, and return the energy that it describes.

    Raises ExpressionError, with the position and the allowed forms, for wrong syntax, unknown names and
    functions, operands of the wrong rank, constant parts that are not finite, a tensor as the result, and a
    text without any of the variables.

    Parameters
    ----------
    variables : sequence of Variable
        Variables of the energy, scalars or tensors by their kinds.
    parameters : mapping of names to numbers, optional
    what : str
        Name of the energy in errors.
    """
    constants = {name: float(value) for name, value in (parameters or {}).items()}
    stand_ins = {v.name: x if v.kind == "scalar" else IDENTITY for v in variables}
    symbols = {**stand_ins, **constants, **CONSTANTS, _IDENTITY: IDENTITY}
    evaluator, tree = Evaluator(text, symbols, of_tensors=True), syntax_tree(text)
    if is_tensor(evaluator.value(tree)):
        message = (
            f"{what} has to be a scalar, but this expression is a tensor; tr, det, norm2 and dot of tensors "
            "are scalars"
        )
        raise ExpressionError(text, tree.col_offset, message)
    if not evaluator.seen & stand_ins.keys():
        message = f"{what} has to read at least one of {', '.join(stand_ins)}"
        raise ExpressionError(text, tree.col_offset, message)
    return EnergyExpression(text, constants, tree)


def custom_material(
    variables: Annotated[Sequence[str], Quantity(example=["F", "J"])],
    energy: Annotated[EnergyText, Quantity("Pa", example="3*norm2(F)/J**(2/3) + 4*(J + 1/J)")],
    parameters: Annotated[Mapping[str, float] | None, Quantity("any", example={"G": 5.0})] = None,
    per: Literal["volume", "referential volume", "mass"] = "volume",
    rho_R: Annotated[float | None, Quantity("kg/m^3", "> 0", 1000.0)] = None,
) -> Material:
    """A custom material: any variables, and an energy as an expression of them.

    Raises ParameterError for an invalid variable, an invalid energy (with the position in the text), or an
    energy that depends on the observer (with the rotation that shows it).

    Parameters
    ----------
    variables : sequence of str
        Carried variables: F, H = cof(F), B = F*trans(F), N = cof(F*trans(F)), J = det(F), A = 1/J, K =
        log(J)/J, the small strain E; a tensor with a power of J, "H = J**(-5/6)*F"; and conserved amounts per
        actual volume, such as a solute's "c = amount", zero unless [initial] gives them.
    energy : str
        Stored energy as an expression of the variables; in J/kg with per = "mass".
    parameters : mapping of names to numbers, optional
        Numbers that the energy reads by name, without conversion of units.
    per : str
        Measure to which the energy refers: "volume" (actual), "referential volume" or "mass"; with
        "referential volume" and "mass" the carried variables are the tensors divided by J, and A = 1/J.
    rho_R : float, optional
        Density where J = 1, needed by an energy per mass.  This density determines the initial density from
        the initial J, or the initial J from the initial density.
    """
    carried = tuple(_variable(text) for text in require_names("Custom.variables", variables))
    for name in {v.name for v in carried} & set(_RESERVED):
        raise ParameterError("Custom.variables", name, f"another name than {', '.join(_RESERVED)}")
    if not carried:
        raise ParameterError("Custom.variables", variables, f"at least one variable: {_VARIABLE}")
    expression = _energy("Custom", energy, carried, parameters)
    if per == "mass" and rho_R is None:
        raise ParameterError("Custom.rho_R", None, "the referential density, kg/m^3, for an energy per mass")
    try:
        density = rho_R if per == "volume" else None
        material = CustomMaterial(transported=carried, stored_energy=expression, rho_R=density)
        if per == "volume":
            return material
        if rho_R is None:
            return PerReferentialVolume(material=material)
        return (PerMass if per == "mass" else PerReferentialVolume)(material=material, rho_R=rho_R)
    except ParameterError as error:
        keys: dict[str, tuple[str, object]] = {"rho_R": ("rho_R", rho_R), "stored_energy": ("energy", energy)}
        key, argument = keys.get(error.field.rpartition(".")[2], ("variables", variables))
        raise ParameterError(f"Custom.{key}", argument, error.expected) from error


def isotropic_strain_energy(
    energy: Annotated[EnergyText, Quantity("Pa", example="5*tr(E)**2 + 5*norm2(dev(E))")],
    parameters: Annotated[Mapping[str, float] | None, Quantity("any", example={"G": 5.0})] = None,
) -> IsotropicStrainEnergy:
    """A material with any convex isotropic energy phi(E) of the small strain, as an expression of E.

    Raises ParameterError for an invalid energy (with the position in the text) or one that is not isotropic.

    Parameters
    ----------
    energy : str
        Stored energy per actual volume of the small strain E, isotropic and convex.
    parameters : mapping of names to numbers, optional
        Numbers that the energy reads by name, without conversion of units.
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
        if not name.isidentifier() or name in (*names, *_RESERVED):
            reserved = ", ".join([*names, *_RESERVED])
            expected = f"a name of letters, digits and _ that is none of {reserved}"
            raise ParameterError(f"{owner}.parameters", name, expected)
        if not abs(value) < float("inf"):
            raise ParameterError(f"{owner}.parameters.{name}", value, "a finite number")
        if not re.search(rf"\b{name}\b", text):
            raise ParameterError(f"{owner}.parameters.{name}", value, "only parameters that the energy reads")
    try:
        return parse_energy(text, variables, parameters)
    except ExpressionError as error:
        expected = f"an expression of {', '.join([*names, *(parameters or {}), _IDENTITY])}: {error}"
        raise ParameterError(f"{owner}.energy", text, expected) from error


def _variable(text: str) -> Variable:
    """The variable of a name or of a definition such as "H = J**(-5/6)*F"; raises ParameterError."""
    plain = re.sub(r"\s", "", text)
    if plain.endswith("=amount") and (name := plain.removesuffix("=amount")).isidentifier():
        return Concentration(name=name)
    if plain in _VARIABLES:
        return _VARIABLES[plain]
    match = _DEFINED.fullmatch(plain)
    if match is None or match[3] not in _TENSORS:
        raise ParameterError("Custom.variables", text, _VARIABLE)
    try:
        exponent = number(match[2]) if match[2] else 0.0
        return _TENSORS[match[3]](name=match[1], exponent=exponent)  # type: ignore[call-arg]
    except (ExpressionError, ParameterError) as error:
        expected = f"{_VARIABLE}; the given text has the error: {error}"
        raise ParameterError("Custom.variables", text, expected) from error

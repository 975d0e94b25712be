"""Loads on the matter, gravity and forces per volume; conversion of users' vectors and tensors."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from ngsolve import CF, CoefficientFunction, sqrt, x, y, z

from ngvisco.errors import ParameterError, Quantity, as_number, as_place, require_effect, require_fields

VectorLike: TypeAlias = CoefficientFunction | Sequence[float | CoefficientFunction]


@dataclass(frozen=True)
class Gravity:
    """Gravity acceleration g: the force density rho g (paper: Euler-small-viscoelastodyn+1).

    Parameters
    ----------
    g : sequence of numbers or coefficient functions, or a vector coefficient function
        Acceleration, a component for each dimension; a function of x and of the run's time.
    name : str
        Name of the load. The ledger's column power_<name> has the load's power.

    Attributes
    ----------
    is_weight : bool
        Whether the load is an acceleration, with the force density rho g.
    """

    is_weight: ClassVar[bool] = True
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

    is_weight: ClassVar[bool] = False
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
        The acceleration is proportional to r^exponent: 0 for a constant (a mantle), 1 for the inside of a
        homogeneous ball, -2 for its outside (-1 in 2D). Below 1 the centre must not be in the domain.
    name
        As for ``Gravity``.
    """

    is_weight: ClassVar[bool] = True
    strength: Annotated[float, Quantity("m/s^2", example=9.81)]
    centre: Annotated[tuple[float, ...], Quantity("m", example=[0.0, 0.0])] = (0.0, 0.0)
    radius: Annotated[float, Quantity("m", "> 0", 1.0)] = 1.0
    exponent: Annotated[float, Quantity("1")] = 0.0
    name: str = "gravity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", as_place("CentralGravity.centre", self.centre))
        require_fields(self)
        fault = "with exponent = 0, where the force is the same at every radius"
        require_effect(self, self.exponent != 0, fault, "radius")

    @property
    def g(self) -> CoefficientFunction:
        """The acceleration, a vector of the centre's length."""
        offset = CF(tuple(X - c for X, c in zip((x, y, z), self.centre, strict=False)))
        r = sqrt(offset * offset)
        return -self.strength / self.radius**self.exponent * r ** (self.exponent - 1) * offset


Load = Gravity | CentralGravity | BodyForce


_NAME = re.compile(r"(?!traction_|wall_)[A-Za-z][A-Za-z0-9_]*")
"""Pattern of loads' names: power_<name> is a column, and walls have columns such as power_traction_<wall>."""


def check_name(load: Load) -> None:
    if not (isinstance(load.name, str) and _NAME.fullmatch(load.name)):
        expected = "a name of letters, digits and _, not beginning with traction_ or wall_"
        raise ParameterError(f"{type(load).__name__}.name", load.name, expected)


def as_vector(value: VectorLike, dim: int, field_name: str) -> CoefficientFunction:
    """A vector coefficient function of length ``dim``; raises ParameterError with the field's name."""
    if isinstance(value, CoefficientFunction):
        vector = value
    else:
        # a NumPy array may be a row, (1, n), or a column, (n, 1)
        is_matrix = isinstance(value, np.ndarray) and value.ndim == 2 and 1 in value.shape
        try:
            parts: tuple[Any, ...] = tuple(np.ravel(value) if is_matrix else value)
        except TypeError:
            raise ParameterError(field_name, value, f"a vector with {dim} components") from None
        if not all(isinstance(p, CoefficientFunction) or as_number(p) is not None for p in parts):
            raise ParameterError(field_name, value, "finite numbers or coefficient functions")
        vector = CF(tuple(p if isinstance(p, CoefficientFunction) else float(p) for p in parts) or 0.0)
    if vector.dim != dim:
        raise ParameterError(field_name, value, f"a vector with {dim} components, not {vector.dim}")
    return vector


def force_of(load: Load, dim: int) -> CoefficientFunction:
    """The acceleration g (m/s^2) or the body force (N/m^3) in ``dim`` dimensions; raises ParameterError."""
    owner = f"loads[{load.name!r}]"
    if isinstance(load, CentralGravity) and len(load.centre) != dim:
        expected = f"{dim} numbers, as many as the mesh has dimensions"
        raise ParameterError(f"{owner}.centre", load.centre, expected)
    if isinstance(load, BodyForce):
        return as_vector(load.force, dim, f"{owner}.force")
    return as_vector(load.g, dim, f"{owner}.g")


def as_tensor(value: object, shape: tuple[int, int]) -> CoefficientFunction | None:
    """The tensor of an array, or of rows of numbers and coefficient functions; None for another value."""
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

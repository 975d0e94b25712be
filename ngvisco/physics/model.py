"""The model of a run: a material, its dissipative mechanisms and its loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from ngsolve import CF, CoefficientFunction, sqrt, x, y, z

from ngvisco.errors import ParameterError, _is_number, require_positive
from ngvisco.physics.material import Material, check_material
from ngvisco.physics.regularisation import Regularisation
from ngvisco.physics.rheology import Creep, HyperViscosity, StokesViscosity
from ngvisco.physics.state_function import check_energy

VectorLike: TypeAlias = CoefficientFunction | Sequence[float | CoefficientFunction]


@dataclass(frozen=True)
class Gravity:
    """Gravity acceleration g: the force density rho g (paper: Euler-small-viscoelastodyn+1).

    Parameters
    ----------
    g : sequence of numbers or coefficient functions, or a vector coefficient function
        Acceleration, m/s^2, of the length of the mesh's dimension; a function of x and of the
        run's time ``ngvisco.time``.
    name : str
        Under which the ledger reports its power, ``power_<name>``.
    """

    g: VectorLike
    name: str = "gravity"


@dataclass(frozen=True)
class BodyForce:
    """A force per actual volume, N/m^3, of the length of the mesh's dimension.

    The name is that of the ledger's column, ``power_<name>``.
    """

    force: VectorLike
    name: str = "body_force"


@dataclass(frozen=True, kw_only=True)
class CentralGravity:
    """Gravity towards a centre, g = -strength (r/radius)^exponent e_r, for discs, shells and spheres.

    Parameters
    ----------
    strength : float
        |g| at r = radius, m/s^2; negative is outward.
    centre : sequence of two or three numbers
        m.
    radius : float
        Reference radius, m, > 0.
    exponent : float
        0 is constant (a mantle), 1 is that inside a homogeneous ball, -2 that outside (-1 in 2D).  Below
        1 the centre itself must not be in the domain.
    name : str
        As for ``Gravity``.
    """

    strength: float
    centre: tuple[float, ...] = (0.0, 0.0)
    radius: float = 1.0
    exponent: float = 0.0
    name: str = "gravity"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", tuple(self.centre))
        if len(self.centre) not in (2, 3) or not all(_is_number(c) for c in self.centre):
            raise ParameterError("CentralGravity.centre", self.centre, "two or three finite numbers")
        for field_name, value in (("strength", self.strength), ("exponent", self.exponent)):
            if not _is_number(value):
                raise ParameterError(f"CentralGravity.{field_name}", value, "a finite number")
        require_positive(self, radius=self.radius)

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

    Parameters
    ----------
    material : Material
    viscosity : StokesViscosity, optional
    hyperviscosity : HyperViscosity, optional
    creep : Creep, optional
        None (default) is the Kelvin-Voigt rheology, otherwise Jeffreys in the deviatoric part.
    loads : sequence of Gravity, CentralGravity or BodyForce
    regularisation : Regularisation, optional
        None (default) is none of the paper's regularising terms.

    Raises
    ------
    ParameterError
        If a part is of the wrong type, two loads share a name, or the material's list of variables
        makes no sense.
    """

    material: Material
    viscosity: StokesViscosity | None = None
    hyperviscosity: HyperViscosity | None = None
    creep: Creep | None = None
    loads: tuple[Load, ...] = field(default=())
    regularisation: Regularisation | None = None

    def __post_init__(self) -> None:
        for name, kind in (
            ("material", Material),
            ("viscosity", StokesViscosity),
            ("hyperviscosity", HyperViscosity),
            ("creep", Creep),
            ("regularisation", Regularisation),
        ):
            value = getattr(self, name)
            if not (isinstance(value, kind) or (value is None and name != "material")):
                raise ParameterError(f"Model.{name}", value, f"a {kind.__name__}")
        if not isinstance(self.loads, (tuple, list)):
            raise ParameterError("Model.loads", self.loads, "a sequence of Gravity or BodyForce objects")
        object.__setattr__(self, "loads", tuple(self.loads))
        for load in self.loads:
            if not isinstance(load, (Gravity, CentralGravity, BodyForce)):
                raise ParameterError("Model.loads", load, "Gravity, CentralGravity or BodyForce objects")
        names = [load.name for load in self.loads]
        if len(set(names)) < len(names):
            raise ParameterError("Model.loads", names, "distinct names")
        check_material(self.material)
        check_energy(self.material)


def as_vector(value: VectorLike, dim: int, field_name: str) -> CoefficientFunction:
    """A vector coefficient function of length ``dim``, or ParameterError naming the field."""
    if isinstance(value, CoefficientFunction):
        vector = value
    else:
        try:
            parts: tuple[Any, ...] = tuple(value)
        except TypeError:
            raise ParameterError(field_name, value, f"a vector of length {dim}") from None
        if not all(isinstance(p, CoefficientFunction) or _is_number(p) for p in parts):
            raise ParameterError(field_name, value, "finite numbers or coefficient functions")
        vector = CF(parts)
    if vector.dim != dim:
        raise ParameterError(field_name, value, f"a vector of length {dim}, not {vector.dim}")
    return vector

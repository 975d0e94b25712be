"""What holds on a wall.  Every wall is impenetrable, v.n = 0; these say what its tangential part does.

The tangential part of a vector is a_t = a - (a.n) n.  Names of walls are the mesh's boundary names.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, Quantity, as_number
from ngvisco.physics.heat import WallHeat
from ngvisco.physics.model import VectorLike
from ngvisco.physics.parameters import require_ranges


@dataclass(frozen=True)
class Wall:
    """Base of all wall conditions.

    Parameters
    ----------
    heat : WallHeat, optional
        Heat through the wall, of materials with a temperature; insulated where nothing is said.
    """

    straight = False
    """Whether straight facets are meant, see ``Slip``."""
    heat: WallHeat | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Slip(Wall):
    """v.n = 0 and no tangential stress (paper: Euler-small-BC-hyper); the default everywhere.

    Parameters
    ----------
    straight : bool
        Straight facets of this wall are meant, though they meet at an angle. Those that meet at less than 60
        degrees are refused otherwise: where they approach a curved wall, slip turns into no slip.
    """

    straight: Annotated[bool, Quantity(example=True)] = False


@dataclass(frozen=True)
class NoSlip(Wall):
    """v = 0."""


@dataclass(frozen=True)
class PrescribedTangential(Wall):
    """v = V on the wall, V tangential: a sliding lid, a rotating cylinder.

    Parameters
    ----------
    velocity : vector of the mesh's dimension
        V, the velocity of the wall, a function of x and of the run's time, of which each step has the mean.
        V.n must vanish up to the geometry's approximation: walls are not open.
    """

    velocity: Annotated[VectorLike, Quantity("m/s", example=["0.1*y", "-0.1*x"])]


@dataclass(frozen=True, kw_only=True)
class Traction(Wall):
    """Tangential traction f_t - friction v_t (paper: rem-f-ne-0, with its eps for ``friction``).

    Parameters
    ----------
    f : vector of the mesh's dimension
        Tangential traction, a component for each dimension, averaged over the step; its normal part has no
        power and is left out with a warning.
    friction : float
        Traction -friction v_t besides.
    straight
        As for ``Slip``.
    """

    f: Annotated[VectorLike, Quantity("Pa", example=["0.1*sin(t)", 0.0])]
    friction: Annotated[float, Quantity("Pa s/m", ">= 0", 0.1)] = 0.0
    straight: bool = False

    def __post_init__(self) -> None:
        require_ranges(self)


@dataclass(frozen=True)
class NavierFriction(Wall):
    """Tangential stress -coefficient v_t.

    Parameters
    ----------
    coefficient : number or coefficient function
        Tangential stress is -coefficient v_t; it may depend on x.
    straight
        As for ``Slip``.
    """

    coefficient: Annotated[float | CoefficientFunction, Quantity("Pa s/m", ">= 0", 0.1)]
    straight: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.coefficient, CoefficientFunction):
            if self.coefficient.dim != 1:
                shape = f"a function of shape {tuple(self.coefficient.dims)}"
                raise ParameterError(
                    "NavierFriction.coefficient", shape, "a number >= 0 or a scalar function"
                )
            return
        number = as_number(self.coefficient)
        if number is None or number < 0:
            raise ParameterError(
                "NavierFriction.coefficient", self.coefficient, "a number >= 0 or a function"
            )
        object.__setattr__(self, "coefficient", number)

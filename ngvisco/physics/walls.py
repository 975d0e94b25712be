"""What holds on a wall.  Every wall is impenetrable, v.n = 0; these say what its tangential part does.

The tangential part of a vector is a_t = a - (a.n) n.  Names of walls are the mesh's boundary names.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import CoefficientFunction

from ngvisco.errors import ParameterError, as_number, require_nonnegative
from ngvisco.physics.model import VectorLike


class Wall:
    """Base of all wall conditions."""

    straight: bool = False
    """Whether straight facets are meant, see ``Slip``."""


@dataclass(frozen=True)
class Slip(Wall):
    """v.n = 0 and no tangential stress (paper: Euler-small-BC-hyper); the default everywhere.

    Parameters
    ----------
    straight : bool
        The wall really is a polygon or polyhedron.  Straight facets of one wall that meet at less than 60
        degrees are refused otherwise: where they approach a curved wall, slip turns into no slip.
    """

    straight: bool = False


@dataclass(frozen=True)
class NoSlip(Wall):
    """v = 0."""


@dataclass(frozen=True)
class PrescribedTangential(Wall):
    """v = V on the wall, V tangential: a sliding lid, a rotating cylinder.

    Parameters
    ----------
    velocity : vector of the mesh's dimension
        V, m/s, a function of x and of the run's time ``ngvisco.time``, of which each step has the mean.
        V.n must vanish up to the geometry's approximation: walls are not open.
    """

    velocity: VectorLike


@dataclass(frozen=True, kw_only=True)
class Traction(Wall):
    """Tangential traction f_t - friction v_t (paper: rem-f-ne-0, with its eps for ``friction``).

    Parameters
    ----------
    f : vector of the mesh's dimension
        Traction, Pa, a function of x and ``ngvisco.time``, averaged over the step; its normal part has
        no power and is left out, which an ``InputWarning`` says.
    friction : float
        eps >= 0, Pa s/m.
    straight : bool
        As in ``Slip``.
    """

    f: VectorLike
    friction: float = 0.0
    straight: bool = False

    def __post_init__(self) -> None:
        require_nonnegative(self, friction=self.friction)


@dataclass(frozen=True)
class NavierFriction(Wall):
    """Tangential stress -coefficient v_t.

    Parameters
    ----------
    coefficient : number or coefficient function
        Pa s/m, >= 0, may depend on x.
    straight : bool
        As in ``Slip``.
    """

    coefficient: float | CoefficientFunction
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

"""Conditions on a wall.  A wall is impenetrable, v.n = 0, and has a condition for v's tangential part; matter
crosses the walls that are a ``Passage``.

The tangential part of a vector is a_t = a - (a.n) n.  Names of walls are the mesh's boundary names.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.heat import Function, WallHeat
from ngvisco.physics.loads import VectorLike
from ngvisco.physics.parameters import require_fields


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

    def __post_init__(self) -> None:
        require_fields(self)


@dataclass(frozen=True)
class Slip(Wall):
    """v.n = 0 and no tangential stress (paper: Euler-small-BC-hyper); the default everywhere.

    Raises ParameterError if a parameter is of another type.

    Parameters
    ----------
    straight : bool
        Straight facets of this wall are meant, though they meet at an angle. Those that meet at less than 60
        degrees are refused otherwise: where they approach a curved wall, slip turns into no slip.
    """

    straight: Annotated[bool, Quantity(example=True)] = False


@dataclass(frozen=True)
class NoSlip(Wall):
    """v = 0.  Raises ParameterError if ``heat`` is no WallHeat."""


@dataclass(frozen=True)
class PrescribedTangential(Wall):
    """v = V on the wall, V tangential: a sliding lid, a rotating cylinder.

    Raises ParameterError if ``velocity`` is no vector.

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

    Raises ParameterError if a parameter is out of its range.

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


@dataclass(frozen=True)
class NavierFriction(Wall):
    """Tangential stress -coefficient v_t.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    coefficient : number or coefficient function
        Tangential stress is -coefficient v_t; it may depend on x.
    straight
        As for ``Slip``.
    """

    coefficient: Annotated[float | CoefficientFunction, Quantity("Pa s/m", ">= 0", 0.1)]
    straight: bool = False


@dataclass(frozen=True, kw_only=True)
class Passage(Wall):
    """Base of the walls that matter crosses: what flows out has its own values.

    What flows in has the values that are given here by name.  Whatever is not named goes on beyond the wall
    as it is inside, so that the wall does not push a body that is under stress.  A fluid of which nothing is
    named has the volume and the density of the pressure of an ``Open`` wall.
    """

    density: Annotated[Function | None, Quantity("kg/m^3", "> 0", 1.0)] = None
    values: Annotated[Mapping[str, CoefficientFunction], Quantity("1", example={"J": "1 + 0.1*sin(t)"})] = (
        field(default_factory=dict)
    )
    amounts: Annotated[Mapping[str, CoefficientFunction], Quantity("1", example={"water": 1.0})] = field(
        default_factory=dict
    )
    temperature: Annotated[Function | None, Quantity("K", "> 0", 300.0)] = None
    displacement: Annotated[bool, Quantity(example=True)] = False


@dataclass(frozen=True, kw_only=True)
class Inflow(Passage):
    """v = V on the wall, V with a normal part: an inlet.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    velocity : vector of the mesh's dimension
        V, a function of x and of the run's time, of which each step has the mean; matter leaves where
        V.n > 0.
    density : number or coefficient function, optional
        Density of what flows in, averaged over the step; that inside where nothing is said.  Where J or A is
        among the values the density is rho_R/J, of a material with a referential density rho_R; others need
        one.
    values : mapping of names to coefficient functions, optional
        The material's variables of what flows in, by name, averaged over the step; those inside of variables
        that are not named.  Variables of one distortion, as F and J, belong together.
    amounts : mapping of names to coefficient functions, optional
        With bodies, which of them flow in, at rest: by their names n_i, the volumes that they have at rest in
        a unit of volume, 0 where nothing is said. The density is sum rho_i n_i.  Without amounts the bodies
        that are inside go on beyond the wall.
    temperature : number or coefficient function, optional
        Of what flows in, of a material that has one; where nothing is said its entropy is that inside.
    displacement : bool
        Whether the field ``displacement_NAME``, NAME the wall's, is a result: w with dw/dt = v, zero at the
        start (in scripts ``Initial.values["displacement_NAME"]``), so that w.n is the integral of v.n over
        time.  The mesh does not move: w is to be small beside a cell where it stands for the wall's place.
    """

    velocity: Annotated[VectorLike, Quantity("m/s", example=["y*(1 - y)", 0.0])]


@dataclass(frozen=True, kw_only=True)
class PrescribedNormal(Passage):
    """v.n = V on the wall, a piston: the tangential part of v is free and has no stress.

    The mesh does not move: where V < 0 the piston presses, and what it moves comes in through the wall, where
    V > 0 it pulls, and as much leaves.  Its power and the mass that it sweeps are in the ledger.  On walls
    parallel to an axis v.n is a component of v and is V at every point, on others in the mean by the walls'
    multipliers (FORMULATION 12).  Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    velocity : number or coefficient function
        V along the outward normal, a function of x and of the run's time, of which each step has the mean.
    density, values, amounts, temperature, displacement
        As for ``Inflow``.
    """

    velocity: Annotated[Function, Quantity("m/s", example="-0.1*sin(t)")]


@dataclass(frozen=True, kw_only=True)
class Open(Passage):
    """The stress is given and v is free: (T + D) n = f - p n - Z_p (v.n) n - Z_s v_t - k_p (w.n) n - k_s w_t.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    pressure : number or coefficient function
        p, averaged over the step.  A fluid whose one strain is its volume and whose referential density is
        known flows in with the volume and the density that it has at p, where the wall gives no other stress,
        and no density or values; with an entropy where its temperature is given.
    traction : vector of the mesh's dimension, optional
        f, normal part and all, averaged over the step.
    impedance : pair of numbers
        Z_p and Z_s: a dashpot along and across the normal. With density times the speeds of pressure and
        shear waves, plane waves leave.
    stiffness : pair of numbers
        k_p and k_s: springs along and across the normal to a rigid ground, a foundation that gives; w is the
        displacement, a result of walls on springs in any case.
    backflow : bool
        Whether the kinetic energy of what flows in is taken from it, -rho (v.n) |v|^2/2 where v.n < 0:
        without that a given stress may feed such a flow without bound.
    density, values, amounts, temperature, displacement
        As for ``Inflow``.
    """

    pressure: Annotated[Function, Quantity("Pa", example="0.1*sin(t)")] = 0.0
    traction: Annotated[VectorLike | None, Quantity("Pa", example=[0.1, 0.0])] = None
    impedance: Annotated[tuple[float, float], Quantity("Pa s/m", ">= 0", [1.0, 0.5])] = (0.0, 0.0)
    stiffness: Annotated[tuple[float, float], Quantity("Pa/m", ">= 0", [100.0, 0.0])] = (0.0, 0.0)
    backflow: bool = True


MOVING = PrescribedTangential, Inflow, PrescribedNormal
"""Walls whose velocity is given, or its normal part."""
HELD = NoSlip, PrescribedTangential, Inflow
"""Walls on which all of v is prescribed."""

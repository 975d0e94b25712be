"""Conditions on walls.  A wall is impenetrable, v.n = 0, and has a condition for the tangential part of v.
Matter crosses only walls of the class ``Passage``.

The tangential part of a vector is a_t = a - (a.n) n.  Names of walls are the mesh's boundary names.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from ngsolve import CoefficientFunction

from ngvisco.errors import Quantity
from ngvisco.physics.heat import Function, WallHeat
from ngvisco.physics.loads import VectorLike
from ngvisco.physics.parameters import Checked


@dataclass(frozen=True)
class Wall(Checked):
    """Base of all wall conditions.

    Parameters
    ----------
    heat : WallHeat, optional
        Heat through the wall, for materials with a temperature; default insulated.
    """

    straight = False
    """Whether the wall is meant to have straight facets, see ``Slip``."""
    moves: ClassVar[bool] = False
    """Whether the wall has a ``velocity`` that v, or its normal part, is equal to."""
    is_held: ClassVar[bool] = False
    """Whether v is prescribed in full on the wall."""
    heat: WallHeat | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Slip(Wall):
    """v.n = 0 and no tangential stress (paper: Euler-small-BC-hyper); the default for every wall.

    Raises ParameterError if a parameter is of the wrong type.

    Parameters
    ----------
    straight : bool
        Whether the wall is meant to have straight facets that meet at an angle.  If False, facets that meet
        at less than 60 degrees are refused, because on straight facets that approximate a curved wall slip
        turns into no slip.
    """

    straight: Annotated[bool, Quantity(example=True)] = False


@dataclass(frozen=True)
class NoSlip(Wall):
    """v = 0 on the wall.  Raises ParameterError if ``heat`` is no WallHeat."""

    is_held = True


@dataclass(frozen=True)
class PrescribedTangential(Wall):
    """v = V on the wall with V tangential, as on a sliding lid or a rotating cylinder.

    Raises ParameterError if ``velocity`` is not a vector.

    Parameters
    ----------
    velocity : vector of the mesh's dimension
        Velocity V of the wall, a function of x and of the run's time; each step takes its mean.  Matter does
        not cross the wall, so that V.n must vanish up to the geometry's approximation.
    """

    moves = is_held = True
    velocity: Annotated[VectorLike, Quantity("m/s", example=["0.1*y", "-0.1*x"])]


@dataclass(frozen=True, kw_only=True)
class Traction(Wall):
    """Tangential traction f_t - friction v_t (paper: rem-f-ne-0, with its eps for ``friction``).

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    f : vector of the mesh's dimension
        Tangential traction, a component for each dimension, averaged over the step.  A normal part has no
        power and is left out with a warning.
    friction : float
        Coefficient of the further traction -friction v_t.
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
        Coefficient of the tangential stress -coefficient v_t; the coefficient may depend on x.
    straight
        As for ``Slip``.
    """

    coefficient: Annotated[float | CoefficientFunction, Quantity("Pa s/m", ">= 0", 0.1)]
    straight: bool = False


@dataclass(frozen=True, kw_only=True)
class Passage(Wall):
    """Base of the walls that matter crosses; matter flows out with its own values.

    Matter flows in with the values given here by name.  A variable without a given value has its inner value
    beyond the wall too, so that the wall does not push a body under stress.  If no value is given to a fluid,
    it flows in through an ``Open`` wall with the volume and the density at the wall's pressure.
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
    """v = V on the wall; V has a normal part, as at an inlet.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    velocity : vector of the mesh's dimension
        Velocity V, a function of x and of the run's time; each step takes its mean.  Matter leaves where V.n
        > 0.
    density : number or coefficient function, optional
        Density of the inflow, averaged over the step; default the density inside.  If J or A is among
        ``values``, the density of a material with a referential density rho_R is rho_R/J, and any other
        material needs a density.
    values : mapping of names to coefficient functions, optional
        Values of the material's variables in the inflow, by name, averaged over the step; default the inner
        values.  Values of variables of one distortion, such as F and J, must fit together.
    amounts : mapping of names to coefficient functions, optional
        Bodies that flow in, at rest: amounts n_i by the bodies' names. An amount is the volume at rest per
        actual volume, and is 0 for a body that is not named.  The density of the inflow is sum rho_i n_i.
        Without amounts the bodies inside flow in.
    temperature : number or coefficient function, optional
        Temperature of the inflow, for a material with heat. By default matter flows in with the entropy
        inside.
    displacement : bool
        Whether the field ``displacement_NAME`` of the wall NAME is a result. The field is w with dw/dt = v,
        zero at the start (in scripts ``Initial.values["displacement_NAME"]``); w.n is the integral of v.n
        over time.  The mesh does not move: if w stands for a displacement of the wall, w has to be small
        compared with a cell.
    """

    moves = is_held = True
    velocity: Annotated[VectorLike, Quantity("m/s", example=["y*(1 - y)", 0.0])]


@dataclass(frozen=True, kw_only=True)
class PrescribedNormal(Passage):
    """v.n = V on the wall, as on a piston; the tangential part of v is free, without tangential stress.

    The mesh does not move. Where V < 0 the piston presses, and matter comes in through the wall. Where V > 0
    it pulls, and matter leaves.  The ledger has the piston's power and the mass that it sweeps.  On walls
    parallel to an axis v.n is a component of v and equals V at every point. On other walls v.n equals V in
    the mean, by the walls' multipliers (FORMULATION 12).  Raises ParameterError if a parameter is out of its
    range.

    Parameters
    ----------
    velocity : number or coefficient function
        Velocity V along the outward normal, a function of x and of the run's time; each step takes its mean.
    density, values, amounts, temperature, displacement
        As for ``Inflow``.
    """

    moves = True
    velocity: Annotated[Function, Quantity("m/s", example="-0.1*sin(t)")]


@dataclass(frozen=True, kw_only=True)
class Open(Passage):
    """A wall of given stress and free v: (T + D) n = f - p n - Z_p (v.n) n - Z_s v_t - k_p (w.n) n - k_s w_t.

    The wall stays in its place and keeps its normal. Hence no force is proportional both to the displacement
    of a surface and to the stress or the weight beneath it. Between such walls a compressed column does not
    buckle, tension does not stiffen a strip, and gravity makes no surface waves.

    Raises ParameterError if a parameter is out of its range.

    Parameters
    ----------
    pressure : number or coefficient function
        Pressure p, averaged over the step.  If the wall gives no other stress, no density and no values, a
        fluid flows in with its volume and density at p. This needs a fluid whose only strain is the volume,
        and whose referential density is known; if it has an entropy, the wall has to give a temperature.
    traction : vector of the mesh's dimension, optional
        Traction f, with its normal part, averaged over the step.
    impedance : pair of numbers
        Z_p and Z_s of dashpots along and across the normal.  Plane waves leave if Z_p and Z_s are the density
        times the speeds of pressure and shear waves.
    stiffness : pair of numbers
        k_p and k_s of springs, along and across the normal, to a rigid ground (an elastic foundation).  The
        displacement w of a wall on springs is always a result.
    backflow : bool
        Whether the kinetic energy that an inflow brings, -rho (v.n) |v|^2/2 where v.n < 0, is taken from the
        flow.  With False a given stress may feed an inflow without bound.
    density, values, amounts, temperature, displacement
        As for ``Inflow``.
    """

    pressure: Annotated[Function, Quantity("Pa", example="0.1*sin(t)")] = 0.0
    traction: Annotated[VectorLike | None, Quantity("Pa", example=[0.1, 0.0])] = None
    impedance: Annotated[tuple[float, float], Quantity("Pa s/m", ">= 0", [1.0, 0.5])] = (0.0, 0.0)
    stiffness: Annotated[tuple[float, float], Quantity("Pa/m", ">= 0", [100.0, 0.0])] = (0.0, 0.0)
    backflow: bool = True

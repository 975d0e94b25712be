"""Bodies of different materials in one domain: their laws, their carried densities and their initial places.

Body i carries densities per actual volume, transported by their flux: its amount n_i, X_i = n_i B for each
tensor of its energy, and K_i = n_i k if it hardens.  The volume fractions are theta_i = n_i/sum n_j.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import Annotated, Any, Protocol, TypeAlias, runtime_checkable

from ngsolve import CoefficientFunction, Det

from ngvisco.errors import ParameterError, Quantity, as_number, require_fields
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.heat import Heat
from ngvisco.physics.material import Material
from ngvisco.physics.materials.network import rules_of
from ngvisco.physics.parameters import renamed, told_apart
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import IDENTITY, Tensor, if_positive, opening, shear_across, sqrt
from ngvisco.physics.variables import CreepFrame, PerVolume, Values, Variable

NO_INTERFACE = 1e-6
"""Least change over a cell with an interface, of a fraction, a relative compliance or an averaged logarithm.
The slope of a smaller change is rounding, and its direction has no meaning."""

TRACE = 1e-3
"""Amount, as a share of all matter, that takes the place of the amount of an absent body; it is at rest."""

BACKING_TRACE = 0.1
"""Share of all matter, N, that is added to the amount n_i of a body that hardens or breaks. The sum has two
uses. It is the divisor of K_i, an independent polynomial that need not vanish with n_i. It is also the weight
of the energy of cracks; this weight must be positive, so that the energy is convex in the damage."""

_NOTHING = 1e-12
"""Weight of a layered body at a point without layered bodies, where the mean modulus has no meaning."""

_HALF = 1 / 5
"""The volume fraction theta_i at which chi_i is 1/2."""

AMOUNT = "n_"
"""Prefix of the names of the bodies' amounts."""


@runtime_checkable
class Region(Protocol):
    """A region of space.  The shapes are in ``ngvisco.shapes``, because physics knows no mesh."""

    def level(self, at: Any) -> Any:
        """A number at each place, > 0 inside."""

    def inside(self, mesh: Any) -> Any:
        """The fraction, in [0, 1], of a point's surroundings that lies inside."""


StartPlace: TypeAlias = Tensor | Region
"""A function of x, y, z that is > 0 inside, or a shape."""


@dataclass(frozen=True)
class Amount(PerVolume):
    """n_i, the volume that body i has in its reference state per actual volume: dt n_i + div(n_i v) = 0.

    The amount is conserved, and with it the body's mass int rho_i n_i; no strain determines it.
    """

    density: float = 1.0
    """rho_i of the reference state, kg/m^3."""
    share: float = field(default=0.5, compare=False)
    """The volume fraction of the body in sampled states, in which all bodies have equal fractions."""

    is_conserved = True

    def from_distortion(self, F: Tensor) -> Tensor:
        return self.share / Det(F)

    def positive(self, value: Tensor) -> Values:
        return {self.name: value}


@dataclass(frozen=True)
class Content(Variable):
    """X_i = n_i B of body i; B is a tensor J^a F, J^a Cof F, J^a F F^T or J^a Cof(F F^T) of its distortion.

    The rate of X_i is the rate of ``tensor``. This tensor has the exponent a - 1, because n_i is 1/J where
    the body fills the point, and the variable's name. The rate is linear.
    """

    name: str
    kind: str
    tensor: Variable
    share: float = field(default=0.5, compare=False)

    by_flux = True

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return self.tensor.rate(z, L, Pi)

    def from_distortion(self, F: Tensor) -> Tensor:
        return self.share * self.tensor.from_distortion(F)

    def positive(self, value: Tensor) -> Values:
        return self.tensor.positive(value)

    @property
    def frame(self) -> CreepFrame | None:
        return self.tensor.frame

    @property
    def power(self) -> float | None:
        """The exponent p of det B = J^p for matter whose creep rate has no trace; None for a scalar B."""
        ratio = self.tensor.volume_ratio(IDENTITY)
        return None if ratio is None else ratio[1] + 3

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return self.tensor.turned(value, Q)


@dataclass(frozen=True)
class Fractions:
    """The volume fractions theta_i of bodies, from their amounts."""

    bodies: tuple[str, ...]

    def total(self, z: Values) -> Any:
        """N = sum n_i, the inverse of the volume of the matter at a point."""
        return reduce(add, (z[AMOUNT + name] for name in self.bodies))

    def at(self, z: Values) -> dict[str, Any]:
        """The fractions theta_i at a point with the values ``z``, by the bodies' names; their sum is one."""
        inverse = 1 / self.total(z)
        return {name: z[AMOUNT + name] * inverse for name in self.bodies}

    def not_negative(self, z: Values) -> dict[str, Any]:
        """Volume fractions by the bodies' names. Zero replaces a negative theta_i, an undershoot beside a
        jump."""
        return {name: if_positive(value, value, 0.0 * value) for name, value in self.at(z).items()}

    def taking_part(self, z: Values) -> dict[str, Any]:
        """The factor chi_i of each body, smooth in theta_i: 0 at theta_i <= 0, 1/2 at 1/5, 0.996 at 1/2."""
        factors = {}
        for name, theta in self.at(z).items():
            complement, share = 1 - theta, (1 / _HALF - 1) * if_positive(theta, theta, 0.0 * theta)
            complement, share = complement * complement, share * share
            complement, share = complement * complement, share * share
            factors[name] = share / (complement + share)
        return factors

    def behind_planes(self, z: Values) -> dict[str, Any]:
        """The factor chi_i of each body in cells that interfaces cut: theta_i^3 / sum theta_j^4, with
        negative theta_j replaced by zero.

        The sum of chi_i theta_i is one: each body ends where its fraction is 1/2, and no part of the strain
        counts twice.
        """
        fractions = self.not_negative(z)
        cubes = {name: theta * theta * theta for name, theta in fractions.items()}
        inverse = 1 / reduce(add, (cubes[name] * theta for name, theta in fractions.items()))
        return {name: cube * inverse for name, cube in cubes.items()}

    def positive(self, z: Values, body: str) -> Any:
        """The fraction theta_i of one body, smoothed so that it is > 0: about ``TRACE`` at theta_i = 0."""
        value = z[AMOUNT + body] / self.total(z)
        return 0.5 * (value + sqrt(value * value + 4 * TRACE**2))

    def backed(self, z: Values, body: str) -> Any:
        """The amount n_i of a body plus a trace of N, so that it is > 0. It is the divisor of K_i in the
        body's plastic strain, and the weight of its cracks' energy."""
        return (1 / (1 + BACKING_TRACE)) * (z[AMOUNT + body] + BACKING_TRACE * self.total(z))


@dataclass(frozen=True)
class Interface:
    """A quantity that has one value in each body. The slope of its mean has the direction of the interfaces'
    normals."""

    values: tuple[tuple[str, float], ...]
    """Pairs of a body's name and its value of the quantity."""
    fractions: Fractions

    def mean(self, z: Values) -> Any:
        """The mean of the values, weighted by the volume fractions."""
        theta = self.fractions.at(z)
        return reduce(add, (value * theta[name] for name, value in self.values))


@dataclass(frozen=True)
class Parting:
    """The law by which bodies part: the opening of an interface strains the more compressible matter, and not
    the bodies.

    In a cell with the interface's normal n, body i has the strain rate D_i = D - o_i opening(D, n x n). The
    body keeps the share r_i = 1 - o_i of a change of volume along n, and of shear across n. The compliance
    1/K_i at rest, divided by the mean sum theta_j/K_j, is r_i: the bodies have one pressure, so that r_i is
    the body's share of the change of volume.
    """

    stiffnesses: tuple[tuple[str, float], ...]
    """Pairs of a body's name and its bulk modulus K_i at rest, Pa."""
    bodies: frozenset[str]
    """Names of the bodies that part."""

    motion = staticmethod(opening)
    """The part of D that is not common to the bodies."""

    @property
    def fractions(self) -> Fractions:
        return Fractions(tuple(name for name, _ in self.stiffnesses))

    @property
    def interface(self) -> Interface:
        """The interface whose quantity is the compliance, relative to that of the softest body."""
        least = min(K for _, K in self.stiffnesses)
        return Interface(tuple((name, least / K) for name, K in self.stiffnesses), self.fractions)

    def shares(self, z: Values) -> dict[str, Any]:
        """The openings' shares o_i that do not strain the bodies, by the names of the bodies that part."""
        theta = self.fractions.not_negative(z)
        compliances = (1 / K * theta[name] for name, K in self.stiffnesses)
        mean = reduce(add, theta.values()) / reduce(add, compliances)
        return {name: 1 - 1 / K * mean for name, K in self.stiffnesses if name in self.bodies}


@dataclass(frozen=True)
class Layers:
    """The law of layered bodies side by side in a cell: they bear one shear traction across their interface.

    In a cell with the interface's normal n, body i has the strain rate D_i = D - o_i S.  Here S is the shear
    of D across n, and 1 - o_i = H/G_i.  G_i is the shear modulus at rest; 1/H is the mean of 1/G_i with the
    weights chi_i theta_i.  For small strains the stress of the cell is 2 H S across n.  Bodies that are
    missing in ``stiffnesses`` have the strain rate D.
    """

    stiffnesses: tuple[tuple[str, float], ...]
    """Pairs of a layered body's name and its shear modulus G_i, Pa."""
    fractions: Fractions
    factors: Callable[[Values], dict[str, Any]]
    """The bodies' factors chi_i by names, before ``scaled``."""

    motion = staticmethod(shear_across)
    """The part of D that is not common to the bodies."""

    @property
    def interface(self) -> Interface:
        """The interface whose quantity is the relative compliance; other bodies count as the softest one."""
        G = dict(self.stiffnesses)
        least = min(G.values())
        return Interface(tuple((n, least / G.get(n, least)) for n in self.fractions.bodies), self.fractions)

    def shares(self, z: Values) -> dict[str, Any]:
        """The shares o_i of the shear across an interface that do not strain the bodies, by their names."""
        theta, chi = self.fractions.not_negative(z), self.factors(z)
        weights = {name: chi[name] * theta[name] + _NOTHING for name, _ in self.stiffnesses}
        compliance = reduce(add, (1 / G * weights[name] for name, G in self.stiffnesses))
        H = reduce(add, weights.values()) / compliance
        return {name: 1 - 1 / G * H for name, G in self.stiffnesses}

    def scaled(self, z: Values) -> dict[str, Any]:
        """The factors chi_i divided by sqrt(sum theta_j chi_j^2). With these factors, solids of one shear
        modulus have this modulus at each point."""
        theta, chi = self.fractions.not_negative(z), self.factors(z)
        scale = 1 / sqrt(reduce(add, (theta[name] * factor * factor for name, factor in chi.items())))
        return {name: scale * factor for name, factor in chi.items()}


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body of one material, with its place at the start.

    Example::

        import ngvisco as nv
        from ngvisco.geometries import box
        from ngvisco.physics.variables import Jacobian

        viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
        soft = nv.ReferentialNeoHookean(K_e=20.0, G_e=0.05)
        U = lambda J: 10 * (J - 1) * (J - 1) / J
        fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=U)
        place = nv.Ball((0.6, 0.5), 0.2)
        disc = nv.Body(name="disc", where=place, material=soft, viscosity=viscosity, density=1.0)
        rest = nv.Body(name="rest", material=fluid, viscosity=viscosity, density=1.0)
        run = nv.Simulation(box((1, 1), maxh=0.3), nv.Model(bodies=[disc, rest]), dt=0.02)
        print(run.advance()["mass_drift"])

    Bodies whose energies have different stresses at rest, F = I, push each other from the start; an
    ``InputWarning`` names such bodies if they meet.  Raises ParameterError for an invalid name, a part of the
    wrong type, and a density that is missing or not positive.

    Parameters
    ----------
    name : str
        Letters, digits and _; names of the body's fields and columns begin with it.
    where : Tensor or ngvisco.shapes.Shape, optional
        Initial place of the body: a shape, or the region where a function of x, y, z is > 0; in case files a
        shape, a condition, or a list of shapes and conditions, whose union is the place.  A body without a
        place fills the region that no other body covers; at most one body may have no place.
    material : Material
        The body's material, in case files with the keys of [material].
    viscosity : Viscosity, optional
        The body's viscosity, in case files with the keys of [rheology.viscosity].
    creep : FlowRule, optional
        The body's flow rule, in case files with the keys of [rheology.creep]. A body of a network has None,
        because the network's branches have their own rules.
    heat : Heat, optional
        The body's conductivity and heat source, in case files with the keys of [rheology.heat]; conductivity
        and source are weighted by the body's fraction, and add to those of [rheology.heat].  All bodies at a
        point have one temperature.
    density : float, optional
        Density where J = 1; the default is rho_R of the material.
    parts : bool
        Whether the body separates from more compressible matter, as a solid in a light gas separates from a
        wall.  In cells that body and gas share, a change of volume strains the body along the interface's
        normal by the body's own compliance alone. Shear across the interface does not strain the body there
        (FORMULATION.md, Section 9).  Shared cells then resist compression by the bulk modulus alone, so that
        two discs of four cells across do not rebound.  The option is for bodies that are many cells across.
    layered : bool
        Whether the body and other layered elastic bodies bear one shear traction in the cells that they
        share, like layers on each other, instead of one strain rate (FORMULATION.md, Section 9).
        ``nv.gradient`` refuses layered bodies.
    order : int
        The body of higher order fills the overlap of two bodies at the start.  Bodies of one order must not
        overlap.  The body without a place is below all others and has no order.
    """

    name: Annotated[str, Quantity(example="disc")]
    where: StartPlace | None = field(default=None, repr=False)  # used for the start only
    material: Material
    viscosity: Viscosity | None = None
    creep: FlowRule | None = None
    heat: Heat | None = None
    density: Annotated[float | None, Quantity("kg/m^3", "> 0", 1000.0)] = None
    parts: bool = False
    layered: bool = False
    order: int = 0

    @property
    def rules(self) -> dict[str | None, FlowRule]:
        """Flow rules of the body by the branches of its network; the key is None for a body without a
        network."""
        return {name: rule for name, rule in rules_of(self.material, self.creep).items() if rule.flows}

    def with_own_names(self) -> Body:
        """The body, with its name as a prefix of the parameters made of its moduli."""
        names = ("material", "viscosity", "creep")
        apart = told_apart(getattr(self, name) for name in names)
        laws = {name: renamed(law, f"{self.name}_") for name, law in zip(names, apart, strict=True)}
        return replace(self, **{name: law for name, law in laws.items() if law is not getattr(self, name)})

    def __post_init__(self) -> None:
        is_name = isinstance(self.name, str) and re.fullmatch(r"[A-Za-z]\w{0,59}", self.name, re.ASCII)
        if not is_name:
            raise ParameterError("Body.name", self.name, "a letter, and then letters, digits and _")
        owner = f"bodies[{self.name!r}]"
        require_fields(self, owner)
        is_place = isinstance(self.where, (CoefficientFunction, Region)) and not isinstance(self.where, type)
        if not (self.where is None or is_place):
            expected = "a function of x, y, z that is > 0 inside, or a shape, or None"
            raise ParameterError(f"{owner}.where", self.where, expected)
        if isinstance(self.where, CoefficientFunction) and (self.where.dim != 1 or self.where.is_complex):
            raise ParameterError(f"{owner}.where", self.where, "a real scalar function of x, y, z")
        density = as_number(self.material.referential_density if self.density is None else self.density)
        if density is None or density <= 0:
            expected = (
                "a number > 0, kg/m^3, since a body has mass (the default is the rho_R of the material)"
            )
            raise ParameterError(f"{owner}.density", self.density, expected)
        object.__setattr__(self, "density", density)
        if self.where is None and self.order != 0:
            expected = "0 without a place, since the body then takes what all other bodies leave"
            raise ParameterError(f"{owner}.order", self.order, expected)

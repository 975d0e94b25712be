"""Bodies of different material in one domain: what each of them is and carries, and where it is at the start.

Body i carries densities per actual volume by their flux: its amount n_i and, where it has tensors,
X_i = n_i B, and where it hardens K_i = n_i k.  theta_i = n_i/sum n_j are fractions.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import reduce
from operator import add
from typing import Annotated, Any, Protocol, TypeAlias, runtime_checkable

from ngsolve import CoefficientFunction, Det

from ngvisco.errors import ParameterError, Quantity, as_number, require_fields
from ngvisco.physics.flow_rules import FlowRule
from ngvisco.physics.heat import Heat
from ngvisco.physics.material import Material, part_of
from ngvisco.physics.materials.network import Network
from ngvisco.physics.rheology import Viscosity
from ngvisco.physics.tensors import Tensor, if_positive, sqrt, tr
from ngvisco.physics.variables import Frame, Values, Variable

TRACE = 1e-3
"""The amount of an absent body that is left as a trace of matter at rest, over the amount of all matter."""

HARDENING_TRACE = 0.1
"""The trace of all matter in a body that hardens: K_i and n_i are polynomials each by itself, and K_i/n_i is
none."""

_HALF = 1 / 5
"""The fraction at which matter takes half a part."""

AMOUNT = "n_"
"""The beginning of the name of a body's amount."""


@runtime_checkable
class Region(Protocol):
    """A region of space.  The run has shapes for it (``ngvisco.shapes``); physics knows no mesh."""

    def level(self, at: Any) -> Any:
        """A number at each place, > 0 inside."""

    def inside(self, mesh: Any) -> Any:
        """The share of a point's surroundings that is inside, in [0, 1]."""


Where: TypeAlias = Tensor | Region
"""A function of x, y, z that is > 0 inside, or a shape."""


@dataclass(frozen=True)
class Amount(Variable):
    """n_i, the volume that body i has in its reference state per actual volume: dt n_i + div(n_i v) = 0.

    It is conserved, and with it the mass of the body, int rho_i n_i.  It is no function of a strain.
    """

    name: str
    kind: str = "scalar"
    density: float = 1.0
    """rho_i of the reference state, kg/m^3."""
    share: float = field(default=0.5, compare=False)
    """The body's share at a point that stands for all states, where there is as much of each body."""

    is_conserved = True

    def rate(self, z: Values, L: Tensor, Pi: Tensor) -> Tensor:
        return -tr(L) * z[self.name]

    def from_distortion(self, F: Tensor) -> Tensor:
        return self.share / Det(F)

    def positive(self, value: Tensor) -> Values:
        return {self.name: value}


@dataclass(frozen=True)
class Content(Variable):
    """X_i = n_i B of body i, B a tensor J^a F, J^a Cof F, J^a F F^T or J^a Cof(F F^T) of its distortion.

    Its rate is that of ``tensor``, which has the exponent a - 1 and the name of this variable: n_i = 1/J
    where there is nothing but the body, and the rate is linear.
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
    def frame(self) -> Frame | None:
        return self.tensor.frame

    def turned(self, value: Tensor, Q: Tensor) -> Tensor:
        return self.tensor.turned(value, Q)


@dataclass(frozen=True)
class Fractions:
    """theta_i of the amounts of bodies, by name."""

    bodies: tuple[str, ...]

    def total(self, z: Values) -> Any:
        """N = sum n_i, the inverse of the volume of the matter at a point."""
        return reduce(add, (z[AMOUNT + name] for name in self.bodies))

    def at(self, z: Values) -> dict[str, Any]:
        """theta_i at a point with the values ``z``, by the bodies' names; their sum is one."""
        inverse = 1 / self.total(z)
        return {name: z[AMOUNT + name] * inverse for name in self.bodies}

    def not_negative(self, z: Values) -> dict[str, Any]:
        """Volume fractions, with zero where theta_i < 0, as polynomials beside a jump are."""
        return {name: if_positive(value, value, 0.0 * value) for name, value in self.at(z).items()}

    def taking_part(self, z: Values) -> dict[str, Any]:
        """chi of each body, smooth: 0 where there is none of it, 1/2 at a fifth, 0.996 at a half."""
        found = {}
        for name, theta in self.at(z).items():
            others, own = 1 - theta, (1 / _HALF - 1) * if_positive(theta, theta, 0.0 * theta)
            others, own = others * others, own * own
            others, own = others * others, own * own
            found[name] = own / (others + own)
        return found

    def positive(self, z: Values, body: str) -> Any:
        """theta_i of one body, smooth and > 0: of what is less than ``TRACE`` about that."""
        value = z[AMOUNT + body] / self.total(z)
        return 0.5 * (value + sqrt(value * value + 4 * TRACE**2))

    def hardened(self, z: Values, body: str) -> Any:
        """The amount that the plastic strain of a body is that of: n_i, and a trace of N."""
        return (1 / (1 + HARDENING_TRACE)) * (z[AMOUNT + body] + HARDENING_TRACE * self.total(z))


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body of one material, with its place at the start.

    Example::

        import ngvisco as nv
        from ngvisco.geometries import box
        from ngvisco.physics.variables import Jacobian

        viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
        soft = nv.ReferentialNeoHookean(K_e=20.0, G_e=0.05)
        fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 10 * (J - 2 + 1 / J))
        place = nv.Ball((0.6, 0.5), 0.2)
        disc = nv.Body(name="disc", where=place, material=soft, viscosity=viscosity, density=1.0)
        rest = nv.Body(name="rest", material=fluid, viscosity=viscosity, density=1.0)
        run = nv.Simulation(box((1, 1), maxh=0.3), nv.Model(bodies=[disc, rest]), dt=0.02)
        print(run.advance()["mass_drift"])

    Energies whose stress at rest, F = I, differs from body to body push each other from the start, which an
    ``InputWarning`` says of bodies that meet.  Raises ParameterError for a name that is none, a part of the
    wrong type, and a density that is missing or not positive.

    Parameters
    ----------
    name : str
        Letters, digits and _; fields and columns of the body begin with it.
    where : Tensor or ngvisco.shapes.Shape, optional
        Where the body is at the start: a shape, or where a function of x, y, z is > 0; in case files a shape,
        a condition, or several of which it is the union.  Without a place the body is the rest, what no other
        covers; one at most may be.
    material : Material
        Its material, in case files with the keys of [material].
    viscosity : Viscosity, optional
        Its viscosity, in case files with the keys of [rheology.viscosity].
    creep : FlowRule, optional
        Its creep, in case files with the keys of [rheology.creep]; None with a network, whose branches have
        theirs.
    heat : Heat, optional
        Its conductivity and heat source, in case files with the keys of [rheology.heat], to which they add by
        its fraction; the temperature is one for all bodies at a point.
    density : float, optional
        Density where J = 1; that of its material where this has rho_R.
    order : int
        Of two bodies that overlap at the start the one of higher order is there; those of the same order must
        not overlap, and the rest, which is below all others, has none.
    """

    name: Annotated[str, Quantity(example="disc")]
    where: Where | None = field(default=None, repr=False)  # of the start alone, not of what the body is
    material: Material
    viscosity: Viscosity | None = None
    creep: FlowRule | None = None
    heat: Heat | None = None
    density: Annotated[float | None, Quantity("kg/m^3", "> 0", 1000.0)] = None
    order: int = 0

    @property
    def rules(self) -> dict[str | None, FlowRule]:
        """Flow rules of the body by the branches of its network; the key is None for a body without a
        network."""
        network = part_of(self.material, Network)
        rules = {None: self.creep} if network is None else {n: b.creep for n, b in network.parts.items()}
        return {name: rule for name, rule in rules.items() if rule is not None and rule.flows}

    def __post_init__(self) -> None:
        is_name = isinstance(self.name, str) and re.fullmatch(r"[A-Za-z]\w{0,59}", self.name, re.ASCII)
        if not is_name:
            raise ParameterError("Body.name", self.name, "a letter, and then letters, digits and _")
        owner = f"bodies[{self.name!r}]"
        require_fields(self, owner)
        is_place = isinstance(self.where, (CoefficientFunction, Region)) and not isinstance(self.where, type)
        if not (self.where is None or is_place):
            expected = "a function of x, y, z that is > 0 inside, a shape, or None"
            raise ParameterError(f"{owner}.where", self.where, expected)
        if isinstance(self.where, CoefficientFunction) and (self.where.dim != 1 or self.where.is_complex):
            raise ParameterError(f"{owner}.where", self.where, "a real scalar function of x, y, z")
        density = as_number(self.material.referential_density if self.density is None else self.density)
        if density is None or density <= 0:
            expected = "a number > 0, kg/m^3: a body has mass (of a material with rho_R that is the default)"
            raise ParameterError(f"{owner}.density", self.density, expected)
        object.__setattr__(self, "density", density)
        if self.where is None and self.order != 0:
            expected = "0 without a place: the rest is below all others"
            raise ParameterError(f"{owner}.order", self.order, expected)

"""What the terms of a step share: unknown and old fields, step length, upwinding, integrands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar, runtime_checkable

from ngsolve import (
    EDGE,
    FACE,
    L2,
    CoefficientFunction,
    FacetFESpace,
    GridFunction,
    Mesh,
    Parameter,
    TaskManager,
    specialcf,
    sqrt,
)

from ngvisco.forms.energy import StoredEnergy
from ngvisco.forms.facets import boundary_facets, facets_with_two_sides
from ngvisco.forms.spaces import Fields
from ngvisco.physics.time import time

__all__ = ["Context", "Entry", "Integrand", "Kind", "Term", "cell_size", "inner_facets", "negative", "time"]

Value = TypeVar("Value")


@dataclass(frozen=True)
class Integrand:
    """What is to be integrated over the cells and over the cells' boundaries."""

    cells: CoefficientFunction | None = None
    facets: CoefficientFunction | None = None

    def __neg__(self) -> Integrand:
        return Integrand(
            None if self.cells is None else -self.cells,
            None if self.facets is None else -self.facets,
        )


def negative(integrands: Sequence[Integrand]) -> list[Integrand]:
    """The integrands with the other sign."""
    return [-integrand for integrand in integrands]


Kind = Literal["dissipation", "power", "numerical", "monitor"]


@dataclass(frozen=True)
class Entry:
    """A column of the ledger: a dissipation or power (W), or a numerical dissipation (J a step).

    ``integrand`` is evaluated at the new state; dissipations and numerical ones enter the energy
    identity with +, powers with -, monitors not at all.
    """

    name: str
    kind: Kind
    integrand: Integrand
    evaluate: Callable[[], float] | None = None
    """Gives the value where it is no integral: the reaction of a wall."""


class Term(Protocol):
    """One term of the system.

    ``form(u, w)`` is its contribution to R(u; w) = 0, a left-hand side, in summands that are assembled
    one by one: NGSolve evaluates a whole integrand for each pair of components in it, so small
    summands are many times cheaper to linearise than their sum.  ``entries(u)`` is what the term
    puts into the energy ledger, such that form(u; v, zeta) is the sum of the entries' powers.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]: ...

    def entries(self, u: Fields) -> list[Entry]: ...


@runtime_checkable
class Storing(Protocol):
    """A term with a time derivative, that is with a share E of the energy.

    E is convex in (rho, m, z), m the momentum functional (paper: Euler-ED-basic-convexity-calculus).
    ``distance(a, b)`` is its Bregman distance E(a) - E(b) - E'(b)[a - b] >= 0 as a ledger entry, in a form
    in which nothing cancels: what a time scheme dissipates is a sum of such.
    """

    def distance(self, a: Fields, b: Fields) -> Entry: ...


class Context:
    """Parameters and known fields of a Rothe step: (rho, m, z)_old to (rho, m, z) by one length tau.

    m is the momentum functional <m, w> = int rho v . w.  The old values are those of a state, or what a
    time scheme combines of several (``ngvisco.timestepping``).
    """

    def __init__(
        self,
        mesh: Mesh,
        old: Fields,
        energy: StoredEnergy | None = None,
        momentum_old: CoefficientFunction | None = None,
    ) -> None:
        """``energy`` may be None where the material's energy has an expression.

        ``momentum_old`` are the values of m_old at the points of the forms' rule, kg/(m^2 s); None for
        rho_old v_old.
        """
        self.mesh, self.old, self.energy = mesh, old, energy
        self._momentum_old = momentum_old
        self.tau = Parameter(1.0)
        """Length of the Rothe step, s."""
        self.loads_from, self.loads_over = Parameter(0.0), Parameter(1.0)
        """Start and length of the interval over which loads are averaged, s."""
        self.eta = Parameter(1e-6)
        """Width of the smoothed sign sigma(v.n), m/s."""
        self.curvature = Parameter(1e-6)
        """Curvature of v below which the interior penalty stops following hess v, 1/(m s)."""
        self.normal = specialcf.normal(mesh.dim)
        self.inner = inner_facets(mesh)
        self.h = cell_size(mesh)

    @property
    def momentum_old(self) -> CoefficientFunction:
        """m_old, kg/(m^2 s), at the points of the forms' rule."""
        return self.old.rho * self.old.v if self._momentum_old is None else self._momentum_old

    def set_step(self, tau: float, end: float, loads_from: float, loads_over: float) -> None:
        """A Rothe step of length ``tau`` (s) whose unknowns belong to the time ``end`` (s).

        Loads are averaged over ``loads_over`` (s, 0 for a value at one time) from ``loads_from`` (s) on.
        """
        self.tau.Set(tau)
        self.loads_from.Set(loads_from)
        self.loads_over.Set(loads_over)
        time.Set(end)

    def rate(self, difference: Value) -> Value:
        """difference/tau, of coefficient functions, arrays or matrices: the only place with 1/tau."""
        return difference / (self.tau if isinstance(difference, CoefficientFunction) else self.tau.Get())

    def average(self, value: CoefficientFunction) -> CoefficientFunction:
        """The mean over ``loads_over`` by two Gauss points in time (exact for cubic functions of time;
        paper: g^k_{delta tau}).
        """
        spread = 0.5 / 3**0.5
        early, late = (
            value.Replace({time: self.loads_from + s * self.loads_over}) for s in (0.5 - spread, 0.5 + spread)
        )
        return 0.5 * (early + late)

    def normal_velocity(self, v: CoefficientFunction) -> CoefficientFunction:
        """v . n on inner facets and exactly 0 on walls."""
        return self.inner * (v * self.normal)

    def modulus(self, a: CoefficientFunction) -> CoefficientFunction:
        """The smooth modulus sqrt(a^2 + eta^2)."""
        return sqrt(a * a + self.eta * self.eta)

    def inflow(self, v: CoefficientFunction) -> CoefficientFunction:
        """n^- = (1 - sigma(v.n))/2, sigma(a) = a/sqrt(a^2 + eta^2): near 1 where v enters; 0 on walls."""
        a = self.normal_velocity(v)
        return 0.5 * (self.inner - a / self.modulus(a))


def periodic_facets(mesh: Mesh) -> set[int]:
    """Numbers of the boundary facets that the mesh identifies with another one."""
    kind = EDGE if mesh.dim == 2 else FACE
    return {nr for pair, _ in mesh.GetPeriodicNodePairs(kind) for nr in pair}


def inner_facets(mesh: Mesh) -> GridFunction:
    """1 on facets between two cells, also identified ones and interfaces, 0 on walls.

    Nothing is carried through a wall.
    """
    indicator = GridFunction(FacetFESpace(mesh, order=0))
    wall = boundary_facets(mesh) & ~facets_with_two_sides(mesh)
    wall[list(periodic_facets(mesh))] = False
    indicator.vec.FV().NumPy()[:] = ~wall
    return indicator


def cell_size(mesh: Mesh) -> GridFunction:
    """Cellwise h = |K|^{1/d} times a shape constant: the length in penalties and CFL numbers."""
    size = GridFunction(L2(mesh, order=0))
    with TaskManager():
        size.Set(specialcf.mesh_size)
    return size

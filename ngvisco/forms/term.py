"""Terms of the system: integrands in cells and on facets, linear in the test functions.

``cells(u, w)`` and ``facets(u, w)`` are functions of the values at a point: of the unknowns u, of what is
known there (``u.context``) and of the tests w, in which they are linear.  They are written once, with
operations that coefficient functions and arrays share (``ngvisco.physics.tensors``).  With trial and test
functions of NGSolve for u and w they are the term's form; with arrays of values for u, and tests that only
record what multiplies them (``ngvisco.physics.arrays.Linear``), they are the rows of a residual, its
derivative by a complex increment of u, and columns of element matrices.

Place, time and other functions of them are read by ``u.context.given(value)`` (at the end of the step) and
``u.context.average(value)`` (over the step, in cells).

A term that asks for more than values at a point - an integral, another space - states its ``form`` alone.
What a term reads besides u, w and ``u.context`` has to stay as it is through the run: a number that is taken
out of a Parameter by ``Get()`` is that of the moment when the form was made.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NoReturn, Protocol, TypeAlias, runtime_checkable

from ngsolve import CoefficientFunction, FESpace, Mesh

from ngvisco.errors import NgviscoError, ParameterError, _is_number
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.integrand import Integrand
from ngvisco.physics.material import StateSpace
from ngvisco.physics.tensors import inner

Place = Literal["velocity", "cells", "facets", "normals", "continuous", "walls"]

_IN_CELLS = ("velocity", "cells", "continuous")


@dataclass(frozen=True)
class Unknown:
    """An unknown of a step.

    Raises ParameterError for an unknown that evolves and has values neither in cells nor on known walls, or
    a scale that is no size.

    Attributes
    ----------
    name : str
    place : str
        ``"velocity"``: continuous vectors with what walls prescribe; ``"cells"``: discontinuous, local to its
        cell and condensed; ``"facets"``: on facets; ``"normals"``: on facets, a multiple of the normal;
        ``"continuous"``: in H1; ``"walls"``: what ``space`` makes.
    order : int
        Polynomial degree.
    size : int or None
        Number of components, None for a scalar.
    trace_of : str or None
        The unknown in cells that this one is the trace of; ``"v"``, of normal derivatives, is the gradient's.
    component : int
        Which component of v a normal derivative belongs to.
    space : callable or None
        Makes the space where ``place`` does not say it; on the mesh of the step or the whole of it.
    evolves : bool
        Whether it has a time derivative, as it must where a term reads its old value: schemes combine its
        states, errors and increments count it, a transfer carries it over, and ``Initial.values`` starts it.
    on : CoefficientFunction or None
        Of one of walls that evolves: 1 on their facets, 0 on all others.
    is_mean : bool
        Whether it is a ``CellMean``, a constant in each cell.
    scale : float
        A size of it, in its unit, that is not small, >= 0: errors and increments count relative to what the
        unknown is and to this; 0 for one that is never zero everywhere.  That of v is the run's.
    """

    name: str
    place: Place
    order: int = 0
    size: int | None = None
    trace_of: str | None = None
    component: int = 0
    space: Callable[[Mesh], FESpace] | None = None
    evolves: bool = False
    scale: float = 0.0
    on: CoefficientFunction | None = None
    is_mean: bool = False

    def __post_init__(self) -> None:
        if self.evolves and self.place not in _IN_CELLS and self.on is None:
            expected = f"'cells' or 'continuous' for {self.name!r}, which evolves: it needs values in cells"
            raise ParameterError("Unknown.place", self.place, expected)
        if not (_is_number(self.scale) and self.scale >= 0):
            raise ParameterError("Unknown.scale", self.scale, f"a size of {self.name!r}, >= 0, in its unit")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one value; () for a scalar."""
        return () if self.size is None else (self.size,)

    @property
    def is_local(self) -> bool:
        """Whether it is condensed cell by cell."""
        return self.place == "cells"


@dataclass(frozen=True)
class Setting:
    """The setting that unknowns depend on besides the term: dimension, states of the material, orders k and
    m."""

    dim: int
    states: StateSpace
    k: int
    m: int


@runtime_checkable
class Introducing(Protocol):
    """A term that brings unknowns with it: those whose equation it is."""

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        """In the order in which they are stored."""
        ...


PRODUCTION = "entropy_production_"
"""The beginning of the names of the ledger's columns of entropy that a mechanism produces, never negative."""


Kind = Literal["dissipation", "power", "energy", "numerical", "monitor", "production", "flux"]


@dataclass(frozen=True)
class Entry:
    """A column of the ledger: a dissipation or power (W), an energy, or a numerical dissipation (J a step).

    ``integrand`` is evaluated at the new state; dissipations, numerical ones and the change of energies enter
    the energy identity with +, powers with -, monitors not at all; nor do productions of entropy, W/K, and
    fluxes of mass into the domain, kg/s, which like powers are those of the scheme's stages.
    """

    name: str
    kind: Kind
    integrand: Integrand
    evaluate: Callable[[], float] | None = None
    """Gives the value where it is no integral: the reaction of a wall."""
    is_outside: bool = False
    """Whether what is dissipated is so beyond a wall, as by a dashpot: no heat of the material."""
    has_sign: bool = True
    """For a dissipation whether its integrand is nowhere negative, which is checked in every step; False
    where the sign holds up to the projection of conjugates."""


@runtime_checkable
class Term(Protocol):
    """One term of the system.

    ``form(u, w)`` is its contribution to R(u; w) = 0 in summands that are assembled one by one: NGSolve
    evaluates a whole integrand for each pair of components in it, so small summands are many times cheaper to
    linearise than their sum.  ``entries(u)`` are its columns of the ledger, such that form(u; v, zeta) is the
    sum of the entries' powers.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]: ...

    def entries(self, u: Fields) -> list[Entry]: ...


Where: TypeAlias = Literal["cells", "facets", "nodes"]
PLACES: tuple[Where, ...] = ("cells", "facets", "nodes")
"""The places of integration, as ``Integrand`` names them."""

Coupling = Literal["local", "facet", "flow"]
Kernel = Literal["facet means", "cell means", "conjugates", "density", "diffusion", "hyperviscosity"]


class PointTerm:
    """A term that is a function of the values at a point; see the module's docstring.

    Derived classes override ``cells``, ``facets`` or ``nodes``, and ``entries`` where the term has a power.

    Attributes
    ----------
    linearised : bool
        Whether the split solver takes the term's derivative into its tangent by increments.  Terms that the
        tangents of transport, elastic force and inertia are of, and small ones, say no.
    couples : str
        ``"local"``: its rows of z change with values of their own cell; ``"facet"``: with gradients, and
        across facets by means of both sides; ``"flow"``: it has rows of v, the walls' unknowns and the creep
        rate field alone, by its form, as has a class with a ``form`` of its own that says nothing else.
    kernel : str or None
        The part of the split solver that has matrices of its own for the term, or solves it for its unknown;
        None where rows and tangent follow from the integrands.  A derived class with other integrands is
        another equation, and has none unless it says so.
    coupled_only : str or None
        Why the term is for the coupled solver alone; None where both take it.
    is_mass : bool
        Whether the mass of v is the term's tangent: that of the whole rule, since by fewer points it is
        singular.
    kept : tuple of str
        Unknowns, explicit functions of others, whose change the matrix of Newton's method leaves out of the
        term: it follows them from iterate to iterate.
    plane_only : str or None
        Why there is no such term in a body of revolution; None where ``L`` has all that it asks for.
    """

    linearised = True
    couples: Coupling = "local"
    kernel: ClassVar[Kernel | None] = None
    coupled_only: str | None = None
    is_mass: ClassVar[bool] = False
    kept: tuple[str, ...] = ()
    plane_only: ClassVar[str | None] = None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = vars(cls)
        if not {*PLACES, "form"}.isdisjoint(own):
            cls.kernel = own.get("kernel")
        if "form" in own:
            cls.couples = own.get("couples", "flow")

    @property
    def impulse(self) -> str:
        """The ledger's name of the momentum that the term gives to the body, if its rows of v give some."""
        return type(self).__name__

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the cells."""
        return []

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the boundaries of all cells, both sides of an inner facet."""
        return []

    def nodes(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the cells by as many points as a field has values in one."""
        return []

    def entering_mass(self, u: Fields) -> CoefficientFunction | None:
        """Mass that flows in through walls beyond (v . n)^- rho, kg/(m^2 s); None where there is none."""
        return None

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        """``cells``, ``facets`` and ``nodes`` for NGSolve."""
        cells = [Integrand(part) for part in self.cells(u, w)]
        nodes = [Integrand(nodes=part) for part in self.nodes(u, w)]
        return cells + [Integrand(facets=part) for part in self.facets(u, w)] + nodes

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation in cells, W/m^3, by the ledger's names."""
        return {}

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation on the boundaries of all cells, W/m^2, by the ledger's names."""
        return {}

    def dissipated_at_nodes(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation integrated at the nodal points, W/m^3, by the ledger's names."""
        return {}

    def entries(self, u: Fields) -> list[Entry]:
        """Columns of the energy ledger: what it dissipates."""
        parts = [DISSIPATED[place](self, u) for place in PLACES]
        names = dict.fromkeys(name for part in parts for name in part)
        return [Entry(name, "dissipation", Integrand(*(part.get(name) for part in parts))) for name in names]


Integrands: TypeAlias = Callable[[CoefficientFunction], Sequence[Integrand]]
"""Integrands by the test function of a space."""


class CellMean(PointTerm):
    """int_K (a_K - a) q - int_{dK} b q = 0 for constant q: a_K, an unknown of cells, is a mean.

    a_K is an explicit function of other unknowns, which no solver iterates on.
    """

    name: str
    kernel = "cell means"

    @abstractmethod
    def value(self, u: Fields) -> CoefficientFunction:
        """a, in a cell."""

    def value_on_sides(self, u: Fields) -> CoefficientFunction | None:
        """b, on a cell's side."""
        return None

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        q = w.parts[self.name]
        return [inner(u.parts[self.name], q), -inner(self.value(u), q)]

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        b = self.value_on_sides(u)
        return [] if b is None else [-inner(b, w.parts[self.name])]

    def projections(self, u: Fields) -> list[tuple[str, Integrands]]:
        b = self.value_on_sides(u)

        def load(q: CoefficientFunction) -> list[Integrand]:
            sides = [] if b is None else [Integrand(facets=inner(b, q))]
            return [Integrand(inner(self.value(u), q)), *sides]

        return [(self.name, load)]


DISSIPATED: dict[Where, Callable[[PointTerm, Fields], dict[str, CoefficientFunction]]] = {
    "cells": lambda term, u: term.dissipated(u),
    "facets": lambda term, u: term.dissipated_on_facets(u),
    "nodes": lambda term, u: term.dissipated_at_nodes(u),
}


def dissipations(u: Fields, reader: Term, where: Where = "cells") -> dict[str, CoefficientFunction]:
    """The dissipation of all terms but ``reader`` in cells or at nodes, W/m^3, or on facets, W/m^2, by the
    ledger's names.

    For a term that turns them into something else, as heat.
    """
    points = (term for term in u.context.terms if term is not reader and isinstance(term, PointTerm))
    parts = (DISSIPATED[where](term, u) for term in points)
    return {name: value for part in parts for name, value in part.items()}


def tested(value: CoefficientFunction) -> Integrands:
    """int value : test over the cells."""
    return lambda test: [Integrand(inner(value, test))]


@runtime_checkable
class Projecting(Protocol):
    """A term whose local unknowns are cellwise projections of what is made of others."""

    def projections(self, u: Fields) -> list[tuple[str, Integrands]]:
        """Names and loads of local unknowns, in the order in which they depend on each other."""
        ...


@runtime_checkable
class Storing(Protocol):
    """A term with a time derivative, that is with a share E of the energy.

    E is convex in the unknowns that evolve, in (rho, m, z) and those of further terms, m the momentum
    functional (paper: Euler-ED-basic-convexity-calculus).

    ``energy(u)`` is its density in cells or on facets, a share of the ledger's column ``"kinetic"`` or
    ``"stored"``; ``slope(b, d)`` that of E'(b)[d] with m kept, which asks d for no velocity;
    ``distance(a, b)`` the Bregman distance E(a) - E(b) - E'(b)[a - b] >= 0, a share of ``"inertial"`` or
    ``"bregman"``, in a form in which nothing cancels: what a time scheme dissipates is a sum of such.
    """

    def energy(self, u: Fields) -> Entry: ...

    def slope(self, b: Fields, d: Fields) -> Integrand: ...

    def distance(self, a: Fields, b: Fields) -> Entry: ...


class WithheldError(NgviscoError, LookupError):
    """A term asks for a field that it must not take."""


class GivenParts(dict[str, Any]):
    """Fields by name; asking for another one raises ``WithheldError`` with ``reason`` about its name."""

    def __init__(self, fields: dict[str, Any], reason: str) -> None:
        super().__init__(fields)
        self.reason = reason

    def __missing__(self, name: str) -> NoReturn:
        raise WithheldError(self.reason.format(name=name))


@contextmanager
def refused_by_name(term: object) -> Iterator[None]:
    """Raise ParameterError with the term's name for what it must not take, or the material does not carry."""
    try:
        yield
    except KeyError as error:
        name, missing = type(term).__name__, error.args[0] if error.args else ""
        expected = f"{name}: it reads {missing!r}, which the material does not carry"
        raise ParameterError("Simulation.terms", name, expected) from error
    except WithheldError as error:
        name = type(term).__name__
        raise ParameterError("Simulation.terms", name, f"{name}: {error}") from error

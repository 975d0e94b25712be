"""Terms of the system: integrands in cells and on facets, linear in the test functions.

The integrands ``cells(u, w)`` and ``facets(u, w)`` are functions of values at a point: of the unknowns u, of
the known data (``u.context``), and of the tests w, in which the integrands are linear.  An integrand is
written once, with operations that coefficient functions and arrays share (``ngvisco.physics.tensors``).  If u
and w are trial and test functions of NGSolve, the integrands are the term's form.  If u are arrays of values,
and w are tests that only record their factors (``ngvisco.physics.arrays.Linear``), the integrands give the
rows of a residual, its derivative by a complex increment of u, and columns of element matrices.

``u.context.given(value)`` is the value of a function of place and time at the end of the step.
``u.context.average(value)`` is the function's mean over the step, in cells.

A term that needs more than values at a point, such as an integral or another space, gives its ``form`` alone.
All other data that a term reads must be constant during the run, because ``Parameter.Get()`` is evaluated
only once, when the form is built.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NoReturn, Protocol, TypeAlias, runtime_checkable

from ngsolve import CoefficientFunction

from ngvisco.errors import NgviscoError, ParameterError
from ngvisco.forms.fields import Fields
from ngvisco.forms.mesh.integrand import Integrand
from ngvisco.forms.unknown import Setting, Unknown
from ngvisco.physics.tensors import inner

PRODUCTION = "entropy_production_"
"""Prefix of the ledger's columns of entropy production; each mechanism has one, which is never negative."""


Kind = Literal["dissipation", "power", "energy", "numerical", "monitor", "production", "flux"]


@dataclass(frozen=True)
class Entry:
    """A column of the ledger: a dissipation or power (W), an energy, or a numerical dissipation (J a step).

    ``integrand`` is evaluated at the new state.  Dissipations, numerical dissipations and the change of
    energies enter the energy identity with +, powers with -.  Monitors, productions of entropy (W/K) and
    fluxes of mass into the domain (kg/s) do not enter it.  Productions and fluxes are evaluated at the
    scheme's stages, like powers.
    """

    name: str
    kind: Kind
    integrand: Integrand
    evaluate: Callable[[], float] | None = None
    """Function that gives the value, if the value is not an integral, as the power of a wall's reaction."""
    is_outside: bool = False
    """Whether the dissipation takes place beyond a wall, as in a dashpot, and does not heat the material."""
    has_sign: bool = True
    """Whether a dissipation's integrand is nowhere negative; every step checks this. False if the integrand
    may be negative by the error of the conjugates' projection."""
    difference_of: Integrand | None = None
    """Quantity that determines the rounding error of the integrand. For an integrand that may be a small
    difference of two quantities, it is the larger quantity."""


@runtime_checkable
class Term(Protocol):
    """One term of the system.

    ``form(u, w)`` is the term's contribution to R(u; w) = 0, in summands that are assembled one by one.
    NGSolve evaluates a whole integrand for each pair of its components, so that linearising small summands is
    many times cheaper than linearising their sum.  ``entries(u)`` are the term's columns of the ledger;
    form(u; v, zeta) is the sum of the entries' powers.
    """

    def form(self, u: Fields, w: Fields) -> list[Integrand]: ...

    def entries(self, u: Fields) -> list[Entry]: ...


PointRule: TypeAlias = Literal["cells", "facets", "collocated"]
PLACES: tuple[PointRule, ...] = ("cells", "facets", "collocated")
"""The places of integration, as ``Integrand`` names them."""

Coupling = Literal["local", "facet", "flow"]
Kernel = Literal["facet means", "cell means", "conjugates", "density", "diffusion", "hyperviscosity"]


Integrands: TypeAlias = Callable[[CoefficientFunction], Sequence[Integrand]]
"""A linear form: its integrands as a function of the test function of a space."""

CHANGE, SKEW, ELASTIC, ENTERING = "change of momentum", "skew form", "elastic force", "entering"
"""Groups of the momentum balance that have no column."""

_RENAMED = {"nodes": "collocated", "dissipated_at_nodes": "dissipated_collocated"}


class PointTerm:
    """A term that is a function of the values at a point; see the module's docstring.

    Derived classes override ``cells``, ``facets`` or ``collocated``, and ``entries`` if the term has a power.

    Attributes
    ----------
    linearised : bool
        Whether the split solver's tangent by increments includes the term's derivative.  It is False for
        transport, elastic force and inertia, which have tangents of their own, and for small terms.
    couples : str
        ``"local"``: rows of z depend on values of one cell; ``"facet"``: they also depend on gradients
        and, through facet means, on neighbours; ``"flow"``: the term has rows of v, the walls' unknowns and
        the creep rate field only, by its form.  ``"flow"`` is the default of a class that defines ``form``.
    kernel : str or None
        Part of the split solver that has its own matrices for the term, or solves it for its unknown. None if
        rows and tangent follow from the integrands.  A derived class with other integrands is another
        equation, so that its ``kernel`` is None unless the class sets it.
    coupled_only : str or None
        Reason why only the coupled solver takes the term; None if both solvers take it.
    group : str or None
        Group of the momentum balance in which the term's rows of v count; ``""`` for a term that does no work
        on rigid motions. None if the rows are an impulse of their own, with the name ``impulse``.  Like
        ``kernel``, it is None for a derived class with other integrands.
    wall : str or None
        Name of the wall on which alone the term acts.
    facet_mean : str or None
        Name of the mean of both sides that the term determines.
    mean_of : str or None
        Name of an unknown in cells, if ``facet_mean`` is its mean; None for means of other functions.
    stays : bool
        Whether the facet mean is kept at its largest value among the iterates of a step (``Largest``); such a
        mean must have the derivative zero.
    is_mass : bool
        Whether the term's tangent is the mass matrix of v, integrated by the whole rule: fewer points make it
        singular.
    weighs : bool
        Whether the rows of v contain the density, which is a function of z if there are bodies.  The tangent
        by increments then has the derivative of these rows by z, also if the term is not ``linearised``.
    plane_only : str or None
        Reason why a body of revolution cannot have the term; None if the term reads no gradient of a vector
        or tensor but ``L``.
    """

    linearised = True
    couples: Coupling = "local"
    kernel: ClassVar[Kernel | None] = None
    coupled_only: str | None = None
    group: ClassVar[str | None] = None
    wall: str | None = None
    facet_mean: str | None = None
    mean_of: ClassVar[str | None] = None
    stays: ClassVar[bool] = False
    is_mass: ClassVar[bool] = False
    weighs: ClassVar[bool] = False
    plane_only: ClassVar[str | None] = None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        members = vars(cls)
        for before, now in _RENAMED.items():
            if before in members:
                expected = f"the name {now}, since the method {before} is now called {now}"
                raise ParameterError(f"{cls.__name__}.{before}", "a method", expected)
        if not {*PLACES, "form"}.isdisjoint(members):
            cls.kernel, cls.group = members.get("kernel"), members.get("group")
        if "form" in members:
            cls.couples = members.get("couples", "flow")

    @property
    def impulse(self) -> str:
        """Name, in the ledger, of the impulse that the term's rows of v give to the body."""
        return type(self).__name__

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        """The unknowns that the term introduces and determines, in the order of their storage."""
        return ()

    def projections(self, u: Fields) -> list[tuple[str, Integrands]]:
        """Names and loads of the term's local unknowns, in the order of their dependence. These unknowns are
        cellwise projections of functions of other unknowns."""
        return []

    def facet_projection(self, u: Fields) -> CoefficientFunction | None:
        """The function whose mean over each facet is ``facet_mean``; None if a solver iterates on the
        mean."""
        return None

    def impulses(self, u: Fields, w: Fields) -> dict[str, list[Integrand]]:
        """Summands of the rows of v, as left-hand sides; the keys are the groups or impulses in which they
        count."""
        name = self.impulse if self.group is None else self.group
        return {name: self.form(u, w)} if name else {}

    def on_body(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Rows of v of a term on a ``wall``: -t . w on the facets of the wall, with the stress t, Pa."""
        return []

    def cells(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the cells."""
        return []

    def degree(self, k: int, m: int, rates: Any) -> int | None:
        """Polynomial degree of ``cells`` on straight cells, for orders k of v and m of the fields. The split
        solver's quadrature rule has this degree.

        None if the integrands are not polynomials, or read data other than the old fields.
        """
        return None

    def facets(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the boundaries of all cells, both sides of an inner facet."""
        return []

    def collocated(self, u: Fields, w: Fields) -> Sequence[CoefficientFunction]:
        """Summands to be integrated over the cells by the collocated rule: one point per coefficient."""
        return []

    def entering_mass(self, u: Fields) -> CoefficientFunction | None:
        """Mass inflow through walls in addition to (v . n)^- rho, kg/(m^2 s), or None."""
        return None

    def form(self, u: Fields, w: Fields) -> list[Integrand]:
        """The summands of ``cells``, ``facets`` and ``collocated`` as integrands for NGSolve."""
        cells = [Integrand(part) for part in self.cells(u, w)]
        collocated = [Integrand(collocated=part) for part in self.collocated(u, w)]
        return cells + [Integrand(facets=part) for part in self.facets(u, w)] + collocated

    def dissipated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation in cells, W/m^3, by the ledger's names."""
        return {}

    def dissipated_on_facets(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation on the boundaries of all cells, W/m^2, by the ledger's names."""
        return {}

    def dissipated_collocated(self, u: Fields) -> dict[str, CoefficientFunction]:
        """Dissipation integrated by the collocated rule, W/m^3, by the ledger's names."""
        return {}

    def entries(self, u: Fields) -> list[Entry]:
        """Columns of the energy ledger: the term's dissipations."""
        parts = [DISSIPATED[place](self, u) for place in PLACES]
        names = dict.fromkeys(name for part in parts for name in part)
        return [Entry(name, "dissipation", Integrand(*(part.get(name) for part in parts))) for name in names]


class CellMean(PointTerm):
    """Equation of a cell mean a_K: int_K (a_K - a) q - int_{dK} b q = 0 for constant q.

    a_K is an explicit function of other unknowns, which no solver iterates on.
    """

    name: str
    kernel, group = "cell means", ""

    @abstractmethod
    def value(self, u: Fields) -> CoefficientFunction:
        """The function a in a cell."""

    def value_on_sides(self, u: Fields) -> CoefficientFunction | None:
        """The function b on a cell's side, or None for zero."""
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


def point_terms(terms: Iterable[object]) -> list[PointTerm]:
    """The terms among ``terms`` that derive from ``PointTerm``; others have a form and entries alone."""
    return [term for term in terms if isinstance(term, PointTerm)]


def impulses_of(term: Term, u: Fields, w: Fields) -> dict[str, list[Integrand]]:
    """``PointTerm.impulses`` of a term; a term that is no ``PointTerm`` has one impulse, with its class's
    name."""
    return term.impulses(u, w) if isinstance(term, PointTerm) else {type(term).__name__: term.form(u, w)}


DISSIPATED: dict[PointRule, Callable[[PointTerm, Fields], dict[str, CoefficientFunction]]] = {
    "cells": lambda term, u: term.dissipated(u),
    "facets": lambda term, u: term.dissipated_on_facets(u),
    "collocated": lambda term, u: term.dissipated_collocated(u),
}


def dissipations(u: Fields, reader: Term, where: PointRule = "cells") -> dict[str, CoefficientFunction]:
    """Dissipation of all terms but ``reader`` by the ledger's names: W/m^3 in cells or at collocation points,
    W/m^2 on facets.

    ``reader`` is a term that turns dissipation into something else, such as heat.
    """
    parts = (DISSIPATED[where](term, u) for term in point_terms(u.context.terms) if term is not reader)
    return {name: value for part in parts for name, value in part.items()}


def tested(value: CoefficientFunction) -> Integrands:
    """The linear form int value : test over the cells."""
    return lambda test: [Integrand(inner(value, test))]


@runtime_checkable
class Storing(Protocol):
    """A term with a time derivative, and therefore with a share of the energy E.

    E is convex in the evolving unknowns (paper: Euler-ED-basic-convexity-calculus). The evolving unknowns are
    rho, the momentum functional m, z, and the evolving unknowns of further terms.

    ``energy(u)`` is the density of E in cells or on facets, a share of the ledger's column ``"kinetic"`` or
    ``"stored"``.  ``slope(b, d)`` is the density of E'(b)[d] at fixed m; it does not read the velocity of d.
    ``distance(a, b)`` is the Bregman distance E(a) - E(b) - E'(b)[a - b] >= 0, a share of ``"inertial"`` or
    ``"bregman"``. The distance is written without cancellation, since a time scheme's dissipation is a sum of
    such distances.
    """

    def energy(self, u: Fields) -> Entry: ...

    def slope(self, b: Fields, d: Fields) -> Integrand: ...

    def distance(self, a: Fields, b: Fields) -> Entry: ...


ANOTHER = "another term, since "
"""Beginning of the message about a refused term; the reason follows as the last of the ``Words``."""


class WithheldError(NgviscoError, LookupError):
    """A term reads a field that is withheld from it."""


class GivenParts(dict[str, Any]):
    """Fields by name. Any other name raises ``WithheldError`` with the text ``reason``, which contains the
    name."""

    def __init__(self, fields: dict[str, Any], reason: str) -> None:
        super().__init__(fields)
        self.reason = reason

    def __missing__(self, name: str) -> NoReturn:
        raise WithheldError(self.reason.format(name=name))


@contextmanager
def refused_by_name(term: object) -> Iterator[None]:
    """Raise ParameterError with the term's name if the term reads a withheld field or a missing variable."""
    try:
        yield
    except KeyError as error:
        name, missing = type(term).__name__, error.args[0] if error.args else ""
        reason = f"the term {name} reads {missing!r}, which the material does not carry"
        raise ParameterError("Simulation.terms", name, ANOTHER, reason) from error
    except WithheldError as error:
        name = type(term).__name__
        raise ParameterError("Simulation.terms", name, ANOTHER, f"the term {name} {error}") from error

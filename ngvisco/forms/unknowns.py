"""The unknowns that a term of the system brings with it: their names, spaces and what they are traces of."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from ngsolve import CoefficientFunction, FESpace, Mesh

from ngvisco.errors import ParameterError, _is_number
from ngvisco.physics.state_space import StateSpace

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

    def __post_init__(self) -> None:
        if self.evolves and self.place not in _IN_CELLS and self.on is None:
            expected = f"'cells' or 'continuous' for {self.name!r}, which evolves: it needs values in cells"
            raise ParameterError("Unknown.place", self.place, expected)
        if not (_is_number(self.scale) and self.scale >= 0):
            raise ParameterError("Unknown.scale", self.scale, f"a size of {self.name!r}, >= 0, in its unit")

    @property
    def shape(self) -> tuple[int, ...]:
        """Of its values: () of a scalar."""
        return () if self.size is None else (self.size,)

    @property
    def is_local(self) -> bool:
        """Whether it is condensed cell by cell."""
        return self.place == "cells"


@dataclass(frozen=True)
class Setting:
    """What unknowns depend on besides the term: dimension, states of the material, orders k and m."""

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

"""The unknowns that a term of the system brings with it: their names, spaces and what they are traces of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

from ngsolve import FESpace, Mesh

from ngvisco.physics.state_space import StateSpace

Place = Literal["velocity", "cells", "facets", "normals", "continuous", "walls"]


@dataclass(frozen=True)
class Unknown:
    """An unknown of a step.

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
    """

    name: str
    place: Place
    order: int = 0
    size: int | None = None
    trace_of: str | None = None
    component: int = 0
    space: Callable[[Mesh], FESpace] | None = None

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

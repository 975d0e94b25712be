"""Declarations of the unknowns that terms introduce."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ngsolve import CoefficientFunction, FESpace, Mesh

from ngvisco.errors import ParameterError, require_numbers
from ngvisco.physics.material import StateSpace

SpaceKind = Literal["velocity", "cells", "facets", "normals", "continuous", "walls"]

_IN_CELLS = ("velocity", "cells", "continuous")


@dataclass(frozen=True)
class Unknown:
    """An unknown of a step.

    Raises ParameterError for an unknown that evolves although its values are neither in cells nor on the
    walls given by ``on``, and for a scale that is not a number >= 0.

    Attributes
    ----------
    name : str
    place : str
        ``"velocity"``: continuous vectors with the walls' constraints; ``"cells"``: discontinuous, local to
        its cell and condensed; ``"facets"``: on facets; ``"normals"``: on facets, a multiple of the normal;
        ``"continuous"``: in H1; ``"walls"``: in the space that ``space`` makes.
    order : int
        Polynomial degree.
    size : int or None
        Number of components, None for a scalar.
    trace_of : str or None
        Name of the unknown in cells whose trace this unknown is; ``"v"`` marks a trace of grad v.
    component : int
        Number of the component of v whose normal derivative this unknown is.
    space : callable or None
        Makes the space if ``place`` does not determine it, on the step's mesh or on the undistributed mesh.
    evolves : bool
        Whether the unknown has a time derivative. It must have one if a term reads its old value. Schemes
        combine the states of such an unknown, errors and increments count it, a transfer carries it over, and
        ``Initial.values`` starts it.
    on : CoefficientFunction or None
        Indicator of a wall's facets, 1 on them and 0 on all others, for an unknown that evolves on a wall.
    is_mean : bool
        Whether the unknown is a ``CellMean``, a constant in each cell.
    scale : float
        Typical size, in the unknown's unit, >= 0. Errors and increments count relative to the unknown's size
        plus this scale. The scale is 0 for an unknown that is never zero everywhere.  The run sets the scale
        of v. Errors of z have scales of their own (``ngvisco.timestepping.error``).
    """

    name: str
    place: SpaceKind
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
            expected = (
                f"'cells' or 'continuous' for {self.name!r}, since an evolving unknown needs values in cells"
            )
            raise ParameterError("Unknown.place", self.place, expected)
        require_numbers("Unknown", ">= 0", float, scale=self.scale)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one value; () for a scalar."""
        return () if self.size is None else (self.size,)

    @property
    def is_local(self) -> bool:
        """Whether the unknown is condensed cell by cell."""
        return self.place == "cells"


@dataclass(frozen=True)
class Setting:
    """The data from which a term makes its unknowns: dimension, states of the material, orders k and m."""

    dim: int
    states: StateSpace
    k: int
    m: int

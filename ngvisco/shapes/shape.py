"""What a shape is: a part of space, told by a level that is positive inside; unions and complements.

Shapes say where bodies are at the start of a run.  A level is any function with the right sign; near the
surface it should be continuous, so that cells that the surface cuts are divided where it is (``fractions``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Mesh

from ngvisco.errors import ParameterError, require_collection
from ngvisco.shapes.fractions import fractions
from ngvisco.shapes.places import Places


class Shape(ABC):
    """A part of space.  ``a | b``, ``a & b``, ``a - b`` and ``~a`` are shapes again."""

    @abstractmethod
    def level(self, at: Places) -> np.ndarray:
        """A number at each place, (places,): > 0 inside, <= 0 outside.

        Raises ParameterError where the shape does not fit the mesh, e.g. its dimension.
        """

    def inside(self, mesh: Mesh, order: int = 1) -> GridFunction:
        """The shape's fraction of each cell, a discontinuous P_order from 0 to 1 (``fractions``)."""
        return fractions(mesh, [self], order)[0]

    def __or__(self, other: Shape) -> Shape:
        return Union((self, other))

    def __and__(self, other: Shape) -> Shape:
        return Complement(Union((Complement(self), Complement(other))))

    def __sub__(self, other: Shape) -> Shape:
        return self & Complement(other)

    def __invert__(self) -> Shape:
        return Complement(self)


@dataclass(frozen=True)
class Union(Shape):
    """What is in one of the shapes at least."""

    shapes: Sequence[Shape]

    def __post_init__(self) -> None:
        shapes = tuple(require_collection("Union.shapes", self.shapes, "a sequence of shapes"))
        if not shapes or not all(isinstance(shape, Shape) for shape in shapes):
            raise ParameterError("Union.shapes", self.shapes, "shapes, at least one")
        object.__setattr__(self, "shapes", shapes)

    def level(self, at: Places) -> np.ndarray:
        return np.max([shape.level(at) for shape in self.shapes], axis=0)


@dataclass(frozen=True)
class Complement(Shape):
    """What is not in a shape."""

    shape: Shape

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Shape):
            raise ParameterError("Complement.shape", self.shape, "a shape")

    def level(self, at: Places) -> np.ndarray:
        return -self.shape.level(at)


@dataclass(frozen=True)
class Where(Shape):
    """Where a function of the place is positive; of one that is 0 or 1 everywhere, where it is 1.

    Parameters
    ----------
    function : scalar coefficient function
        Of x, y, z (m).  A continuous one places the surface within the cells; one that jumps to their
        subdivision.
    """

    function: CoefficientFunction

    def __post_init__(self) -> None:
        if not isinstance(self.function, CoefficientFunction) or self.function.dim != 1:
            raise ParameterError("Where.function", self.function, "a scalar coefficient function")

    def level(self, at: Places) -> np.ndarray:
        values = at.values(self.function).reshape(-1)
        if not np.isfinite(values).all():
            raise ParameterError("Where.function", "not finite somewhere in the domain", "finite values")
        is_indicator = bool(np.isin(values, (0.0, 1.0)).all())
        return values - 0.5 if is_indicator else values


def as_shape(field: str, value: object) -> Shape:
    """A shape, or a coefficient function as the shape where it is positive; raises ParameterError."""
    if isinstance(value, Shape):
        return value
    # a grid function is one too
    if isinstance(value, (CoefficientFunction, GridFunction)) and value.dim == 1:
        return Where(value)
    expected = "a shape, or a scalar coefficient function that is positive inside"
    raise ParameterError(field, value, expected)


def require_dim(field: str, value: Sequence[float], mesh: Mesh) -> None:
    """Raise ParameterError unless a place has as many coordinates as the mesh."""
    if len(value) != mesh.dim:
        raise ParameterError(field, list(value), f"{mesh.dim} coordinates, as many as the mesh has")

"""Places of bodies as case files have them: shapes whose files are given by paths."""

from __future__ import annotations

from typing import Annotated

from ngvisco.errors import Quantity
from ngvisco.shapes.image import Image
from ngvisco.shapes.surface import ClosedSurface


def closed_surface(
    path: Annotated[str, Quantity(example="part.stl")],
    scale: Annotated[float, Quantity("m", "> 0", 1e-3)] = 1.0,
) -> ClosedSurface:
    """The inside of a closed surface of triangles, from an STL file; with a path as case files have it.

    Parameters
    ----------
    path : str
        An STL file whose surface closes; relative to the case file.
    scale : float
        Length of the STL file's unit.
    """
    return ClosedSurface(path, scale)


def image(
    path: Annotated[str, Quantity(example="part.png")],
    low: Annotated[list[float], Quantity("m", example=[0.0, 0.0])],
    high: Annotated[list[float], Quantity("m", example=[1.0, 1.0])],
    threshold: float = 0.5,
    dark: bool = True,
) -> Image:
    """Where a PNG file is dark; with a path as case files have it.

    Parameters
    ----------
    path : str
        A PNG file; relative to the case file.
    low : list[float]
        Place of the picture's lower left corner.
    high : list[float]
        Place of its upper right corner.
    threshold : float
        Grey, from 0 (black) to 1 (white), below which a pixel belongs to it.
    dark : bool
        If false, what is brighter than the threshold instead.
    """
    return Image(path, tuple(low), tuple(high), threshold, dark)  # type: ignore[arg-type]

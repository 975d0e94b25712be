"""Places of bodies as case files have them: shapes whose files are given by paths."""

from __future__ import annotations

from ngvisco.shapes.image import Image
from ngvisco.shapes.surface import ClosedSurface


def closed_surface(path: str, scale: float = 1.0) -> ClosedSurface:
    """The inside of a closed surface of triangles, from an STL file; with a path as case files have it."""
    return ClosedSurface(path, scale)


def image(path: str, low: list[float], high: list[float], threshold: float = 0.5, dark: bool = True) -> Image:
    """Where a PNG file is dark; with a path as case files have it."""
    return Image(path, tuple(low), tuple(high), threshold, dark)  # type: ignore[arg-type]

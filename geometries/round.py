"""Round domains with curved cells: discs, half discs, annuli, cylinders, spheres, spherical shells."""

from collections.abc import Mapping
from typing import Annotated

from netgen.occ import Circle, Cylinder, MoveTo, Pnt, Sphere, X, Z
from ngsolve import Mesh

from ngvisco.errors import ParameterError, Quantity
from ngvisco.geometries.meshing import CURVE_ORDER, CellSize, Domain, Length, as_length


def disc(
    radius: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"wall": 0.05})] = None,
) -> Mesh:
    """A disc about the origin; wall ``wall``.

    Parameters
    ----------
    radius : float
        Radius.
    order : int
        Polynomial order of curved cells; 1 gives a polygon, on which slip is refused.
    maxh, refine
        As for ``box``.
    """
    domain = Domain("disc", 2, [("radius", radius)], ["radius"])
    face = Circle((0, 0), domain.lengths[0]).Face()
    face.edges.name = "wall"
    return domain.mesh(face, maxh, order, refine)


def half_disc(
    radius: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"wall": 0.05})] = None,
) -> Mesh:
    """The half x > 0 of a disc about the origin, a meridian of a ball; walls ``wall``, ``axis``.

    Parameters
    ----------
    radius, maxh, order, refine
        As for ``disc``.
    """
    domain = Domain("half_disc", 2, [("radius", radius)], ["radius"])
    R = domain.lengths[0]
    face = Circle((0, 0), R).Face() * MoveTo(0, -2 * R).Rectangle(2 * R, 4 * R).Face()
    face.edges.name = "wall"
    face.edges.Min(X).name = "axis"
    return domain.mesh(face, maxh, order, refine)


def annulus(
    inner: Length,
    outer: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"inner": 0.05})] = None,
) -> Mesh:
    """The ring inner < r < outer about the origin; walls ``inner`` and ``outer``.

    Parameters
    ----------
    inner : float
        Inner radius.
    outer : float
        Outer radius, greater than the inner radius.
    maxh, order, refine
        As for ``disc``.
    """
    domain, r, R = _shell("annulus", 2, inner, outer)
    ring, hole = Circle((0, 0), R).Face(), Circle((0, 0), r).Face()
    ring.edges.name, hole.edges.name = "outer", "inner"
    return domain.mesh(ring - hole, maxh, order, refine)


def cylinder(
    radius: Length,
    height: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"side": 0.05})] = None,
    split_corners: bool = False,
) -> Mesh:
    """The cylinder r < radius, 0 < z < height; walls ``side``, ``bottom``, ``top``.

    Parameters
    ----------
    height : float
        Height, along z.
    split_corners
        As for ``box``.
    radius, maxh, order, refine
        As for ``disc``.
    """
    domain = Domain("cylinder", 3, [("radius", radius), ("height", height)], ["radius"])
    r, h = domain.lengths
    solid = Cylinder(Pnt(0, 0, 0), Z, r=r, h=h)
    solid.faces.name = "side"
    solid.faces.Min(Z).name, solid.faces.Max(Z).name = "bottom", "top"
    return domain.mesh(solid, maxh, order, refine, split_corners)


def sphere(
    radius: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"wall": 0.05})] = None,
) -> Mesh:
    """A ball about the origin; wall ``wall``.

    Parameters
    ----------
    radius, maxh, order, refine
        As for ``disc``.
    """
    domain = Domain("sphere", 3, [("radius", radius)], ["radius"])
    solid = Sphere(Pnt(0, 0, 0), domain.lengths[0])
    solid.faces.name = "wall"
    return domain.mesh(solid, maxh, order, refine)


def spherical_shell(
    inner: Length,
    outer: Length,
    maxh: CellSize,
    *,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"inner": 0.05})] = None,
) -> Mesh:
    """The shell inner < r < outer about the origin; walls ``inner`` and ``outer``.

    Parameters
    ----------
    inner, outer, maxh, order, refine
        As for ``annulus``.
    """
    domain, r, R = _shell("spherical_shell", 3, inner, outer)
    ball, core = Sphere(Pnt(0, 0, 0), R), Sphere(Pnt(0, 0, 0), r)
    ball.faces.name, core.faces.name = "outer", "inner"
    return domain.mesh(ball - core, maxh, order, refine)


def _shell(owner: str, dim: int, inner: float, outer: float) -> tuple[Domain, float, float]:
    """Domain of a ring or shell, and both radii in the domain's unit."""
    r, R = as_length(f"{owner}.inner", inner), as_length(f"{owner}.outer", outer)
    if not r < R:
        raise ParameterError(f"{owner}.inner", inner, f"a number < outer = {R:g}")
    sizes = [("inner", r), ("outer", R), ("thickness", R - r)]
    domain = Domain(owner, dim, sizes, ["inner", "outer"])
    return domain, domain.lengths[0], domain.lengths[1]

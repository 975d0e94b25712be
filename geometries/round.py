"""Round domains: discs, annuli, cylinders, spheres, spherical shells.  Their cells are curved."""

from collections.abc import Mapping
from typing import Annotated

from netgen.occ import Circle, Cylinder, Pnt, Sphere, Z
from ngsolve import Mesh

from ngvisco.errors import ParameterError, Quantity
from ngvisco.geometries.meshing import CURVE_ORDER, CellSize, Length, as_length, is_delicate, mesh_of, unit_of


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
    radius = as_length("disc.radius", radius)
    unit = unit_of("disc", 2, [("radius", radius)], ["radius"])
    face = Circle((0, 0), radius / unit).Face()
    face.edges.name = "wall"
    return mesh_of("disc", face, 2, maxh, order, refine, unit=unit)


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
        Outer radius, above the inner one.
    maxh, refine
        As for ``box``.
    order
        As for ``disc``.
    """
    r, R, unit, delicate = _radii("annulus", 2, inner, outer)
    ring, hole = Circle((0, 0), R).Face(), Circle((0, 0), r).Face()
    ring.edges.name, hole.edges.name = "outer", "inner"
    return mesh_of("annulus", ring - hole, 2, maxh, order, refine, unit=unit, is_delicate=delicate)


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
    radius : float
        Radius.
    height : float
        Height, along z.
    maxh, refine, split_corners
        As for ``box``.
    order
        As for ``disc``.
    """
    sizes = [
        ("radius", as_length("cylinder.radius", radius)),
        ("height", as_length("cylinder.height", height)),
    ]
    unit = unit_of("cylinder", 3, sizes, ["radius"])
    (_, radius), (_, height) = sizes
    solid = Cylinder(Pnt(0, 0, 0), Z, r=radius / unit, h=height / unit)
    solid.faces.name = "side"
    solid.faces.Min(Z).name, solid.faces.Max(Z).name = "bottom", "top"
    delicate = is_delicate((radius, height))
    options = {"unit": unit, "is_delicate": delicate, "split_corners": split_corners}
    return mesh_of("cylinder", solid, 3, maxh, order, refine, **options)


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
    radius : float
        Radius.
    maxh, refine
        As for ``box``.
    order
        As for ``disc``.
    """
    radius = as_length("sphere.radius", radius)
    unit = unit_of("sphere", 3, [("radius", radius)], ["radius"])
    solid = Sphere(Pnt(0, 0, 0), radius / unit)
    solid.faces.name = "wall"
    return mesh_of("sphere", solid, 3, maxh, order, refine, unit=unit)


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
    inner : float
        Inner radius.
    outer : float
        Outer radius, above the inner one.
    maxh, refine
        As for ``box``.
    order
        As for ``disc``.
    """
    r, R, unit, delicate = _radii("spherical_shell", 3, inner, outer)
    ball, core = Sphere(Pnt(0, 0, 0), R), Sphere(Pnt(0, 0, 0), r)
    ball.faces.name, core.faces.name = "outer", "inner"
    return mesh_of("spherical_shell", ball - core, 3, maxh, order, refine, unit=unit, is_delicate=delicate)


def _radii(owner: str, dim: int, inner: float, outer: float) -> tuple[float, float, float, bool]:
    """Both radii in their unit, that unit (m), and whether the shell is a delicate shape."""
    r, R = as_length(f"{owner}.inner", inner), as_length(f"{owner}.outer", outer)
    if not r < R:
        raise ParameterError(f"{owner}.inner", inner, f"a number < outer = {R:g}")
    sizes = [("inner", r), ("outer", R), ("thickness", R - r)]
    unit = unit_of(owner, dim, sizes, ["inner", "outer"])
    return r / unit, R / unit, unit, is_delicate(length for _, length in sizes)

"""Round domains: discs, annuli, cylinders, spheres, spherical shells.  Their cells are curved."""

from __future__ import annotations

from collections.abc import Mapping

from netgen.occ import Circle, Cylinder, Pnt, Sphere, Z
from ngsolve import Mesh

from ngvisco.errors import ParameterError
from ngvisco.geometries.meshing import CURVE_ORDER, check_lengths, mesh_of


def disc(
    radius: float, maxh: float, *, order: int = CURVE_ORDER, refine: Mapping[str, float] | None = None
) -> Mesh:
    """A disc about the origin; wall ``wall``.

    Parameters
    ----------
    radius, maxh : float
        m.
    order : int
        Of the curved cells; 1 gives a polygon, on which slip is refused.
    refine : mapping of walls to cell sizes, optional
    """
    check_lengths("disc", radius=radius)
    face = Circle((0, 0), radius).Face()
    face.edges.name = "wall"
    return mesh_of("disc", face, 2, maxh, order, refine)


def annulus(
    inner: float,
    outer: float,
    maxh: float,
    *,
    order: int = CURVE_ORDER,
    refine: Mapping[str, float] | None = None,
) -> Mesh:
    """The ring inner < r < outer about the origin; walls ``inner`` and ``outer``.  Lengths in m."""
    _check_radii("annulus", inner, outer)
    ring, hole = Circle((0, 0), outer).Face(), Circle((0, 0), inner).Face()
    ring.edges.name, hole.edges.name = "outer", "inner"
    return mesh_of("annulus", ring - hole, 2, maxh, order, refine)


def cylinder(
    radius: float,
    height: float,
    maxh: float,
    *,
    order: int = CURVE_ORDER,
    refine: Mapping[str, float] | None = None,
) -> Mesh:
    """The cylinder r < radius, 0 < z < height; walls ``side``, ``bottom``, ``top``.  Lengths in m."""
    check_lengths("cylinder", radius=radius, height=height)
    solid = Cylinder(Pnt(0, 0, 0), Z, r=radius, h=height)
    solid.faces.name = "side"
    solid.faces.Min(Z).name, solid.faces.Max(Z).name = "bottom", "top"
    return mesh_of("cylinder", solid, 3, maxh, order, refine)


def sphere(
    radius: float, maxh: float, *, order: int = CURVE_ORDER, refine: Mapping[str, float] | None = None
) -> Mesh:
    """A ball about the origin; wall ``wall``.  Lengths in m."""
    check_lengths("sphere", radius=radius)
    solid = Sphere(Pnt(0, 0, 0), radius)
    solid.faces.name = "wall"
    return mesh_of("sphere", solid, 3, maxh, order, refine)


def spherical_shell(
    inner: float,
    outer: float,
    maxh: float,
    *,
    order: int = CURVE_ORDER,
    refine: Mapping[str, float] | None = None,
) -> Mesh:
    """The shell inner < r < outer about the origin; walls ``inner`` and ``outer``.  Lengths in m."""
    _check_radii("spherical_shell", inner, outer)
    ball, core = Sphere(Pnt(0, 0, 0), outer), Sphere(Pnt(0, 0, 0), inner)
    ball.faces.name, core.faces.name = "outer", "inner"
    return mesh_of("spherical_shell", ball - core, 3, maxh, order, refine)


def _check_radii(owner: str, inner: float, outer: float) -> None:
    check_lengths(owner, inner=inner, outer=outer)
    if not inner < outer:
        raise ParameterError(f"{owner}.inner", inner, f"a number < outer = {outer:g}")

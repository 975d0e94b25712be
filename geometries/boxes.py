"""Boxes, channels, bars and a block with a hole."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from netgen.occ import (
    Box,
    Circle,
    Cylinder,
    IdentificationType,
    Pnt,
    Rectangle,
    WorkPlane,
    X,
    Y,
    Z,
    gp_Trsf,
    gp_Vec,
)
from ngsolve import Mesh

from ngvisco.errors import ParameterError, Quantity, as_number, require_names
from ngvisco.geometries.meshing import (
    CURVE_ORDER,
    CellSize,
    Domain,
    Length,
    as_length,
    box_lengths,
)

_WALLS = {
    2: (("left", -X), ("right", X), ("bottom", -Y), ("top", Y)),
    3: (("left", -X), ("right", X), ("front", -Y), ("back", Y), ("bottom", -Z), ("top", Z)),
}


def box(
    size: Annotated[Sequence[float], Quantity("m", example=[1.0, 1.0])],
    maxh: CellSize,
    *,
    periodic: Annotated[str | Sequence[str], Quantity(example="x")] = (),
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"left": 0.05})] = None,
    split_corners: bool = False,
) -> Mesh:
    """A box [0, size_1] x [0, size_2] (x [0, size_3]).

    Walls: ``left``/``right`` (x), ``bottom``/``top`` (y in 2D, z in 3D), ``front``/``back`` (y in 3D).

    Parameters
    ----------
    size : two or three positive numbers
        Edge lengths, two (plane strain) or three.
    maxh : float
        Largest size of a cell.
    periodic : some of "x", "y", "z", e.g. "x" or "xy"
        Directions in which opposite walls are one, some of "x", "y", "z".
    refine : mapping of walls to cell sizes, optional
        Smaller cell sizes at walls, by the wall's name.
    split_corners : bool
        Divide cells whose edges at a vertex all lie on walls, so that walls with different velocities may
        meet there.

    Raises
    ------
    ParameterError
        If a length is not a finite positive number, or their number is not 2 or 3.
    """
    lengths = [("size", length) for length in box_lengths("box", size)]
    return _box("box", lengths, maxh, periodic, refine, split_corners)


def channel(
    length: Length,
    height: Length,
    maxh: CellSize,
    *,
    width: Annotated[float | None, Quantity("m", example=1.0)] = None,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"top": 0.05})] = None,
    split_corners: bool = False,
) -> Mesh:
    """A channel along x between the walls ``bottom`` and ``top``, periodic in x (and in y in 3D).

    Parameters
    ----------
    length : float
        Length, along x.
    height : float
        Height, along y in 2D and z in 3D.
    width : float, optional
        Width along y; makes the channel three-dimensional.
    maxh, refine, split_corners
        As for ``box``.
    """
    sizes = [("length", length), ("height", height)]
    if width is not None:
        sizes.insert(1, ("width", width))
    sizes = [(name, as_length(f"channel.{name}", value)) for name, value in sizes]
    return _box("channel", sizes, maxh, "x" if width is None else "xy", refine, split_corners)


def bar(
    length: Length,
    thickness: Length,
    maxh: CellSize,
    *,
    dim: int = 2,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"left": 0.05})] = None,
    split_corners: bool = False,
) -> Mesh:
    """A bar along x of square cross-section, with the walls of a box.

    Parameters
    ----------
    length : float
        Length, along x.
    thickness : float
        Edge of the square cross-section.
    dim : 2 or 3
        2 (plane strain) or 3.
    maxh, refine, split_corners
        As for ``box``.
    """
    if isinstance(dim, bool) or dim not in (2, 3):
        raise ParameterError("bar.dim", dim, "2 or 3")
    across = [("thickness", as_length("bar.thickness", thickness))] * (int(dim) - 1)
    sizes = [("length", as_length("bar.length", length)), *across]
    return _box("bar", sizes, maxh, (), refine, split_corners)


def block_with_hole(
    size: Annotated[Sequence[float], Quantity("m", example=[1.0, 1.0])],
    radius: Length,
    maxh: CellSize,
    *,
    fillet: Annotated[float, Quantity("m", example=0.05)] = 0.0,
    order: int = CURVE_ORDER,
    refine: Annotated[Mapping[str, float] | None, Quantity("m", example={"left": 0.05})] = None,
    split_corners: bool = False,
) -> Mesh:
    """A box with a circular hole in its middle, in 3D along y; walls of the box, ``hole`` and ``fillet``.

    Parameters
    ----------
    radius : float
        Radius of the hole, less than half of the edges that it is between.
    fillet : float
        Radius to which corners (2D), or edges and corners (3D), of the box are rounded, less than half of its
        edges; 0 leaves them sharp.
    order : int
        Polynomial order of curved cells.
    size, maxh, refine, split_corners
        As for ``box``.
    """
    lengths = box_lengths("block_with_hole", size)
    dim, radius = len(lengths), as_length("block_with_hole.radius", radius)
    across = (lengths[0], lengths[-1])
    if 2 * radius >= min(across):
        raise ParameterError("block_with_hole.radius", radius, f"a number < {min(across) / 2:g}")
    parts = [*(("size", length) for length in lengths), ("radius", radius)]
    parts.append(("radius", min(across) / 2 - radius))  # the wall that is left
    if as_number(fillet) != 0:
        fillet = as_length("block_with_hole.fillet", fillet)
        if 2 * fillet >= min(lengths):
            raise ParameterError("block_with_hole.fillet", fillet, f"a number < {min(lengths) / 2:g}")
        parts += [("fillet", fillet), ("fillet", min(lengths) / 2 - fillet)]
    domain = Domain("block_with_hole", dim, parts, ["radius", "fillet"])
    scaled, r = [length / domain.unit for length in lengths], radius / domain.unit
    shape = _block(scaled)
    if fillet != 0:
        shape = _rounded(shape, scaled, fillet / domain.unit)
    if dim == 2:
        hole = Circle((scaled[0] / 2, scaled[1] / 2), r).Face()
        hole.edges.name = "hole"
    else:
        hole = Cylinder(Pnt(scaled[0] / 2, 0, scaled[2] / 2), Y, r=r, h=scaled[1])
        hole.faces.name = "hole"
    return domain.mesh(shape - hole, maxh, order, refine, split_corners)


def _box(
    owner: str,
    lengths: Sequence[tuple[str, float]],
    maxh: float,
    periodic: str | Sequence[str],
    refine: Mapping[str, float] | None,
    split_corners: bool,
) -> Mesh:
    """A box from the names and values of its edges' lengths, m."""
    domain = Domain(owner, len(lengths), lengths)
    scaled = [length / domain.unit for _, length in lengths]
    shape = _block(scaled)
    _identify(shape, domain.dim, scaled, periodic)
    return domain.mesh(shape, maxh, 1, refine, split_corners)


def _block(lengths: Sequence[float]) -> Any:
    """The rectangle or box with its walls named, in the unit of the lengths."""
    dim = len(lengths)
    shape = Rectangle(*lengths).Face() if dim == 2 else Box(Pnt(0, 0, 0), Pnt(*lengths))
    walls = shape.edges if dim == 2 else shape.faces
    for name, direction in _WALLS[dim]:
        walls.Max(direction).name = name
    return shape


def _rounded(shape: Any, lengths: Sequence[float], fillet: float) -> Any:
    """The box with its walls, all its corners or edges rounded; what is new has the name ``fillet``."""
    if len(lengths) == 2:
        path = WorkPlane().MoveTo(fillet, 0)
        for length in (*lengths, *lengths):
            path = path.Line(length - 2 * fillet).Arc(fillet, 90)
        rounded = path.Face()
        walls = rounded.edges
    else:
        rounded = shape.MakeFillet(shape.edges, fillet)
        walls = rounded.faces
    # a wall keeps its middle; names and order of MakeFillet's faces are not to be relied upon
    sharp = shape.edges if len(lengths) == 2 else shape.faces
    names = {_middle(wall): wall.name for wall in sharp}
    for wall in walls:
        wall.name = names.get(_middle(wall), "fillet")
    return rounded


def _middle(wall: Any) -> tuple[float, ...]:
    return tuple(round(float(c), 9) + 0.0 for c in wall.center)


def _identify(shape: Any, dim: int, lengths: Sequence[float], periodic: str | Sequence[str]) -> None:
    walls = shape.edges if dim == 2 else shape.faces
    axes = dict(zip("xyz", (X, Y, Z)[:dim], strict=False))
    for name in periodic if isinstance(periodic, str) else require_names("box.periodic", periodic):
        if name not in axes:
            raise ParameterError("box.periodic", periodic, f"some of {', '.join(axes)}")
        shift = [0.0, 0.0, 0.0]
        shift["xyz".index(name)] = lengths["xyz".index(name)]
        walls.Min(axes[name]).Identify(
            walls.Max(axes[name]),
            f"periodic_{name}",
            IdentificationType.PERIODIC,
            gp_Trsf.Translation(gp_Vec(*shift)),
        )

"""Boxes, channels, bars, a block with a hole, and boxes of rows of cells for strips, columns and layers."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import netgen.occ as occ
from ngsolve import Mesh
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngvisco.errors import ParameterError, Quantity, as_integer, as_number, require_names, require_type
from ngvisco.geometries import meshing
from ngvisco.geometries.meshing import (
    CURVE_ORDER,
    MAX_CELLS,
    CellSize,
    Domain,
    Length,
    as_length,
    box_lengths,
    split_corner_cells,
    with_middles,
)

_WALLS = {
    2: ("left", "right", "bottom", "top"),
    3: ("left", "right", "front", "back", "bottom", "top"),
}
"""Names of the walls by dimension, in pairs at the lower and upper end of each axis."""
_AXES = (occ.X, occ.Y, occ.Z)
_NAMES = {"back": "left", "front": "right", "left": "front", "right": "back"}
"""Names of the walls of ``box`` by NGSolve's names for structured boxes in 3D."""
_STEEPEST = 1e6
"""Largest ratio of the lengths of the last and first row, or its inverse; 1e14 makes Newton's method fail."""


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
        Lengths of the edges, two (plane strain) or three.
    maxh : float
        Largest size of a cell.
    periodic : some of "x", "y", "z", e.g. "x" or "xy"
        Directions in which opposite walls are identified, some of "x", "y", "z".
    refine : mapping of walls to cell sizes, optional
        Smaller cell sizes at walls, by the wall's name.
    split_corners : bool
        Whether to divide cells whose edges at a vertex all lie on walls, so that walls with different
        velocities may meet there.

    Raises
    ------
    ParameterError
        If a length is not a finite positive number, or there are not two or three lengths.
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
        Length along x.
    height : float
        Height along y in 2D, along z in 3D.
    width : float, optional
        Width along y of a three-dimensional channel.
    maxh, refine, split_corners
        As for ``box``.
    """
    sizes = [("length", length), *([] if width is None else [("width", width)]), ("height", height)]
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
        Length along x.
    thickness : float
        Edge of the square cross-section.
    dim : 2 or 3
        Dimension, 2 (plane strain) or 3.
    maxh, refine, split_corners
        As for ``box``.
    """
    if isinstance(dim, bool) or dim not in (2, 3):
        raise ParameterError("bar.dim", dim, "2 or 3")
    sizes = [("length", length), *[("thickness", thickness)] * (int(dim) - 1)]
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
        Radius of the hole, less than half of the edges across the hole.
    fillet : float
        Radius of the box's rounded corners (2D), or edges and corners (3D), less than half of each edge; with
        0 edges and corners stay sharp.
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
    parts.append(("radius", min(across) / 2 - radius))  # the remaining thickness
    if as_number(fillet) != 0:
        fillet = as_length("block_with_hole.fillet", fillet)
        if 2 * fillet >= min(lengths):
            raise ParameterError("block_with_hole.fillet", fillet, f"a number < {min(lengths) / 2:g}")
        parts += [("fillet", fillet), ("fillet", min(lengths) / 2 - fillet)]
    domain = Domain("block_with_hole", dim, parts, ["radius", "fillet"])
    scaled, r = domain.lengths[:dim], domain.lengths[dim]
    shape = _block(scaled)
    if fillet != 0:
        shape = _rounded(shape, scaled, fillet / domain.unit)
    if dim == 2:
        hole = occ.Circle((scaled[0] / 2, scaled[1] / 2), r).Face()
        hole.edges.name = "hole"
    else:
        hole = occ.Cylinder(occ.Pnt(scaled[0] / 2, 0, scaled[2] / 2), occ.Y, r=r, h=scaled[1])
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
    domain = Domain(owner, len(lengths), lengths)
    shape = _block(domain.lengths)
    walls = shape.edges if domain.dim == 2 else shape.faces
    for name in _directions(f"{owner}.periodic", periodic, domain.dim):
        number = "xyz".index(name)
        axis, shift = _AXES[number], [0.0, 0.0, 0.0]
        shift[number] = domain.lengths[number]
        moved = occ.gp_Trsf.Translation(occ.gp_Vec(*shift))
        there = walls.Max(axis)
        walls.Min(axis).Identify(there, f"periodic_{name}", occ.IdentificationType.PERIODIC, moved)
    return domain.mesh(shape, maxh, 1, refine, split_corners)


def _directions(field: str, periodic: str | Sequence[str], dim: int) -> list[str]:
    """Names of directions, some of x, y, z; raises ParameterError for other names and for one given twice."""
    names = list(periodic) if isinstance(periodic, str) else require_names(field, periodic)
    if not set(names) <= set("xyz"[:dim]) or len(set(names)) < len(names):
        raise ParameterError(field, periodic, f"some of {', '.join('xyz'[:dim])}, and none twice")
    return names


def _block(lengths: Sequence[float]) -> Any:
    dim = len(lengths)
    shape = occ.Rectangle(*lengths).Face() if dim == 2 else occ.Box(occ.Pnt(0, 0, 0), occ.Pnt(*lengths))
    walls = shape.edges if dim == 2 else shape.faces
    for number, name in enumerate(_WALLS[dim]):
        axis = _AXES[number // 2]
        walls.Max(axis if number % 2 else -axis).name = name
    return shape


def _rounded(shape: Any, lengths: Sequence[float], fillet: float) -> Any:
    """Round all corners or edges of the box; walls keep their names, and new walls are called ``fillet``."""
    if len(lengths) == 2:
        path = occ.WorkPlane().MoveTo(fillet, 0)
        for length in (*lengths, *lengths):
            path = path.Line(length - 2 * fillet).Arc(fillet, 90)
        rounded = path.Face()
        walls = rounded.edges
    else:
        rounded = shape.MakeFillet(shape.edges, fillet)
        walls = rounded.faces
    # walls are found by their middles, because names and order of MakeFillet's faces are unreliable
    sharp = shape.edges if len(lengths) == 2 else shape.faces
    names = {_middle(wall): wall.name for wall in sharp}
    for wall in walls:
        wall.name = names.get(_middle(wall), "fillet")
    return rounded


def _middle(wall: Any) -> tuple[float, ...]:
    return tuple(round(float(c), 9) + 0.0 for c in wall.center)


def structured_box(
    size: Annotated[Sequence[float], Quantity("m", example=[1.0, 1.0])],
    cells: Annotated[Sequence[int], Quantity("1", example=[2, 40])],
    *,
    periodic: Annotated[str | Sequence[str], Quantity(example="x")] = (),
    grading: Annotated[Mapping[str, float] | None, Quantity("1", example={"y": 5.0})] = None,
    crossed: bool = False,
    split_corners: bool = False,
    refine_corners: Annotated[Mapping[str, int] | None, Quantity("1", example={"top": 3})] = None,
) -> Mesh:
    """A box [0, size_1] x [0, size_2] (x [0, size_3]) of rows of cells, with the walls of ``box``.

    Each rectangle of the grid is divided into two triangles, or into four if it is crossed. Each cuboid is
    divided into six tetrahedra. For one-dimensional problems take a column that is one or two periodic cells
    wide.

    Parameters
    ----------
    cells : as many whole numbers
        Number of rows of cells along each direction, >= 1.
    grading : mapping of directions to numbers from 1e-6 to 1e6, optional
        Ratio of the last row's length to the first row's, by direction, from 1e-6 to 1e6; by default 1.  The
        lengths of the rows form a geometric sequence.
    crossed : bool
        Whether rectangles have both diagonals, in two dimensions.  With k = 1 and m = 0 rectangles with one
        diagonal lock if K is much larger than G.
    refine_corners : mapping of walls to whole numbers >= 0, optional
        Number of times that cells at the ends of a wall are halved, by the wall's name.  Where the velocity
        of a lid jumps at its ends, the computed velocity changes over one cell.
    size, periodic, split_corners
        As for ``box``.

    Raises
    ------
    ParameterError
        For invalid lengths or numbers of cells, more than a million cells, a direction that the box does not
        have, a steeper grading, or crossed cuboids.
    """
    lengths = box_lengths("structured_box", size)
    dim = len(lengths)
    counts = [as_integer(n) for n in cells] if isinstance(cells, (tuple, list)) else []
    if len(counts) != dim or any(n is None or n < 1 for n in counts):
        raise ParameterError("structured_box.cells", cells, f"{dim} whole numbers >= 1")
    require_type("structured_box.crossed", crossed, bool)
    if crossed and dim == 3:
        raise ParameterError("structured_box.crossed", crossed, "false in three dimensions")
    number = (4 if crossed else 2 if dim == 2 else 6) * math.prod(n or 1 for n in counts)
    if number > MAX_CELLS:
        kind = "triangles" if dim == 2 else "tetrahedra"
        raise ParameterError(
            "structured_box.cells", cells, f"numbers that make at most {MAX_CELLS} {kind}, not {number}"
        )
    axes = "xyz"[:dim]
    require_type("structured_box.split_corners", split_corners, bool)
    directions = _directions("structured_box.periodic", periodic, dim)
    rows = [_spacing(axis, n or 1, grading) for axis, n in zip(axes, counts, strict=True)]
    for name in grading or {}:
        if name not in axes:
            raise ParameterError(
                "structured_box.grading", grading, f"ratios of cell sizes along {', '.join(axes)}"
            )

    def place(*point: float) -> tuple[float, ...]:
        return tuple(length * row(s) for length, row, s in zip(lengths, rows, point, strict=True))

    options = {f"n{axis}": n for axis, n in zip(axes, counts, strict=True)}
    options |= {f"periodic_{axis}": axis in directions for axis in axes}
    if dim == 2:
        mesh = MakeStructured2DMesh(quads=crossed, mapping=place, **options)
        mesh = with_middles(mesh, range(mesh.ne)) if crossed else mesh
    else:
        mesh = MakeStructured3DMesh(hexes=False, mapping=place, **options)
        for number, name in enumerate(mesh.GetBoundaries()):
            mesh.ngmesh.SetBCName(number, _NAMES.get(name, name))
        mesh = Mesh(mesh.ngmesh)
    mesh = split_corner_cells(mesh) if split_corners else mesh
    if refine_corners is None:
        return mesh
    return meshing.corners_refined(mesh, refine_corners, "structured_box.refine_corners")


def _spacing(axis: str, rows: int, grading: Mapping[str, float] | None) -> Callable[[float], float]:
    """Place of a grid line, from 0 to 1, as a function of its number over the number of rows."""
    ratio = (grading or {}).get(axis, 1.0)
    number = as_number(ratio)
    if number is None or not 1 / _STEEPEST <= number <= _STEEPEST:
        expected = f"a number between {1 / _STEEPEST:g} and {_STEEPEST:g}"
        raise ParameterError(f"structured_box.grading[{axis!r}]", ratio, expected)
    if rows == 1 or number == 1:
        return lambda s: s
    growth = number ** (1 / (rows - 1))
    return lambda s: (growth ** (s * rows) - 1) / (growth**rows - 1)

"""Boxes of triangles or tetrahedra in rows, evenly spaced or graded: thin strips, columns, layers."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated

from ngsolve import Mesh
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngvisco.errors import ParameterError, Quantity, as_integer, as_number, require_names, require_type
from ngvisco.geometries.corners import split_corner_cells
from ngvisco.geometries.meshing import MAX_CELLS, box_lengths

_NAMES = {"back": "left", "front": "right", "left": "front", "right": "back"}
"""NGSolve's names of the walls of a structured box in 3D, and those of ``box``."""


def structured_box(
    size: Annotated[Sequence[float], Quantity("m", example=[1.0, 1.0])],
    cells: Annotated[Sequence[int], Quantity("1", example=[2, 40])],
    *,
    periodic: Annotated[str | Sequence[str], Quantity(example="x")] = (),
    grading: Annotated[Mapping[str, float] | None, Quantity("1", example={"y": 5.0})] = None,
    split_corners: bool = False,
) -> Mesh:
    """A box [0, size_1] x [0, size_2] (x [0, size_3]) of rows of cells, with the walls of ``box``.

    A rectangle of the grid is two triangles, a cuboid six tetrahedra.  A column that is uniform across, the
    set-up of problems in one dimension, is one or two periodic cells wide.

    Parameters
    ----------
    cells : as many whole numbers
        Rows of cells along each direction, >= 1.
    grading : mapping of directions to numbers from 1e-6 to 1e6, optional
        Length of the last row over that of the first one, by direction, from 1e-6 to 1e6; geometric between
        them, 1 where nothing is said.
    size, periodic, split_corners
        As for ``box``.

    Raises
    ------
    ParameterError
        For lengths or numbers of cells that are none, more than a million cells, another direction than the
        box has, or steeper grading.
    """
    lengths = box_lengths("structured_box", size)
    dim = len(lengths)
    counts = [as_integer(n) for n in cells] if isinstance(cells, (tuple, list)) else []
    if len(counts) != dim or any(n is None or n < 1 for n in counts):
        raise ParameterError("structured_box.cells", cells, f"{dim} whole numbers >= 1")
    number = (2 if dim == 2 else 6) * math.prod(n or 1 for n in counts)
    if number > MAX_CELLS:
        kind = "triangles" if dim == 2 else "tetrahedra"
        raise ParameterError("structured_box.cells", cells, f"at most {MAX_CELLS} {kind}, these are {number}")
    axes = "xyz"[:dim]
    require_type("structured_box.split_corners", split_corners, bool)
    directions = list(periodic) if isinstance(periodic, str) else require_names(_FIELD, periodic)
    for name in directions:
        if name not in axes:
            raise ParameterError(_FIELD, periodic, f"some of {', '.join(axes)}")
    rows = [_spacing(axis, n or 1, grading) for axis, n in zip(axes, counts, strict=True)]
    for name in grading or {}:
        if name not in axes:
            raise ParameterError("structured_box.grading", grading, f"ratios for some of {', '.join(axes)}")

    def place(*point: float) -> tuple[float, ...]:
        return tuple(length * row(s) for length, row, s in zip(lengths, rows, point, strict=True))

    options = {f"n{axis}": n for axis, n in zip(axes, counts, strict=True)}
    options |= {f"periodic_{axis}": axis in directions for axis in axes}
    if dim == 2:
        mesh = MakeStructured2DMesh(quads=False, mapping=place, **options)
        return split_corner_cells(mesh) if split_corners else mesh
    mesh = MakeStructured3DMesh(hexes=False, mapping=place, **options)
    for number, name in enumerate(mesh.GetBoundaries()):
        mesh.ngmesh.SetBCName(number, _NAMES.get(name, name))
    mesh = Mesh(mesh.ngmesh)
    return split_corner_cells(mesh) if split_corners else mesh


_FIELD = "structured_box.periodic"

_STEEPEST = 1e6
"""Last row over the first one, or the other way round; with 1e14 Newton's iteration fails."""


def _spacing(axis: str, rows: int, grading: Mapping[str, float] | None) -> Callable[[float], float]:
    """The place of a grid line, of 1, as a function of its number over that of the rows."""
    ratio = (grading or {}).get(axis, 1.0)
    number = as_number(ratio)
    if number is None or not 1 / _STEEPEST <= number <= _STEEPEST:
        expected = f"a number between {1 / _STEEPEST:g} and {_STEEPEST:g}"
        raise ParameterError(f"structured_box.grading[{axis!r}]", ratio, expected)
    if rows == 1 or number == 1:
        return lambda s: s
    growth = number ** (1 / (rows - 1))
    return lambda s: (growth ** (s * rows) - 1) / (growth**rows - 1)

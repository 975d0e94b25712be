"""What all geometries share: checks of sizes, units of length, local refinement, meshing with curved cells.

OpenCASCADE and Netgen compare lengths with absolute tolerances of 1e-7 to 1e-6.  Squares of 6e5 m ended
the process, a box of 1e-6 m lost names of walls, one of 1e-12 m ended the process.  So a domain that is
far from order one is built and meshed in a unit of length of its own, a power of two, and the points are
scaled back: nothing is rounded by that.
"""

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from netgen.meshing import NetgenGeometry
from netgen.occ import OCCGeometry, Pnt
from ngsolve import BND, CF, VOL, Integrate, Mesh

from ngvisco.errors import (
    MeshError,
    ParameterError,
    Quantity,
    UnknownNameError,
    as_integer,
    as_number,
    require_names,
    require_type,
)
from ngvisco.geometries.corners import split_corner_cells

Length: TypeAlias = Annotated[float, Quantity("m", "> 0", 1.0)]
CellSize: TypeAlias = Annotated[float, Quantity("m", "> 0", 0.1)]

CURVE_ORDER = 3
"""Order of curved cells: one above the default velocity, so that the geometry's error is not the largest."""

MAX_CELLS = 1_000_000
"""Cells above which a mesh is refused before it is made: Netgen takes a minute or more for them."""

_SIZES = (1e-30, 1e30)  # m; areas and volumes are far from under- and overflow
_ORDER_ONE = (1e-2, 1e2)
_SLENDER = 1e-6  # smallest over largest length; OpenCASCADE refuses to build what is below 1e-7
_DELICATE = 1e-3  # the same ratio, below which Netgen is tried in a process of its own
_PATIENCE = 300.0  # s for that trial
_SMALLEST_ROUND = {2: 1e-4, 3: 1e-3}
"""Radii, m, below which OpenCASCADE's projections onto curves (2D) and surfaces (3D) are wrong: of a disc of
1e-5 m the area is wrong by 1e-7, of a ball of 1e-4 m the volume by 4e-3."""


def box_lengths(owner: str, size: Sequence[float]) -> tuple[float, ...]:
    """The edges' lengths, m; raises ParameterError."""
    try:
        lengths = tuple(as_length(f"{owner}.size", length) for length in size)
    except TypeError:
        lengths = ()
    except ParameterError as error:
        raise ParameterError(error.field, size, f"two or three lengths, each {error.expected}") from None
    if len(lengths) not in (2, 3):
        raise ParameterError(f"{owner}.size", size, "two or three finite numbers > 0")
    return lengths


def as_length(field: str, value: object) -> float:
    """The length as a float; raises ParameterError unless it is a finite number > 0."""
    number = as_number(value)
    if number is None or not number > 0:
        raise ParameterError(field, value, "a finite number > 0")
    if not _SIZES[0] <= number <= _SIZES[1]:
        raise ParameterError(field, value, f"a length between {_SIZES[0]:g} and {_SIZES[1]:g} m")
    return number


def check_order(owner: str, order: int) -> None:
    """Raise ParameterError unless the order of curved cells is an integer from 1 to 10."""
    number = as_integer(order)
    if number is None or not 1 <= number <= 10:
        raise ParameterError(f"{owner}.order", order, "an integer from 1 to 10")


class Domain:
    """A domain that is built and meshed in a unit of length in which it is of order one.

    Parameters
    ----------
    owner : str
        What errors call it.
    dim : int
    lengths : sequence of (parameter, float)
        Sizes, radii and gaps, m.
    round_ones : names
        The parameters that are radii of curved walls.

    Attributes
    ----------
    unit : float
        m, a power of two, 1 if the domain is of order one.
    is_round : bool
        Whether it has curved walls: a mesh that is refined or curved later asks for them.
    is_delicate : bool
        Whether its lengths differ so much that Netgen is tried in a process of its own first: it may crash.

    Raises
    ------
    ParameterError
        If a length is not more than 1e-6 of the largest one, or a radius too small for OpenCASCADE.
    """

    def __init__(
        self, owner: str, dim: int, lengths: Sequence[tuple[str, float]], round_ones: Sequence[str] = ()
    ) -> None:
        self.owner, self.dim, self.is_round = owner, dim, bool(round_ones)
        values = [value for _, value in lengths]
        largest = max(values)
        for name, value in lengths:
            if not value >= _SLENDER * largest:
                expected = f"at least {_SLENDER:g} of the domain's largest length {largest:g} m"
                raise ParameterError(f"{owner}.{name}", value, expected)
            if name in round_ones and value < _SMALLEST_ROUND[dim]:
                expected = (
                    f"at least {_SMALLEST_ROUND[dim]:g} (curved walls are placed to 1e-7 only: take a "
                    "smaller unit of length, and all other quantities in it)"
                )
                raise ParameterError(f"{owner}.{name}", value, expected)
        self.unit = 1.0 if _ORDER_ONE[0] <= largest <= _ORDER_ONE[1] else 2.0 ** round(math.log2(largest))
        self.is_delicate = min(values) < _DELICATE * largest

    def mesh(
        self,
        shape: Any,
        maxh: float,
        order: int = 1,
        refine: Mapping[str, float] | None = None,
        split_corners: bool = False,
    ) -> Mesh:
        """Mesh an OCC shape in this unit, with smaller cells on the walls named in ``refine``, and curve it.

        ``maxh`` and ``refine`` are in m; ``split_corners`` divides the cells with all edges at a vertex on
        walls (``corners``).

        Raises
        ------
        ParameterError
            If a size is not a positive number, or would give more than ``MAX_CELLS`` cells.
        UnknownNameError
            For an unknown wall in ``refine``.
        MeshError
            If Netgen cannot mesh the shape.
        """
        owner, dim, unit = self.owner, self.dim, self.unit
        size = as_length(f"{owner}.maxh", maxh) / unit
        check_order(owner, order)
        require_type(f"{owner}.split_corners", split_corners, bool)
        walls = shape.edges if dim == 2 else shape.faces
        known = {str(wall.name) for wall in walls if wall.name}
        cells = {f"{owner}.maxh": (maxh, sum(part.mass for part in _interior(shape, dim)), size, dim)}
        if not isinstance(refine, Mapping | None):
            raise ParameterError(f"{owner}.refine", refine, "a mapping of walls to cell sizes")
        for name, value in (refine or {}).items():
            field = f"{owner}.refine[{name!r}]"
            local = as_length(field, value) / unit
            if name not in known:
                raise UnknownNameError("wall", name, known)
            named = [wall for wall in walls if wall.name == name]
            cells[field] = (value, sum(wall.mass for wall in named), local, dim - 1)
            for wall in named:
                wall.maxh = local
        for field, (value, measure, h, of) in cells.items():
            _check_count(field, value, measure, h, dim, of, unit)
        if self.is_delicate:
            _try_shape(owner, shape, dim, size)
        mesh = _generated(owner, shape, dim, size)
        _require_all(owner, shape, mesh, known, self.is_round)
        if unit != 1.0:
            mesh.ngmesh.Scale(unit)
            # what the mesh is refined and curved by; planes need no geometry
            scaled = shape.Scale(Pnt(0, 0, 0), unit)
            mesh.ngmesh.SetGeometry(OCCGeometry(scaled, dim=dim) if self.is_round else NetgenGeometry())
            mesh = Mesh(mesh.ngmesh)
        mesh = split_corner_cells(mesh) if split_corners else mesh
        return mesh.Curve(int(order)) if order > 1 else mesh


def _interior(shape: Any, dim: int) -> Any:
    return shape.faces if dim == 2 else shape.solids


_CELLS_PER = {2: 1 / 0.43, 3: 5.9}
"""Cells of size 1 in a unit square and cube, measured; sizes grow by 0.3 a length away from a wall."""
_GRADING = 0.3


def _check_count(field: str, value: float, measure: float, h: float, dim: int, of: int, unit: float) -> None:
    """Raise ParameterError for a cell size of the domain (of = dim) or a wall that gives too many cells."""
    # at a wall there are layers in which the size grows: int measure c / (h + 0.3 s)^dim ds
    factor = _CELLS_PER[dim] * measure / (1.0 if of == dim else _GRADING * (dim - 1))
    if not factor <= MAX_CELLS * h**of:
        least = (factor / MAX_CELLS) ** (1 / of) * unit
        count = math.exp(min(math.log(factor) - of * math.log(h), 700))
        raise ParameterError(field, value, f"at least {least:.2g}: this one makes about {count:.0e} cells")


def _generated(owner: str, shape: Any, dim: int, maxh: float) -> Mesh:
    """By one thread: Netgen's others wait for each other, for a second of a mesh of twelve tetrahedra."""
    try:
        return Mesh(OCCGeometry(shape, dim=dim).GenerateMesh(maxh=maxh, parallel_meshing=False))
    except Exception as error:  # OpenCASCADE and Netgen raise their own
        raise MeshError(f"{owner}: Netgen cannot mesh it ({error})") from error


def _require_all(owner: str, shape: Any, mesh: Mesh, walls: Iterable[str], is_round: bool) -> None:
    """Raise MeshError unless the mesh fills the shape and has its walls: Netgen only prints failures."""
    whole = sum(part.mass for part in _interior(shape, mesh.dim))
    filled = Integrate(CF(1.0), mesh) if mesh.ne else 0.0
    if abs(filled - whole) > (_POLYGON if is_round else _FLAT) * whole:
        raise MeshError(
            f"{owner}: Netgen's mesh fills {filled / whole:.3g} of the shape; expected another maxh, or "
            "lengths that differ less"
        )
    missing = sorted(set(walls) - set(mesh.GetBoundaries()))
    if missing:
        raise MeshError(
            f"{owner}: Netgen's mesh lacks the walls {', '.join(missing)}; expected a smaller maxh"
        )


_FLAT = 1e-6
_POLYGON = 0.4  # a coarse polygon fills so much less than its circle, or more than the ring about it


def try_apart(owner: str, what: str, code: str, *arguments: str, patience: float | None = None) -> None:
    """Raise MeshError if Netgen ends a process of its own by some code, or not within ``patience`` (s).

    The code finds what this process has found, also in a clone that is not installed, and its ``arguments``
    in ``sys.argv``.
    """
    code = f"import sys; sys.path[:] = {sys.path!r}\n{code}"
    command = [sys.executable, "-c", code, *arguments]
    try:
        trial = subprocess.run(command, capture_output=True, text=True, timeout=patience)
    except subprocess.TimeoutExpired as error:
        raise MeshError(f"{owner}: Netgen has no mesh of it after {patience:g} s") from error
    if trial.returncode != 0:
        said = trial.stderr.strip().splitlines()
        raise MeshError(f"{owner}: Netgen cannot {what} it ({said[-1] if said else 'it crashes'})")


def _try_shape(owner: str, shape: Any, dim: int, maxh: float) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        path = str(Path(scratch) / "shape.brep")
        shape.WriteBrep(path)
        try_apart(owner, "mesh", _TRIAL, path, str(dim), repr(maxh), patience=_PATIENCE)


_TRIAL = """
from netgen.occ import OCCGeometry
path, dim, maxh = sys.argv[1:]
shape = OCCGeometry(path).shape
OCCGeometry(shape, dim=int(dim)).GenerateMesh(maxh=float(maxh), parallel_meshing=False)
"""


def refine_walls(mesh: Mesh, names: Iterable[str], times: int = 1) -> Mesh:
    """Bisect the cells that touch the named walls ``times`` times: a boundary layer graded towards them.

    Each time halves the height of the cells at the wall, and their size along it as well: the cells keep
    their shape, they are not flattened as those of a layer that is extruded from the wall.
    The mesh is changed in place, curved again as it was, and returned.

    Raises
    ------
    UnknownNameError
        For a name that no boundary has.
    ParameterError
        If ``times`` is not an integer >= 0.
    """
    number = as_number(times)
    if number is None or number != int(number) or number < 0:
        raise ParameterError("refine_walls.times", times, "an integer >= 0")
    names = [names] if isinstance(names, str) else require_names("refine_walls.names", names)
    known = set(mesh.GetBoundaries())
    for name in names:
        if name not in known:
            raise UnknownNameError("boundary", name, known)
    order = mesh.GetCurveOrder()
    for _ in range(int(number)):
        near = {v for e in mesh.Elements(BND) if e.mat in names for v in e.vertices}
        for element in mesh.Elements(VOL):
            mesh.SetRefinementFlag(element, bool(near.intersection(element.vertices)))
        mesh.Refine()
        if order > 1:
            mesh.Curve(order)
    return mesh

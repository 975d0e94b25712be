"""Functions that all geometries share: checks of sizes, units of length, local refinement, meshing with
curved cells.

OpenCASCADE and Netgen compare lengths with absolute tolerances of 1e-7 to 1e-6.  Squares of 6e5 m and a box
of 1e-12 m ended the process; a box of 1e-6 m lost names of walls.  So a domain far from order one is built
and meshed in a suitable unit of length, and its points are scaled back.  The unit is a power of two, so that
scaling rounds no number.
"""

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from netgen.meshing import (
    Element2D,
    Element3D,
    ElementId2D,
    ElementId3D,
    MeshPoint,
    NetgenGeometry,
)
from netgen.meshing import Pnt as MeshPlace
from netgen.occ import OCCGeometry, Pnt
from ngsolve import BND, CF, EDGE, FACE, VOL, Integrate, Mesh, NodeId

from ngvisco.errors import (
    MeshError,
    ParameterError,
    Quantity,
    UnknownNameError,
    as_integer,
    as_number,
    require_known,
    require_names,
    require_type,
)

Length: TypeAlias = Annotated[float, Quantity("m", "> 0", 1.0)]
CellSize: TypeAlias = Annotated[float, Quantity("m", "> 0", 0.1)]

CURVE_ORDER = 3
"""Default order of curved cells, one above the velocity's, so that the geometry's error does not dominate."""

MAX_CELLS = 1_000_000
"""Largest number of cells of a mesh; Netgen takes a minute or more for such a mesh."""

_SIZES = (1e-30, 1e30)  # m; areas and volumes then stay far from under- and overflow
_ORDER_ONE = (1e-2, 1e2)
_SLENDER = 1e-6  # least ratio of smallest to largest length; OpenCASCADE refuses ratios below 1e-7
_DELICATE = 1e-3  # ratio of lengths below which Netgen is tried in a separate process
_PATIENCE = 300.0  # time limit of this trial, s
_CELLS_PER, _GRADING = {2: 1 / 0.43, 3: 5.9}, 0.3
"""Measured numbers of cells of size 1 in a unit square and cube, and growth of sizes per distance to a
wall."""
_FLAT = 1e-6
_POLYGON = 0.4  # relative error of the area of a coarse polygon in a circle or around a hole
_SMALLEST_ROUND = {2: 1e-4, 3: 1e-3}
"""Radii, m, below which OpenCASCADE's projections onto curves (2D) and surfaces (3D) are wrong: the area of a
disc of 1e-5 m is wrong by 1e-7, the volume of a ball of 1e-4 m by 4e-3."""


def box_lengths(owner: str, size: Sequence[float]) -> tuple[float, ...]:
    """Lengths of a box's edges, m; raises ParameterError unless ``size`` has two or three lengths."""
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
    """Length as a float, m; raises ParameterError unless it is a number > 0 of admissible size."""
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
    """A domain that is built and meshed in a unit of length in which its size is of order one.

    ``sizes`` are lengths and gaps, m, each with the parameter of ``owner`` on which it depends;
    ``round_ones`` names the radii of curved walls.  Raises ParameterError for an invalid length, a length
    below 1e-6 of the largest, or a radius too small for OpenCASCADE.

    Attributes
    ----------
    unit : float
        Unit of length, m, a power of two; 1 if the domain is of order one.
    lengths : list of float
        Sizes in this unit.
    is_round : bool
        Whether the domain has curved walls.  Its mesh then keeps the geometry, which later refinement and
        curving need.
    is_delicate : bool
        Whether lengths differ so much that Netgen may crash.  Netgen is then first tried in a separate
        process.
    """

    def __init__(
        self, owner: str, dim: int, sizes: Sequence[tuple[str, float]], round_ones: Sequence[str] = ()
    ) -> None:
        self.owner, self.dim, self.is_round = owner, dim, bool(round_ones)
        values = [as_length(f"{owner}.{name}", value) for name, value in sizes]
        largest = max(values)
        for (name, _), value in zip(sizes, values, strict=True):
            if not value >= _SLENDER * largest:
                expected = f"at least {_SLENDER:g} of the domain's largest length {largest:g} m"
                raise ParameterError(f"{owner}.{name}", value, expected)
            if name in round_ones and value < _SMALLEST_ROUND[dim]:
                expected = (
                    f"at least {_SMALLEST_ROUND[dim]:g}, since curved walls are placed only to 1e-7; take a "
                    "smaller unit of length, and give all other quantities in this unit"
                )
                raise ParameterError(f"{owner}.{name}", value, expected)
        self.unit = 1.0 if _ORDER_ONE[0] <= largest <= _ORDER_ONE[1] else 2.0 ** round(math.log2(largest))
        self.lengths = [value / self.unit for value in values]
        self.is_delicate = min(values) < _DELICATE * largest

    def mesh(
        self,
        shape: Any,
        maxh: float,
        order: int = 1,
        refine: Mapping[str, float] | None = None,
        split_corners: bool = False,
    ) -> Mesh:
        """Mesh an OCC shape given in this unit, with cell sizes ``refine`` on named walls, and curve it.

        ``maxh`` and ``refine`` are in m.  Raises ParameterError for a size that is no positive number, or
        that would give more than ``MAX_CELLS`` cells; UnknownNameError for an unknown wall in ``refine``;
        MeshError if Netgen cannot mesh the shape.
        """
        owner, dim, unit = self.owner, self.dim, self.unit
        size = as_length(f"{owner}.maxh", maxh) / unit
        check_order(owner, order)
        require_type(f"{owner}.split_corners", split_corners, bool)
        walls = shape.edges if dim == 2 else shape.faces
        known = {str(wall.name) for wall in walls if wall.name}
        whole = sum(part.mass for part in _interior(shape, dim))
        _check_count(f"{owner}.maxh", maxh, whole, size, dim, dim, unit)
        if not isinstance(refine, Mapping | None):
            raise ParameterError(f"{owner}.refine", refine, "a mapping of walls to cell sizes")
        for name, value in (refine or {}).items():
            field = f"{owner}.refine[{name!r}]"
            local = as_length(field, value) / unit
            if name not in known:
                raise UnknownNameError("wall", name, known, field)
            named = [wall for wall in walls if wall.name == name]
            _check_count(field, value, sum(wall.mass for wall in named), local, dim, dim - 1, unit)
            for wall in named:
                wall.maxh = local
        if self.is_delicate:
            try_shape(owner, shape, dim, size)
        try:  # one thread, because Netgen with several threads takes a second for a mesh of twelve cells
            mesh = Mesh(OCCGeometry(shape, dim=dim).GenerateMesh(maxh=size, parallel_meshing=False))
        except Exception as error:  # OpenCASCADE and Netgen have many error types
            raise MeshError(f"{owner}: Netgen cannot mesh the shape ({error})") from error
        _require_all(owner, shape, mesh, known, self.is_round)
        if unit != 1.0:
            mesh.ngmesh.Scale(unit)
            # refinement and curving need the geometry; plane walls do not
            scaled = shape.Scale(Pnt(0, 0, 0), unit)
            mesh.ngmesh.SetGeometry(OCCGeometry(scaled, dim=dim) if self.is_round else NetgenGeometry())
            mesh = Mesh(mesh.ngmesh)
        mesh = split_corner_cells(mesh) if split_corners else mesh
        return mesh.Curve(int(order)) if order > 1 else mesh


def _interior(shape: Any, dim: int) -> Any:
    return shape.faces if dim == 2 else shape.solids


def _check_count(field: str, value: float, measure: float, h: float, dim: int, n: int, unit: float) -> None:
    """Raise ParameterError if a cell size of the domain (n = dim) or of a wall makes too many cells."""
    # cell sizes grow with the distance s to a wall: int measure c / (h + 0.3 s)^dim ds
    factor = _CELLS_PER[dim] * measure / (1.0 if n == dim else _GRADING * (dim - 1))
    if not factor <= MAX_CELLS * h**n:
        # larger by 6 %, so that the number rounded to two digits is still large enough
        least = 1.06 * (factor / MAX_CELLS) ** (1 / n) * unit
        count = math.exp(min(math.log(factor) - n * math.log(h), 700))
        raise ParameterError(
            field, value, f"at least {least:.2g} m, since the given size makes about {count:.0e} cells"
        )


def _require_all(owner: str, shape: Any, mesh: Mesh, walls: Iterable[str], is_round: bool) -> None:
    """Raise MeshError unless the mesh fills the shape and has its walls; Netgen only prints failures."""
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


def try_apart(owner: str, action: str, code: str, *arguments: str, patience: float | None = None) -> None:
    """Run ``code`` in a separate process; raise MeshError if it fails or takes longer than ``patience``, s.

    The code has this process's ``sys.path``, for clones without installation, and its ``arguments`` in
    ``sys.argv``.
    """
    code = f"import sys; sys.path[:] = {sys.path!r}\n{code}"
    command = [sys.executable, "-c", code, *arguments]
    try:
        trial = subprocess.run(command, capture_output=True, text=True, timeout=patience)
    except subprocess.TimeoutExpired as error:
        raise MeshError(f"{owner}: Netgen has made no mesh of the shape in {patience:g} s") from error
    if trial.returncode != 0:
        messages = trial.stderr.strip().splitlines()
        raise MeshError(f"{owner}: Netgen cannot {action} ({messages[-1] if messages else 'Netgen crashes'})")


def try_shape(owner: str, shape: Any, dim: int, maxh: float) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        path = str(Path(scratch) / "shape.brep")
        shape.WriteBrep(path)
        try_apart(owner, "mesh the shape", _TRIAL, path, str(dim), repr(maxh), patience=_PATIENCE)


_TRIAL = """
from netgen.occ import OCCGeometry
path, dim, maxh = sys.argv[1:]
shape = OCCGeometry(path).shape
OCCGeometry(shape, dim=int(dim)).GenerateMesh(maxh=float(maxh), parallel_meshing=False)
"""


def refine_walls(mesh: Mesh, names: Iterable[str], times: int = 1) -> Mesh:
    """Bisect ``times`` times the cells that touch the named walls; cells are then graded towards the walls.

    Each bisection halves the height of the cells at a wall and their size along it.  So the cells keep their
    shape, unlike the flat cells of a layer extruded from the wall.  The mesh is changed in place, curved as
    before, and returned.

    Raises UnknownNameError for an unknown boundary; ParameterError unless ``times`` is an integer >= 0.
    """
    number = as_integer(times)
    if number is None or number < 0:
        raise ParameterError("refine_walls.times", times, "an integer >= 0")
    names = [names] if isinstance(names, str) else require_names("refine_walls.names", names)
    known = set(mesh.GetBoundaries())
    require_known("boundary", names, known, "refine_walls.names")
    return _bisected(mesh, number, names)


def refine_corners(mesh: Mesh, walls: Mapping[str, int]) -> Mesh:
    """Bisect the cells at the corners of the named walls, each as many times as ``walls`` says.

    A corner is a vertex at which the wall meets another wall; identified boundaries are no walls. Where a
    moving lid meets a wall at rest, the velocity along the lid jumps. The computed velocity changes over a
    cell, as if the lid were shorter by a part of the cell. Each bisection halves the cells at the corner. The
    mesh is changed in place, curved as before, and returned.

    Raises UnknownNameError for an unknown boundary; ParameterError unless the numbers are integers >= 0.
    """
    return corners_refined(mesh, walls, "refine_corners.walls")


def corners_refined(mesh: Mesh, walls: Mapping[str, int], field: str) -> Mesh:
    """Refine as ``refine_corners`` does; errors name the parameter ``field``."""
    if not isinstance(walls, Mapping):
        raise ParameterError(field, walls, "a mapping of walls to whole numbers >= 0")
    known = set(mesh.GetBoundaries())
    for name, times in walls.items():
        number = as_integer(times)
        if number is None or number < 0:
            raise ParameterError(f"{field}[{name!r}]", times, "an integer >= 0")
        if name not in known:
            raise UnknownNameError("boundary", name, known, field)
        others = _not_identified(mesh) - {name}
        mesh = _bisected(mesh, number, [name], others)
    return mesh


def _not_identified(mesh: Mesh) -> set[str]:
    """Names of the boundaries that are not identified with others."""
    kind = EDGE if mesh.dim == 2 else FACE
    identified = {int(facet) for pair, _ in mesh.GetPeriodicNodePairs(kind) for facet in pair}
    walls = ((e.mat, (e.edges if mesh.dim == 2 else e.faces)[0]) for e in mesh.Elements(BND))
    return {name for name, facet in walls if facet.nr not in identified}


def _bisected(mesh: Mesh, times: int, *walls: Iterable[str]) -> Mesh:
    """Bisect the cells with a vertex on a wall of each group of names, in place, curved as before."""
    order = mesh.GetCurveOrder()
    for _ in range(times):
        on = ({v for e in mesh.Elements(BND) if e.mat in names for v in e.vertices} for names in walls)
        near = set.intersection(*on)
        for element in mesh.Elements(VOL):
            mesh.SetRefinementFlag(element, bool(near.intersection(element.vertices)))
        mesh.Refine()
        if order > 1:
            mesh.Curve(order)
    return mesh


def corner_cells(mesh: Mesh) -> list[int]:
    """Numbers of the cells with a vertex whose edges in the cell all lie on walls.

    In 2D these are the cells with two adjacent edges on walls; in 3D they include the cells with two faces on
    walls.  Boundaries between two cells and identified boundaries are no walls.
    """
    wall = _edges_on_walls(mesh)
    found = []
    for cell in mesh.Elements():
        edges: dict[int, list[int]] = {}
        for edge in cell.edges:
            for vertex in mesh[edge].vertices:
                edges.setdefault(vertex.nr, []).append(edge.nr)
        if any(wall.issuperset(at) for at in edges.values()):
            found.append(cell.nr)
    return found


def split_corner_cells(mesh: Mesh) -> Mesh:
    """Divide each of the ``corner_cells`` at its midpoint into one cell for each facet (Alfeld).

    Walls that hold the velocity prescribe all of grad v at the vertex of such a cell. With one more edge,
    into the interior, div v is free at the vertex. Other cells, walls, subdomains and identified boundaries
    stay unchanged. The mesh is changed in place; use the returned mesh, which is curved as before.

    Raises MeshError for a distributed mesh, or for other cells than triangles, quadrilaterals and tetrahedra.
    """
    if mesh.comm.size > 1:
        raise MeshError("split_corner_cells: expected a mesh that is not yet distributed over ranks")
    return with_middles(mesh, corner_cells(mesh))


def with_middles(mesh: Mesh, cells: Sequence[int]) -> Mesh:
    """Divide some cells of a mesh at their midpoints, in place; use the returned mesh, curved as before."""
    if not cells:
        return mesh
    order, raw = mesh.GetCurveOrder(), mesh.ngmesh
    elements = raw.Elements2D() if mesh.dim == 2 else raw.Elements3D()
    number, made = (ElementId2D, Element2D) if mesh.dim == 2 else (ElementId3D, Element3D)
    for cell in cells:
        element = elements[number(cell)]
        corners, index = list(element.vertices), element.index
        if mesh.dim == 3 and len(corners) != 4:
            raise MeshError("split_corner_cells: expected triangles, quadrilaterals or tetrahedra")
        places = np.array([raw[corner].p for corner in corners])
        middle = raw.Add(MeshPoint(MeshPlace(*places.mean(axis=0))))
        if mesh.dim == 2:
            parts = [[a, b, middle] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        else:
            parts = [[middle if i == k else corner for i, corner in enumerate(corners)] for k in range(4)]
        elements[number(cell)] = made(index, parts[0])
        for part in parts[1:]:
            raw.Add(made(index, part))
    mesh = Mesh(raw)
    return mesh.Curve(order) if order > 1 else mesh


def _edges_on_walls(mesh: Mesh) -> set[int]:
    kind = EDGE if mesh.dim == 2 else FACE
    cells = np.zeros(mesh.nedge if mesh.dim == 2 else mesh.nface, dtype=int)
    for cell in mesh.Elements():
        for facet in cell.facets:
            cells[facet.nr] += 1
    for pair, _ in mesh.GetPeriodicNodePairs(kind):
        cells[list(pair)] = 2
    walls = [NodeId(kind, int(nr)) for nr in np.flatnonzero(cells == 1)]
    if mesh.dim == 2:
        return {wall.nr for wall in walls}
    return {edge.nr for wall in walls for edge in mesh[wall].edges}

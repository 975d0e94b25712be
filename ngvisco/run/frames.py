"""Frames of pictures, animations and scenes: states as arrays, from a VTK series or from present fields.

Cells have their own points, so that fields may jump between them.  The outline of a body is the line where
its volume fraction is one half.  Lines drawn cell by cell would have gaps where a jump passes one half.
Therefore the fraction is averaged at points where cells meet.  The line belongs to a smooth function through
the averages, and does not follow the edges of cells.
"""

import importlib
import os
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from ngsolve import CF, ET, VOL, CoefficientFunction, IntegrationRule, Mesh, x, y, z

from ngvisco.errors import CheckpointError, ParameterError, require_known
from ngvisco.shapes.fractions import subdivision

COMPONENTS = {3: list("123"), 9: [f"{i}{j}" for i in "123" for j in "123"]}
"""Names of the components of vectors and tensors in files, by the number of components."""
_KINDS = {"Float64": "<f8", "Float32": "<f4", "Int32": "<i4", "UInt8": "u1"}
_MARK = b'<AppendedData encoding="raw">'
_TRIANGLE, _QUADRILATERAL, _TETRAHEDRON = 5, 9, 10
_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
_CUTS = {
    1: (((0, 1), (0, 2), (0, 3)), [(0, 1, 2)]),
    2: (((0, 2), (0, 3), (1, 3), (1, 2)), [(0, 1, 2), (0, 2, 3)]),
    3: (((0, 3), (1, 3), (2, 3)), [(0, 1, 2)]),
}
"""Cut edges of a tetrahedron, and triangles of the section, by the number of the tetrahedron's points above
the plane. The points above the plane have the lowest numbers."""
_SAME = 1e-9  # share of the points' extent; points that are closer than this are one
_FLAT = 1e-6  # share of the largest triangle's area; a smaller triangle is a corner or an edge
_HALVINGS = 2  # number of halvings of the triangles in which a line is drawn


@dataclass(frozen=True)
class Frame:
    """One state: cells with points of their own, and fields at the points.

    Attributes
    ----------
    points : array (points, 3), m
    cells : array (cells, 3) of triangles' points in 2D, (cells, 4) of tetrahedra's in 3D
    fields : arrays (points, components) by name
    bodies : names of the fractions of bodies whose outlines are drawn
    """

    points: np.ndarray
    cells: np.ndarray
    fields: dict[str, np.ndarray]
    bodies: Sequence[str] = ()

    @property
    def dim(self) -> int:
        return self.cells.shape[1] - 1

    def scalar(self, name: str) -> np.ndarray:
        """Point values of a scalar, a norm of a vector or tensor, or a component ``NAME_i``, ``NAME_ij``.

        Raises UnknownNameError.
        """
        if name in self.fields:
            values = self.fields[name]
            return values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)
        parts = {
            f"{whole}_{label}": values[:, i]
            for whole, values in self.fields.items()
            for i, label in enumerate(COMPONENTS.get(values.shape[1], ()))
        }
        require_known("field", [name], (*self.fields, *parts), "fields")
        return parts[name]

    def fractions(self) -> list[np.ndarray]:
        """Fractions of the outlined bodies, (points,) each, equal in all cells that meet at a point."""
        return [averaged(self.points, self.scalar(name)) for name in self.bodies]

    def boundary(self) -> np.ndarray:
        """Boundary faces in 3D, which belong to one tetrahedron only, (faces, 3)."""
        faces = np.concatenate([self.cells[:, face] for face in _FACES])
        _, number = places(self.points)
        corners = np.sort(number[faces], axis=1)
        _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
        return faces[first[count == 1]]


def frame_of(
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    outlines: Sequence[CoefficientFunction] = (),
    pieces: int = 1,
) -> Frame:
    """The frame of scalar fields at present, by name; ``outlines`` are fractions of bodies to be outlined.

    Every cell is cut into ``pieces``^dim parts, a quadrilateral into twice as many triangles.  Raises
    ParameterError for a field that is not a scalar.
    """
    for name, value in fields.items():
        if value.dim != 1:
            raise ParameterError(f"field {name!r} of a picture", f"{value.dim} components", "a scalar field")
    bodies = {f"outline {i}": value for i, value in enumerate(outlines)}
    table, cells = sampled(mesh, CF((x, y, z, *fields.values(), *bodies.values())), pieces)
    columns = {name: table[:, [3 + i]] for i, name in enumerate((*fields, *bodies))}
    return Frame(table[:, :3], cells, columns, tuple(bodies))


class Lattice:
    """Points of the ``pieces``^dim simplices that each cell is cut into, a quadrilateral into twice as many.

    Attributes
    ----------
    cells : array (parts, dim + 1)
        Numbers of the simplices' corners; each cell has points of its own.
    rules : dict of element types to IntegrationRule
        Integration rules that have these points with the weight 1 on the reference cell: "integrals" by these
        rules are sums over the points.
    """

    def __init__(self, mesh: Mesh, pieces: int) -> None:
        self._points, self.cells = None, np.zeros((0, mesh.dim + 1), dtype=int)
        self.rules: dict[ET, IntegrationRule] = {}
        if mesh.ne == 0:  # a rank without cells
            return
        lattices = {ET.TRIG: subdivision(2, pieces), ET.QUAD: subdivision(2, pieces, True)}
        if mesh.dim == 3:
            lattices = {ET.TET: subdivision(3, pieces)}
        self.rules = {
            kind: IntegrationRule([tuple(map(float, corner)) for corner in corners], [1.0] * len(corners))
            for kind, (corners, _) in lattices.items()
        }
        self._points = mesh.MapToAllElements(self.rules, VOL)
        kinds = [cell.type for cell in mesh.Elements(VOL)]
        starts = np.cumsum([0, *(len(lattices[kind][0]) for kind in kinds)])
        self.cells = np.concatenate([lattices[k][1] + start for k, start in zip(kinds, starts, strict=False)])

    @property
    def of_points(self) -> np.ndarray:
        """The number of each point's cell in the mesh, (points,)."""
        return np.zeros(0, dtype=int) if self._points is None else np.asarray(self._points["nr"])

    def values(self, value: CoefficientFunction) -> np.ndarray:
        """Values of a function at the points, (points, components)."""
        if self._points is None:
            return np.zeros((0, value.dim))
        return np.asarray(value(self._points)).reshape(-1, value.dim)


def sampled(mesh: Mesh, value: CoefficientFunction, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """Values at the points of a ``Lattice``, (points, components), and its simplices, (parts, dim + 1)."""
    lattice = Lattice(mesh, pieces)
    # compiled functions evaluate expressions shared by several fields, such as bodies' pressure, only once
    return lattice.values(value.Compile()), lattice.cells


def read_series_files(directory: str | os.PathLike[str]) -> list[tuple[float, Path]]:
    """Time and file of every state of a series, e.g. of ``results/swirl/vtk``.

    Raises CheckpointError if there is no series.
    """
    place = Path(directory)
    series = [(time, place / name) for time, name in read_pvd(place / "fields.pvd")]
    if not series:
        message = f"{place}: there is no VTK series here; output.vtk.enabled = true writes a series"
        raise CheckpointError(message)
    return series


def read_pvd(path: Path) -> list[tuple[float, str]]:
    """(time, file) of every data set in a .pvd file; empty if there is no such file.

    Raises CheckpointError if the file was not written by ``StateFiles``, or is damaged.
    """
    if not path.exists():
        return []
    try:
        entries = re.findall(r'timestep="([^"]+)"[^>]*file="([^"]+)"', path.read_text(encoding="utf-8"))
        series = [(float(time), name) for time, name in entries]
    except ValueError as error:
        raise CheckpointError(f"{path}: this is not a readable file of a VTK series ({error})") from error
    if not series:
        raise CheckpointError(f"{path}: this is not a file of a VTK series with states; move the file away")
    return series


def read_frame(path: Path) -> Frame:
    """The frame in a file of a series; raises CheckpointError if the file is damaged or was written by
    another program."""
    try:
        if path.suffix == ".pvtu":  # a .pvtu file names the files of the ranks
            pieces = ElementTree.parse(path).getroot().iter("Piece")
            return _joined([read_frame(path.parent / piece.attrib["Source"]) for piece in pieces])
        head, mark, tail = path.read_bytes().partition(_MARK)
        root = ElementTree.fromstring(head + b"</VTKFile>")
        raw = tail[tail.index(b"_") + 1 :] if mark else b""
        arrays = {node.attrib["Name"]: _array(node.attrib, raw) for node in root.iter("DataArray")}
        types, where = arrays.pop("types")[:, 0], arrays.pop("connectivity")[:, 0]
        del arrays["offsets"]
        return Frame(arrays.pop("Points"), _cells(types, where), arrays, outlined(list(arrays)))
    except (OSError, ValueError, KeyError, ElementTree.ParseError, struct.error) as error:
        raise CheckpointError(f"{path}: this is not a readable file of a VTK series ({error})") from error


def _joined(parts: Sequence[Frame]) -> Frame:
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    cells = [part.cells + start for part, start in zip(parts, starts, strict=False)]
    fields = {name: np.concatenate([part.fields[name] for part in parts]) for name in parts[0].fields}
    points = np.concatenate([part.points for part in parts])
    return Frame(points, np.concatenate(cells), fields, parts[0].bodies)


def _array(attributes: dict[str, str], raw: bytes) -> np.ndarray:
    kind, offset = np.dtype(_KINDS[attributes["type"]]), int(attributes["offset"])
    (length,) = struct.unpack_from("<I", raw, offset)
    values = np.frombuffer(raw, kind, length // kind.itemsize, offset + 4)
    return values.reshape(-1, int(attributes.get("NumberOfComponents", 1)))


def _cells(types: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Triangles or tetrahedra of a file's cells; quadrilaterals are halved."""
    if np.all(types == _TETRAHEDRON):
        return where.reshape(-1, 4)
    if not np.all(np.isin(types, (_TRIANGLE, _QUADRILATERAL))):
        raise ValueError("the file has cells other than triangles, quadrilaterals and tetrahedra")
    ends = np.cumsum(np.where(types == _TRIANGLE, 3, 4))
    first = np.concatenate([[0], ends[:-1]])[:, None] + [0, 1, 2]
    return where[np.concatenate([first, ends[types == _QUADRILATERAL][:, None] + [-4, -2, -1]])]


def cut(frame: Frame, axis: int, position: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The section of tetrahedra by the plane x_axis = position.

    Returns the numbers of the two points between which each corner lies, (corners, 2), the corner's position
    between them from 0 to 1, (corners,), and triangles of corners, (triangles, 3).
    """
    height = frame.points[:, axis] - position
    above = height[frame.cells] > 0
    if not above.any():  # at the body's end the plane is a face of the body
        above = height[frame.cells] >= 0
    order = np.argsort(~above, axis=1, kind="stable")
    cells = np.take_along_axis(frame.cells, order, axis=1)  # the points above come first
    ends, triangles, start = [np.empty((0, 2), dtype=int)], [np.empty((0, 3), dtype=int)], 0
    for count, (edges, parts) in _CUTS.items():
        corners = cells[above.sum(axis=1) == count][:, edges]
        first = start + np.arange(len(corners))[:, None] * len(edges)
        triangles += [first + part for part in parts]
        ends.append(corners.reshape(-1, 2))
        start += len(ends[-1])
    both = np.concatenate(ends)
    share = height[both[:, 0]] / (height[both[:, 0]] - height[both[:, 1]])
    return both, share, np.concatenate(triangles)


def averaged(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Replace values, (..., points), by the means over all ``points``, (points, dim), at the same place."""
    _, place = places(points)
    sums = np.apply_along_axis(lambda row: np.bincount(place, weights=row), -1, values)
    return (sums / np.bincount(place))[..., place]


def places(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct places: the index of the first point at each, and for each point the number of its place.

    Coordinates that are equal after rounding to ``_SAME`` times the size are one place.
    """
    size = float(np.ptp(points, axis=0).max(initial=0.0)) or 1.0
    rounded = np.round(points / (_SAME * size)).astype(np.int64)
    _, first, number = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def outline(axis: Any, X: np.ndarray, Y: np.ndarray, triangles: np.ndarray, fraction: np.ndarray) -> Any:
    """Draw the line on which a fraction, (corners,), is one half; return None if the fraction is one half
    nowhere."""
    if not fraction.min() < 0.5 < fraction.max():  # matplotlib warns if there is no line
        return None
    tri = importlib.import_module("matplotlib.tri")
    points = np.stack([X, Y], axis=1)
    first, number = places(points)
    cells, points, values = number[triangles], points[first], fraction[first]
    a, b, c = np.moveaxis(points[cells], 1, 0)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    cells = cells[area > _FLAT * area.max()]  # a section meets corners and edges of cells too
    is_cut = (values[cells].min(axis=1) < 0.5) & (values[cells].max(axis=1) > 0.5)
    mesh = tri.Triangulation(*points.T, cells[np.isin(cells, cells[is_cut]).any(axis=1)])
    finer, smooth = tri.UniformTriRefiner(mesh).refine_field(values, subdiv=_HALVINGS)
    return axis.tricontour(finer, smooth, levels=[0.5], colors="white", linewidths=1.4)


def outlined(names: Sequence[str]) -> list[str]:
    """The names of fractions that outline a run's bodies, among ``names``, without the last body's fraction.

    The fractions stand together before ``body``, since a passive field may have a similar name.  The last
    body needs no outline, since the outlines of the other bodies bound it.
    """
    before = list(names)[: list(names).index("body")] if "body" in names else []
    return list(takewhile(lambda name: name.endswith("_fraction"), reversed(before)))[:0:-1]

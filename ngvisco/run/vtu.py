"""What pictures, animations and scenes draw: states as arrays, of a VTK series or of fields as they are.

Cells have their own points, so that fields may jump between them.  The mesh is the same in every file.
"""

import errno
import os
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from ngsolve import CF, ET, VOL, CoefficientFunction, IntegrationRule, Mesh, VTKOutput, x, y, z

from ngvisco.errors import CheckpointError, ParameterError, UnknownNameError
from ngvisco.parallel.communicator import Communicator
from ngvisco.run.files import write_atomically
from ngvisco.run.outlines import averaged, outlined, whole_numbers
from ngvisco.shapes.fractions import subdivision

_KINDS = {"Float64": "<f8", "Float32": "<f4", "Int32": "<i4", "UInt8": "u1"}
_MARK = b'<AppendedData encoding="raw">'
_TRIANGLE, _QUADRILATERAL, _TETRAHEDRON = 5, 9, 10
_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))


@dataclass(frozen=True)
class Frame:
    """One state: cells with points of their own, and fields at the points.

    Attributes
    ----------
    points : array (points, 3), m
    cells : array (cells, 3) of triangles' points in 2D, (cells, 4) of tetrahedra's in 3D
    fields : arrays (points, components) by name
    bodies : names of the fields that are fractions of bodies, whose surfaces are drawn
    """

    points: np.ndarray
    cells: np.ndarray
    fields: dict[str, np.ndarray]
    bodies: Sequence[str] = ()

    @property
    def dim(self) -> int:
        return self.cells.shape[1] - 1

    def scalar(self, name: str) -> np.ndarray:
        """A scalar at the points: of a vector or a tensor its norm, or a component ``NAME_i``, ``NAME_ij``.

        Raises UnknownNameError.
        """
        if name in self.fields:
            values = self.fields[name]
            return values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)
        whole, _, index = name.rpartition("_")
        size = self.fields[whole].shape[1] if whole in self.fields else 0
        labels = {3: "123", 9: [f"{i}{j}" for i in "123" for j in "123"]}.get(size, "")
        if index not in labels:
            raise UnknownNameError("field", name, self.names)
        return self.fields[whole][:, list(labels).index(index)]

    @property
    def names(self) -> list[str]:
        """Names that ``scalar`` understands."""
        return [
            part
            for name, values in self.fields.items()
            for part in {
                1: [name],
                3: [name, *(f"{name}_{i}" for i in "123")],
                9: [name, *(f"{name}_{i}{j}" for i in "123" for j in "123")],
            }[values.shape[1]]
        ]

    def fractions(self) -> list[np.ndarray]:
        """Of the bodies that are outlined, (points,), the same in all cells that meet at a point."""
        return [averaged(self.points, self.scalar(name)) for name in self.bodies]

    def boundary(self) -> np.ndarray:
        """In 3D the faces that belong to one tetrahedron only, (faces, 3)."""
        faces = np.concatenate([self.cells[:, face] for face in _FACES])
        _, places = np.unique(whole_numbers(self.points), axis=0, return_inverse=True)
        corners = np.sort(places.reshape(-1)[faces], axis=1)
        _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
        return faces[first[count == 1]]


def frame_of(
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    outlines: Sequence[CoefficientFunction] = (),
    pieces: int = 1,
) -> Frame:
    """Scalar fields as they are, by name, with the fractions of bodies whose surfaces are drawn.

    Every cell is cut into ``pieces``^dim ones, quadrilaterals into twice as many triangles.  Raises
    ParameterError for a field that is no scalar.
    """
    for name, value in fields.items():
        if value.dim != 1:
            raise ParameterError(f"field {name!r} of a picture", value.dim, "a scalar")
    bodies = {f"outline {i}": value for i, value in enumerate(outlines)}
    lattices = {ET.TRIG: subdivision(2, pieces), ET.QUAD: subdivision(2, pieces, True)}
    if mesh.dim == 3:
        lattices = {ET.TET: subdivision(3, pieces)}
    rules = {
        kind: IntegrationRule([tuple(map(float, corner)) for corner in corners], [0.0] * len(corners))
        for kind, (corners, _) in lattices.items()
    }
    table = np.asarray(CF((x, y, z, *fields.values(), *bodies.values()))(mesh.MapToAllElements(rules, VOL)))
    table = table.reshape(-1, 3 + len(fields) + len(bodies))
    kinds = [cell.type for cell in mesh.Elements(VOL)]
    starts = np.cumsum([0, *(len(lattices[kind][0]) for kind in kinds)])
    cells = [lattices[kind][1] + start for kind, start in zip(kinds, starts, strict=False)]
    columns = {name: table[:, [3 + i]] for i, name in enumerate((*fields, *bodies))}
    return Frame(table[:, :3], np.concatenate(cells), columns, tuple(bodies))


def read_series_files(directory: str | os.PathLike[str]) -> list[tuple[float, Path]]:
    """Time and file of every state of a series, e.g. of ``results/swirl/vtk``.

    Raises CheckpointError if there is none.
    """
    place = Path(directory)
    found = [(time, place / name) for time, name in read_pvd(place / "fields.pvd")]
    if not found:
        raise CheckpointError(f"{place}: no VTK series (output.vtk.enabled = true writes one)")
    return found


def _joined(parts: Sequence[Frame]) -> Frame:
    """The cells of all frames in one."""
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    cells = [part.cells + start for part, start in zip(parts, starts, strict=False)]
    fields = {name: np.concatenate([part.fields[name] for part in parts]) for name in parts[0].fields}
    points = np.concatenate([part.points for part in parts])
    return Frame(points, np.concatenate(cells), fields, parts[0].bodies)


def read_frame(path: Path) -> Frame:
    """One file of a series; raises CheckpointError if it is not one of ours, or damaged."""
    try:
        if path.suffix == ".pvtu":  # which names the files of the ranks
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
        raise CheckpointError(f"{path}: not a readable file of a VTK series ({error})") from error


def _array(attributes: dict[str, str], raw: bytes) -> np.ndarray:
    kind, offset = np.dtype(_KINDS[attributes["type"]]), int(attributes["offset"])
    (length,) = struct.unpack_from("<I", raw, offset)
    values = np.frombuffer(raw, kind, length // kind.itemsize, offset + 4)
    return values.reshape(-1, int(attributes.get("NumberOfComponents", 1)))


def _cells(types: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Triangles or tetrahedra; quadrilaterals are halved."""
    if np.all(types == _TETRAHEDRON):
        return where.reshape(-1, 4)
    sizes = np.where(types == _TRIANGLE, 3, 4)
    if not np.all(np.isin(types, (_TRIANGLE, _QUADRILATERAL))):
        raise ValueError("cells of another shape than triangles, quadrilaterals and tetrahedra")
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    triangles = [where[starts[:, None] + np.arange(3)]]
    halves = starts[types == _QUADRILATERAL]
    triangles.append(where[halves[:, None] + np.array([0, 2, 3])])
    return np.concatenate(triangles)


def cut(frame: Frame, axis: int, position: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The section of tetrahedra by the plane x_axis = position.

    Returns
    -------
    ends : array (corners, 2)
        Numbers of the two points between which each corner of the section lies.
    share : array (corners,)
        How far from the first to the second.
    triangles : array (triangles, 3)
        Of corners.
    """
    height = frame.points[:, axis] - position
    above = height[frame.cells] > 0
    if not above.any():  # at the body's end the plane is its face
        above = height[frame.cells] >= 0
    count = above.sum(axis=1)
    ends: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    start = 0
    for wanted in (1, 2, 3):
        chosen = frame.cells[count == wanted]
        if not len(chosen):
            continue
        order = np.argsort(~above[count == wanted], axis=1, kind="stable")
        sorted_cells = np.take_along_axis(chosen, order, axis=1)  # the points above first
        pairs = {
            1: ((0, 1), (0, 2), (0, 3)),
            2: ((0, 2), (0, 3), (1, 3), (1, 2)),
            3: ((0, 3), (1, 3), (2, 3)),
        }[wanted]
        corners = sorted_cells[:, pairs].reshape(-1, 2)
        first = start + np.arange(len(chosen))[:, None] * len(pairs)
        triangles.append(first + np.array([0, 1, 2]))
        if wanted == 2:
            triangles.append(first + np.array([0, 2, 3]))
        ends.append(corners)
        start += len(corners)
    if not ends:
        return np.empty((0, 2), dtype=int), np.empty(0), np.empty((0, 3), dtype=int)
    both = np.concatenate(ends)
    share = height[both[:, 0]] / (height[both[:, 0]] - height[both[:, 1]])
    return both, share, np.concatenate(triangles)


def write_vtu(
    path: Path, mesh: Mesh, fields: Mapping[str, CoefficientFunction], time: float, subdivision: int = 0
) -> None:
    """Write fields by name, at ``time`` (s), into one .vtu file, which is complete or not there.

    On several ranks each writes its piece, ``NAME_p<rank>.vtu``, and the first the .pvtu that names them.
    """
    ranks = Communicator.of(mesh)
    draft = path.with_suffix(".part")
    padded = {name: _padded(value) for name, value in fields.items()}
    output = VTKOutput(
        mesh,
        coefs=list(padded.values()),
        names=list(padded),
        filename=str(draft),
        subdivision=subdivision,
        floatsize="double",
    )
    output.Do(time=time)
    if mesh.ne:
        written = Path(f"{draft}_proc{ranks.rank}.vtu" if ranks.is_distributed else f"{draft}.vtu")
        _require_complete(written)
        _label_components(written, padded)
        written.replace(_piece(path, ranks.rank) if ranks.is_distributed else path)
    if ranks.is_first:
        Path(f"{draft}.pvd").unlink(missing_ok=True)
        if ranks.is_distributed:  # the first rank has no cells
            pieces = [_piece(path, rank).name for rank in range(1, ranks.size)]
            write_atomically(shown_by(path, ranks), _parallel_file(padded, pieces).encode())


def shown_by(path: Path, ranks: Communicator) -> Path:
    """The file to open of fields that are written into ``path``: over ranks the .pvtu of their pieces."""
    return path.with_suffix(".pvtu") if ranks.is_distributed else path


def _piece(path: Path, rank: int) -> Path:
    return path.with_name(f"{path.stem}_p{rank}.vtu")


def _parallel_file(fields: Mapping[str, CoefficientFunction], pieces: Sequence[str]) -> str:
    arrays = "".join(
        f'<PDataArray type="Float64" Name="{name}" NumberOfComponents="{value.dim}"{_labels(name, value)}/>\n'
        for name, value in fields.items()
    )
    sources = "".join(f'<Piece Source="{name}"/>\n' for name in pieces)
    return (
        '<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian">\n'
        '<PUnstructuredGrid GhostLevel="0">\n<PPoints>\n<PDataArray type="Float64" Name="Points" '
        f'NumberOfComponents="3"/>\n</PPoints>\n<PPointData>\n{arrays}</PPointData>\n{sources}'
        "</PUnstructuredGrid>\n</VTKFile>\n"
    )


def _require_complete(path: Path) -> None:
    """Raise OSError unless the file ends as it should: VTKOutput is silent about a full disk."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 40))
        if b"</VTKFile>" in file.read():
            return
    path.unlink()
    raise OSError(errno.ENOSPC, "the VTK file could not be written completely", str(path))


def _padded(value: CoefficientFunction) -> CoefficientFunction:
    """Vectors of two components get a third, as ParaView wants them."""
    return CF((value[0], value[1], 0.0)) if value.dim == 2 else value


def _label_components(path: Path, fields: dict[str, CoefficientFunction]) -> None:
    """Write the components' names into the file's header (the data blocks' offsets stay valid)."""
    head, mark, tail = path.read_bytes().partition(b"<AppendedData")
    text = head.decode()
    for name, value in fields.items():
        text = text.replace(f'Name="{name}" ', f'Name="{name}"{_labels(name, value)} ')
    path.write_bytes(text.encode() + mark + tail)


def _labels(name: str, value: CoefficientFunction) -> str:
    """The components' names as attributes."""
    axes = ["1", "2", "3"] if name.startswith("principal") else ["x", "y", "z"]
    labels = {3: axes, 9: [f"{i}{j}" for i in "123" for j in "123"]}.get(value.dim, [])
    return "".join(f' ComponentName{i}="{label}"' for i, label in enumerate(labels))


def read_pvd(path: Path) -> list[tuple[float, str]]:
    """(time, file) of every data set that a .pvd of ours lists; empty if there is no such file.

    Raises CheckpointError if it is none of ours, or damaged.
    """
    if not path.exists():
        return []
    try:
        found = re.findall(r'timestep="([^"]+)"[^>]*file="([^"]+)"', path.read_text(encoding="utf-8"))
        series = [(float(time), name) for time, name in found]
    except ValueError as error:
        raise CheckpointError(f"{path}: not a readable file of a VTK series ({error})") from error
    if not series:
        raise CheckpointError(f"{path}: not a file of a VTK series, or one without states; move it away")
    return series

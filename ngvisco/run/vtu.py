"""VTK files of fields: .vtu, over ranks the .pvtu of the ranks' pieces, and the .pvd of a series."""

import re
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from ngsolve import CF, CoefficientFunction, Mesh, x, y, z

from ngvisco.parallel.communicator import Communicator
from ngvisco.run.files import write_atomically
from ngvisco.run.frames import COMPONENTS, places, read_pvd, sampled


def write_vtu(
    path: Path,
    mesh: Mesh,
    fields: Mapping[str, CoefficientFunction],
    subdivision: int = 0,
    is_continuous: bool = False,
) -> None:
    """Write fields by name into one .vtu file, whole or not at all.

    Cells have points of their own, so that fields may jump; with continuous fields (``is_continuous``) cells
    share the points where they meet.  On several ranks each rank writes its piece, ``NAME_p<rank>.vtu``, and
    the first rank the .pvtu that lists the pieces.
    """
    ranks = Communicator.of(mesh)
    # ParaView wants vectors of three components
    padded = {name: CF((f[0], f[1], 0.0)) if f.dim == 2 else f for name, f in fields.items()}
    if mesh.ne:
        table, cells = sampled(mesh, CF((x, y, z, *padded.values())), 1 << subdivision)
        if is_continuous:
            first, number = places(table[:, :3])
            table, cells = table[first], number[cells]
        content = _content(table, cells, {name: f.dim for name, f in padded.items()})
        write_atomically(_piece(path, ranks.rank) if ranks.is_distributed else path, content)
    if ranks.is_first and ranks.is_distributed:  # the first rank has no cells
        pieces = [_piece(path, rank).name for rank in range(1, ranks.size)]
        _write_parallel_file(shown_by(path, ranks), padded, pieces)


def write_lines(
    path: Path, points: np.ndarray, segments: np.ndarray, columns: Mapping[str, np.ndarray]
) -> None:
    """Write segments between points, (points, 3), and columns of values at the points into one .vtu file."""
    widths = {name: column.shape[1] for name, column in columns.items()}
    write_atomically(path, _content(np.hstack([points, *columns.values()]), segments, widths))


def _content(table: np.ndarray, cells: np.ndarray, widths: Mapping[str, int]) -> bytes:
    """Content of a .vtu file with simplices; a row of ``table`` has a point and the fields' values there."""
    blocks: list[bytes] = []

    def array(name: str, kind: str, values: np.ndarray, attributes: str = "") -> str:
        offset = sum(map(len, blocks))
        data = np.ascontiguousarray(values, dtype=_KINDS[kind]).tobytes()
        blocks.append(struct.pack("<I", len(data)) + data)
        return f'<DataArray type="{kind}" Name="{name}"{attributes} format="appended" offset="{offset}"/>\n'

    count, corners = cells.shape
    points = array("Points", "Float64", table[:, :3], ' NumberOfComponents="3"')
    of_cells = array("connectivity", "Int32", cells)
    of_cells += array("offsets", "Int32", corners * np.arange(1, count + 1))
    of_cells += array("types", "UInt8", np.full(count, _TYPES[corners]))
    data, start = "", 3
    for name, width in widths.items():
        described = f' NumberOfComponents="{width}"{_labels(name, width)}'
        data += array(name, "Float64", table[:, start : start + width], described)
        start += width
    head = (
        f"{_head('UnstructuredGrid')}\n<UnstructuredGrid>\n"
        f'<Piece NumberOfPoints="{len(table)}" NumberOfCells="{count}">\n<Points>\n{points}</Points>\n'
        f"<Cells>\n{of_cells}</Cells>\n<PointData>\n{data}</PointData>\n</Piece>\n</UnstructuredGrid>\n"
        '<AppendedData encoding="raw">\n_'
    )
    return b"".join([head.encode(), *blocks, b"\n</AppendedData>\n</VTKFile>\n"])


_KINDS = {"Float64": "<f8", "Int32": "<i4", "UInt8": "u1"}
_TYPES = {2: 3, 3: 5, 4: 10}
"""VTK's numbers for segments, triangles and tetrahedra, by their number of corners."""


class StateFiles:
    """The files of the states of a series, ``STEM_NUMBER.vtu``, and ``STEM.pvd``, which lists the files.

    Attributes
    ----------
    written : list of (time, file)
        The states so far, with times in s.
    """

    def __init__(self, directory: Path, stem: str) -> None:
        self.directory, self._stem, self._list = directory, stem, directory / f"{stem}.pvd"
        self.written: list[tuple[float, str]] = []

    def begin(self, before: float | None, ranks: Communicator) -> None:
        """Begin a series, or go on with the states before the time ``before``, s, and remove other files."""
        self.directory.mkdir(parents=True, exist_ok=True)
        self.written = []
        if before is not None:
            self.written = [state for state in read_pvd(self._list) if state[0] < before]
            ranks.on_first(self._remove_others)

    def _remove_others(self) -> None:
        kept = {name.partition(".")[0] for _, name in self.written}
        for path in self.directory.glob(f"{self._stem}_*"):
            match = re.fullmatch(rf"({self._stem}_\d{{6}})(_p\d+)?\.p?vtu", path.name)
            if match is not None and match[1] not in kept:
                path.unlink()

    def path(self, number: int) -> Path:
        """The file of the state after ``number`` steps."""
        return self.directory / f"{self._stem}_{number:06d}.vtu"

    def add(self, time: float, name: str, ranks: Communicator) -> None:
        """List a written file with its time, s; another file of this name is listed no more."""
        self.written = [state for state in self.written if state[1] != name] + [(time, name)]
        sets = (f'<DataSet timestep="{t!r}" group="" part="0" file="{file}"/>\n' for t, file in self.written)
        if ranks.is_first:
            _write_xml(self._list, "Collection", f"<Collection>\n{''.join(sets)}</Collection>")


def shown_by(path: Path, ranks: Communicator) -> Path:
    """The file to open for fields that are written into ``path``: on several ranks the .pvtu file."""
    return path.with_suffix(".pvtu") if ranks.is_distributed else path


def _piece(path: Path, rank: int) -> Path:
    return path.with_name(f"{path.stem}_p{rank}.vtu")


def _write_parallel_file(
    path: Path, fields: Mapping[str, CoefficientFunction], pieces: Sequence[str]
) -> None:
    arrays = "".join(
        f'<PDataArray type="Float64" Name="{name}" NumberOfComponents="{value.dim}"'
        f"{_labels(name, value.dim)}/>\n"
        for name, value in fields.items()
    )
    sources = "".join(f'<Piece Source="{name}"/>\n' for name in pieces)
    points = '<PDataArray type="Float64" Name="Points" NumberOfComponents="3"/>'
    grid = (
        f'<PUnstructuredGrid GhostLevel="0">\n<PPoints>\n{points}\n</PPoints>\n'
        f"<PPointData>\n{arrays}</PPointData>\n{sources}</PUnstructuredGrid>"
    )
    _write_xml(path, "PUnstructuredGrid", grid)


def _write_xml(path: Path, kind: str, content: str) -> None:
    write_atomically(path, f"{_head(kind)}\n{content}\n</VTKFile>\n".encode())


def _head(kind: str) -> str:
    return f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian">'


def _labels(name: str, width: int) -> str:
    labels = COMPONENTS.get(width, [])
    if width == 3 and not name.startswith("principal"):
        labels = ["x", "y", "z"]
    return "".join(f' ComponentName{i}="{label}"' for i, label in enumerate(labels))

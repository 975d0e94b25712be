"""Fields as VTK files: .vtu, over ranks the .pvtu of their pieces, and the .pvd of a series."""

import errno
from collections.abc import Mapping, Sequence
from pathlib import Path

from ngsolve import CF, CoefficientFunction, Mesh, VTKOutput

from ngvisco.parallel.communicator import Communicator
from ngvisco.run.files import write_atomically
from ngvisco.run.frames import COMPONENTS


def write_vtu(
    path: Path, mesh: Mesh, fields: Mapping[str, CoefficientFunction], time: float, subdivision: int = 0
) -> None:
    """Write fields by name, at ``time`` (s), into one .vtu file, which is complete or not there.

    On several ranks each writes its piece, ``NAME_p<rank>.vtu``, and the first the .pvtu that names them.
    """
    ranks = Communicator.of(mesh)
    draft = path.with_suffix(".part")
    # ParaView wants vectors of three components
    padded = {name: CF((f[0], f[1], 0.0)) if f.dim == 2 else f for name, f in fields.items()}
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
        _label_components(written, padded)
        written.replace(_piece(path, ranks.rank) if ranks.is_distributed else path)
    if ranks.is_first:
        Path(f"{draft}.pvd").unlink(missing_ok=True)
        if ranks.is_distributed:  # the first rank has no cells
            pieces = [_piece(path, rank).name for rank in range(1, ranks.size)]
            _write_parallel_file(shown_by(path, ranks), padded, pieces)


def write_pvd(path: Path, series: Sequence[tuple[float, str]]) -> None:
    """List the states of a series: their times, s, and files."""
    sets = "\n".join(
        f'<DataSet timestep="{time!r}" group="" part="0" file="{name}"/>' for time, name in series
    )
    _write_xml(path, "Collection", f"<Collection>\n{sets}\n</Collection>")


def shown_by(path: Path, ranks: Communicator) -> Path:
    """The file to open of fields that are written into ``path``: over ranks the .pvtu of their pieces."""
    return path.with_suffix(".pvtu") if ranks.is_distributed else path


def _piece(path: Path, rank: int) -> Path:
    return path.with_name(f"{path.stem}_p{rank}.vtu")


def _write_parallel_file(
    path: Path, fields: Mapping[str, CoefficientFunction], pieces: Sequence[str]
) -> None:
    arrays = "".join(
        f'<PDataArray type="Float64" Name="{name}" NumberOfComponents="{value.dim}"{_labels(name, value)}/>\n'
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
    head = f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" byte_order="LittleEndian">'
    write_atomically(path, f"{head}\n{content}\n</VTKFile>\n".encode())


def _label_components(path: Path, fields: dict[str, CoefficientFunction]) -> None:
    """Write the components' names into the file's header (the data blocks' offsets stay valid).

    Raises OSError for a file that does not end as it should: VTKOutput is silent about a full disk.
    """
    content = path.read_bytes()
    if b"</VTKFile>" not in content[-40:]:
        path.unlink()
        raise OSError(errno.ENOSPC, "the VTK file could not be written completely", str(path))
    head, mark, tail = content.partition(b"<AppendedData")
    text = head.decode()
    for name, value in fields.items():
        text = text.replace(f'Name="{name}" ', f'Name="{name}"{_labels(name, value)} ')
    path.write_bytes(text.encode() + mark + tail)


def _labels(name: str, value: CoefficientFunction) -> str:
    labels = COMPONENTS.get(value.dim, [])
    if value.dim == 3 and not name.startswith("principal"):
        labels = ["x", "y", "z"]
    return "".join(f' ComponentName{i}="{label}"' for i, label in enumerate(labels))

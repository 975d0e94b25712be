"""Fields of a mesh as a .vtu file, which ParaView opens, and the list of a series of them."""

import errno
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ngsolve import CF, CoefficientFunction, Mesh, VTKOutput

from ngvisco.errors import CheckpointError
from ngvisco.parallel.communicator import Communicator
from ngvisco.run.files import write_atomically


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

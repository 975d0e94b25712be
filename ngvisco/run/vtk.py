"""Fields of a mesh as a .vtu file, which ParaView opens."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from pathlib import Path

from ngsolve import CF, CoefficientFunction, Mesh, VTKOutput


def write_vtu(
    path: Path, mesh: Mesh, fields: Mapping[str, CoefficientFunction], time: float, subdivision: int = 0
) -> None:
    """Write fields by name, at ``time`` (s), into one .vtu file, which is complete or not there."""
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
    written = Path(f"{draft}.vtu")
    _require_complete(written)
    _label_components(written, padded)
    written.replace(path)
    Path(f"{draft}.pvd").unlink(missing_ok=True)


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
        axes = ["1", "2", "3"] if name.startswith("principal") else ["x", "y", "z"]
        labels = {3: axes, 9: [f"{i}{j}" for i in "123" for j in "123"]}.get(value.dim, [])
        attributes = "".join(f' ComponentName{i}="{label}"' for i, label in enumerate(labels))
        text = text.replace(f'Name="{name}" ', f'Name="{name}"{attributes} ')
    path.write_bytes(text.encode() + mark + tail)

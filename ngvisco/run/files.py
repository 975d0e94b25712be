"""Files, tables and meshes: a file is written whole or not at all; every error has the file's name."""

import contextlib
import csv
import gzip
import io
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TextIO, TypeAlias

import numpy as np
from ngsolve import Mesh

from ngvisco.errors import MeshError
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.parallel.mesh import has_geometry, volume_and_surface

AnyPath: TypeAlias = str | os.PathLike[str]

_DIGITS = 1e-5
"""Relative error of volumes and surfaces by the rounded digits of curved cells in a file."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file beside ``path`` and rename it; after an error the old file is unchanged."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".part")
    with _named(path):
        try:
            with draft.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise


def append(path: Path, text: str) -> None:
    """Add text to the end of a file."""
    with _named(path), path.open("a", newline="", encoding="utf-8") as file:
        file.write(text)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Text of a CSV file with these rows."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(rows)
    return text.getvalue()


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.filename is None:
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def locks(file: TextIO) -> bool:
    """Lock a file for as long as the process lives; False if another process holds it."""
    lock: Callable[..., Any]
    if sys.platform == "win32":
        import msvcrt

        lock, arguments = msvcrt.locking, (msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        lock, arguments = fcntl.flock, (fcntl.LOCK_EX | fcntl.LOCK_NB,)
    try:
        lock(file.fileno(), *arguments)
    except OSError:
        return False
    return True


def require_whole(path: Path) -> None:
    """Raise MeshError unless the file looks like a complete Netgen mesh."""
    if path.suffix != ".vol" and path.suffixes[-2:] != [".vol", ".gz"]:
        raise MeshError(f"{path}: expected a Netgen mesh, .vol or .vol.gz")
    try:
        raw = path.read_bytes()
        text = gzip.decompress(raw) if path.suffix == ".gz" else raw
    except FileNotFoundError:
        raise MeshError(f"{path}: this mesh file does not exist") from None
    except (OSError, EOFError) as error:
        raise MeshError(f"{path}: the file cannot be read ({error})") from error
    lines = [line.strip() for line in text.split(b"\n")]
    if b"mesh3d" not in lines[:10]:
        raise MeshError(f"{path}: this is not a Netgen mesh file")
    if b"endmesh" not in lines:
        raise MeshError(f"{path}: the mesh file is cut short, since it has no line 'endmesh'")


def mesh_image(mesh: Mesh) -> bytes:
    """The content of a .vol file for the mesh.  Unlike Netgen's own writer, this function reports a full
    disk."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "mesh.vol"
        mesh.ngmesh.Save(str(path))
        require_whole(path)
        lines = path.read_bytes().split(b"\n")
    first = lines.index(b"points") + 2
    # repr keeps all digits; with 16 decimals 1e-17 m would be 0
    for i, point in enumerate(coordinates(mesh).tolist()):
        lines[first + i] = " ".join(map(repr, [*point, 0.0][:3])).encode()
    return b"\n".join(lines)


def mesh_of(image: bytes) -> Mesh:
    """The mesh in a .vol file's content."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "mesh.vol"
        path.write_bytes(image)
        return mesh_in(path)


def mesh_in(path: Path) -> Mesh:
    """The mesh in a file, curved anew if its geometry is known: Netgen writes eight decimals of curved cells.

    Without this correction a mesh from a file would differ from the mesh of a script or of a run over ranks,
    for a disc by 3e-10 of the area.
    """
    mesh = Mesh(str(path))
    if mesh.GetCurveOrder() > 1 and has_geometry(mesh):
        sizes = volume_and_surface(mesh)
        mesh.Curve(mesh.GetCurveOrder())
        # sizes change if the given geometry does not belong to the mesh
        if not np.allclose(volume_and_surface(mesh), sizes, rtol=_DIGITS, atol=0):
            return Mesh(str(path))
    return mesh

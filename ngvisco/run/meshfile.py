"""Meshes as files: of cases, run directories, checkpoints."""

import gzip
import tempfile
from pathlib import Path

import numpy as np
from ngsolve import Mesh

from ngvisco.errors import MeshError
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.parallel.mesh import has_geometry, volume_and_surface

_DIGITS = 1e-5
"""Relative difference of volumes and surfaces that the digits of curved cells in a file may make."""


def require_whole(path: Path) -> None:
    """Raise MeshError unless the file looks like a complete Netgen mesh."""
    if path.suffix != ".vol" and path.suffixes[-2:] != [".vol", ".gz"]:
        raise MeshError(f"{path}: expected a Netgen mesh, .vol or .vol.gz")
    try:
        raw = path.read_bytes()
        text = gzip.decompress(raw) if path.suffix == ".gz" else raw
    except FileNotFoundError:
        raise MeshError(f"{path}: no such mesh file") from None
    except (OSError, EOFError) as error:
        raise MeshError(f"{path}: cannot be read ({error})") from error
    lines = text.split(b"\n")
    if b"mesh3d" not in (line.strip() for line in lines[:10]):
        raise MeshError(f"{path}: not a Netgen mesh file")
    if b"endmesh" not in (line.strip() for line in lines):
        raise MeshError(f"{path}: the mesh file is cut short (no line 'endmesh')")


def mesh_image(mesh: Mesh) -> bytes:
    """The mesh as a .vol file's content; Netgen itself would be silent about a full disk."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "mesh.vol"
        mesh.ngmesh.Save(str(path))
        require_whole(path)
        return _with_all_digits(path.read_bytes(), coordinates(mesh))


def _with_all_digits(image: bytes, points: np.ndarray) -> bytes:
    """The file with every digit of the points: Netgen writes 16 after the decimal point, none of 1e-17 m."""
    lines = image.split(b"\n")
    first = lines.index(b"points") + 2
    for i, point in enumerate(points):
        lines[first + i] = " ".join(map(repr, [*point.tolist(), 0.0][:3])).encode()
    return b"\n".join(lines)


def mesh_of(image: bytes) -> Mesh:
    """The mesh in a .vol file's content."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "mesh.vol"
        path.write_bytes(image)
        return mesh_in(path)


def mesh_in(path: Path) -> Mesh:
    """The mesh in a file; of a known geometry curved by that: Netgen writes eight decimals of curved cells.

    Otherwise the cells of a case file were others than those of a script, 3e-10 of a disc's area, and than
    those of several ranks.
    """
    mesh = Mesh(str(path))
    if mesh.GetCurveOrder() > 1 and has_geometry(mesh):
        sizes = volume_and_surface(mesh)
        mesh.Curve(mesh.GetCurveOrder())
        if not np.allclose(volume_and_surface(mesh), sizes, rtol=_DIGITS, atol=0):  # of another geometry
            return Mesh(str(path))
    return mesh

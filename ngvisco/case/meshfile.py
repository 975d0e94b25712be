"""Mesh files of cases and of run directories."""

from __future__ import annotations

import gzip
import importlib
from pathlib import Path

from ngsolve import Mesh

from ngvisco.errors import MeshError


def read_mesh(path: str, maxh: float | None = None, order: int = 3) -> Mesh:
    """``ngvisco.geometries.load``, with a path as case files have it."""
    return importlib.import_module("ngvisco.geometries").load(path, maxh=maxh, order=order)


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

"""Reading a mesh or geometry file without trusting it.

Netgen ends the whole process on some files that are cut short; so a file is read by a process of its own
first, and only then by this one.
"""

from __future__ import annotations

import gzip
import importlib
import subprocess
import sys
from pathlib import Path

from ngsolve import Mesh

from ngvisco.errors import MeshError

_PROBE = """
import sys
from ngvisco.errors import NgviscoError
from ngvisco.geometries import load
path, maxh, order = sys.argv[1:]
try:
    load(path, maxh=float(maxh) if maxh else None, order=int(order))
except NgviscoError:
    pass  # is raised again, and explained, where it is known which key is at fault
"""


def read_mesh(path: str, maxh: float | None = None, order: int = 3) -> Mesh:
    """``ngvisco.geometries.load`` for a file that may end Netgen's process.

    Raises
    ------
    MeshError, ParameterError
        As ``load``; MeshError too if Netgen crashes on the file.
    """
    importlib.import_module("ngvisco.geometries.files").check_file(Path(path))
    arguments = [path, "" if maxh is None else repr(maxh), str(order)]
    # the child finds what this process has found, also in a clone that is not installed
    code = f"import sys; sys.path[:] = {sys.path!r}\n{_PROBE}"
    probe = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    if probe.returncode != 0:
        said = probe.stderr.strip().splitlines()
        raise MeshError(f"{path}: Netgen cannot read it ({said[-1] if said else 'it crashes'})")
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

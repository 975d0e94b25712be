"""Reading a Netgen mesh file without trusting it.

Netgen ends the whole process on a file that is cut short; so a file is first looked at, then read by
a process of its own, and only then by this one.
"""

from __future__ import annotations

import gzip
import subprocess
import sys
from pathlib import Path

from ngsolve import Mesh

from ngvisco.errors import MeshError

_PROBE = "import sys; from ngsolve import Mesh; m = Mesh(sys.argv[1]); list(m.vertices); list(m.Elements())"


def read_mesh(path: str) -> Mesh:
    """A mesh from a Netgen file (.vol or .vol.gz), with its curvature and boundary names.

    Raises
    ------
    MeshError
        If the file is missing, is no such file, is cut short or cannot be read.
    """
    require_whole(Path(path))
    probe = subprocess.run([sys.executable, "-c", _PROBE, path], capture_output=True, text=True)
    if probe.returncode != 0:
        said = probe.stderr.strip().splitlines()
        raise MeshError(f"{path}: Netgen cannot read it ({said[-1] if said else 'it crashes'})")
    return Mesh(path)


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

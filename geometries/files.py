"""Meshes and geometries from files: Netgen's .vol, STEP and BREP, gmsh's .msh.

Some truncated files make Netgen end the whole process. Therefore a separate process reads a file before this
process does.
"""

import warnings
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from netgen.meshing import Mesh as NetgenMesh
from netgen.occ import OCCGeometry, Pnt
from netgen.read_gmsh import ReadGmsh
from ngsolve import Mesh

from ngvisco.errors import MeshError, ParameterError, Quantity, require_path, require_type
from ngvisco.geometries.meshing import (
    CURVE_ORDER,
    Domain,
    as_length,
    check_order,
    split_corner_cells,
    try_apart,
)

_FLAT = 1e-6  # tolerance on z over a sheet's width; OCC's bounding boxes have a margin

_ENDS = {
    ".vol": "endmesh",
    ".step": "END-ISO-10303-21;",
    ".stp": "END-ISO-10303-21;",
    ".brep": "TShapes",
    ".msh": "$EndElements",
}


def load(
    path: Annotated[str | PathLike[str], Quantity(example="part.step")],
    *,
    maxh: Annotated[float | None, Quantity("m", example=0.1)] = None,
    order: int = CURVE_ORDER,
    split_corners: bool = False,
) -> Mesh:
    """Load a mesh from a file.

    A ``.vol`` or ``.msh`` file (format 2) contains a mesh.  A ``.step``, ``.stp`` or ``.brep`` file has a
    geometry; its solids are meshed in 3D, or its faces in the plane z = 0 in 2D.  Walls have the names of the
    file's boundaries, faces or physical groups.

    Parameters
    ----------
    path : path
        A .vol, .msh (gmsh), STEP or BREP file; a path in a case file is relative to the case file.
    maxh : float
        Largest size of a cell, in the file's unit; required for geometries.
    order : int
        Polynomial order of curved cells, if the geometry is known.
    split_corners
        As for ``box``.

    Raises
    ------
    MeshError
        If the file is missing, cut short or unreadable, or has no volume cells.
    ParameterError
        If the file's name has another ending, or maxh is missing.
    """
    path = require_path("load.path", path)
    if maxh is not None:
        maxh = as_length("load.maxh", maxh)
    check_order("load", order)
    require_type("load.split_corners", split_corners, bool)
    _check_file(path)
    kind = path.suffix.lower()
    if maxh is None and kind not in _MESHES:
        raise ParameterError("load.maxh", maxh, "a cell size, since the file has a geometry")
    try_apart(str(path), "read the file", f"path = sys.argv[1]\n{_MESHES.get(kind, _GEOMETRY)}", str(path))
    try:
        mesh = _read(path, kind, maxh)
    except (MeshError, ParameterError):
        raise
    except Exception as error:  # Netgen raises many types of errors
        raise MeshError(f"{path}: the file is not readable: {error}") from error
    if mesh.dim not in (2, 3) or mesh.ne == 0:
        raise MeshError(f"{path}: the mesh has no volume elements")
    mesh = split_corner_cells(mesh) if split_corners else mesh
    return mesh.Curve(order) if order > 1 and kind not in (".vol", ".msh") else mesh


def _check_file(path: Path) -> None:
    kind = path.suffix.lower()
    if kind not in _ENDS:
        raise ParameterError("load.path", str(path), f"a name that ends in {', '.join(_ENDS)}")
    if not path.is_file():
        raise MeshError(f"{path}: this file does not exist")
    text = path.read_text(encoding="utf-8", errors="replace")
    is_whole = _ENDS[kind] in text
    if kind == ".brep" and is_whole:  # Netgen crashes if announced shapes are missing
        head, *shapes = text[text.index("TShapes") :].split("*")
        is_whole = head.split()[1:2] == [str(len(shapes))] and len(text.rpartition("*")[2].split()) >= 2
    if not is_whole:
        raise MeshError(f"{path}: the file is cut short, since {_ENDS[kind]!r} is missing or incomplete")


_MESHES = {
    ".vol": """
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh
mesh = NetgenMesh()
mesh.Load(path)
Mesh(mesh)
""",
    ".msh": """
from netgen.read_gmsh import ReadGmsh
from ngsolve import Mesh
Mesh(ReadGmsh(path))
""",
}
_GEOMETRY = """
from netgen.occ import OCCGeometry
OCCGeometry(path).shape
"""
"""Code that tries a file without ngvisco, whose import takes longer than Netgen's."""


def _read(path: Path, kind: str, maxh: Any) -> Any:
    if kind == ".vol":
        netgen_mesh = NetgenMesh()
        netgen_mesh.Load(str(path))
        return Mesh(netgen_mesh)
    if kind == ".msh":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)  # ReadGmsh leaves its file open
            return Mesh(ReadGmsh(str(path)))
    shape = OCCGeometry(str(path)).shape
    dim = 3 if len(shape.solids) else 2
    low, high = shape.bounding_box
    extents = [high.x - low.x, high.y - low.y, high.z - low.z][:dim]
    is_sheet = len(shape.faces) > 0 and max(abs(low.z), abs(high.z)) <= _FLAT * max(extents)
    if dim == 2 and not is_sheet:
        raise MeshError(
            f"{path}: the geometry has no solid, so that its mesh has no volume elements; expected a solid, "
            "or faces in the plane z = 0 for a two-dimensional mesh"
        )
    domain = Domain("load", dim, [("maxh", max(extents))])
    domain.is_round = domain.is_delicate = True  # the file may have any shape
    if domain.unit != 1.0:
        shape = shape.Scale(Pnt(0, 0, 0), 1 / domain.unit)
    return domain.mesh(shape, maxh)

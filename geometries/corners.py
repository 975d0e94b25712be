"""Cells in corners of a domain, all of whose edges at one vertex lie on walls, and how they are divided.

Where walls hold the velocity, all its derivatives along these edges are data there, and so is the whole of
grad v in the cell at that vertex, for every order of v and size of the cell.  Under a lid of speed U that
meets a wall at rest, div v = +-U/h there.  No pressure can change that: the material that stays in such a
corner is compressed or expanded without end.  With one edge into the interior more div v is free again.
"""

import numpy as np
from netgen.meshing import Element2D, Element3D, ElementId2D, ElementId3D, MeshPoint, Pnt
from ngsolve import EDGE, FACE, Mesh, NodeId

from ngvisco.errors import MeshError


def corner_cells(mesh: Mesh) -> list[int]:
    """Numbers of the cells that have a vertex all of whose edges in the cell lie on walls.

    In 2D these are the cells with two edges on walls that meet, in 3D among others those with two faces on
    walls.  Boundaries between two cells and boundaries that the mesh identifies are no walls.
    """
    wall = _edges_on_walls(mesh)
    found = []
    for cell in mesh.Elements():
        edges: dict[int, list[int]] = {}
        for edge in cell.edges:
            for vertex in mesh[edge].vertices:
                edges.setdefault(vertex.nr, []).append(edge.nr)
        if any(wall.issuperset(at) for at in edges.values()):
            found.append(cell.nr)
    return found


def split_corner_cells(mesh: Mesh) -> Mesh:
    """Divide each of the ``corner_cells`` at its midpoint, into as many cells as it has facets (Alfeld).

    No other cell changes, and walls, subdomains and identified boundaries stay what they are.  The mesh is
    changed in place; use the one that is returned, which is curved as it was.

    Raises
    ------
    MeshError
        If the mesh is distributed, or has other cells than triangles, quadrilaterals and tetrahedra.
    """
    if mesh.comm.size > 1:
        raise MeshError("split_corner_cells: the mesh is distributed; divide its cells before that")
    cells = corner_cells(mesh)
    if not cells:
        return mesh
    order, raw = mesh.GetCurveOrder(), mesh.ngmesh
    elements = raw.Elements2D() if mesh.dim == 2 else raw.Elements3D()
    number, made = (ElementId2D, Element2D) if mesh.dim == 2 else (ElementId3D, Element3D)
    for cell in cells:
        element = elements[number(cell)]
        corners, index = list(element.vertices), element.index
        if mesh.dim == 3 and len(corners) != 4:
            raise MeshError("split_corner_cells: expected triangles, quadrilaterals or tetrahedra")
        places = np.array([raw[corner].p for corner in corners])
        middle = raw.Add(MeshPoint(Pnt(*places.mean(axis=0))))
        parts = _parts(corners, middle, mesh.dim)
        elements[number(cell)] = made(index, parts[0])
        for part in parts[1:]:
            raw.Add(made(index, part))
    mesh = Mesh(raw)
    return mesh.Curve(order) if order > 1 else mesh


def _parts(corners: list, middle: object, dim: int) -> list[list]:
    """The cells between the facets and the midpoint, oriented as the cell is."""
    if dim == 2:
        return [[a, b, middle] for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    return [[middle if i == k else corner for i, corner in enumerate(corners)] for k in range(4)]


def _edges_on_walls(mesh: Mesh) -> set[int]:
    kind = EDGE if mesh.dim == 2 else FACE
    cells = np.zeros(mesh.nedge if mesh.dim == 2 else mesh.nface, dtype=int)
    for cell in mesh.Elements():
        for facet in cell.facets:
            cells[facet.nr] += 1
    for pair, _ in mesh.GetPeriodicNodePairs(kind):
        cells[list(pair)] = 2
    walls = [NodeId(kind, int(nr)) for nr in np.flatnonzero(cells == 1)]
    if mesh.dim == 2:
        return {wall.nr for wall in walls}
    return {edge.nr for wall in walls for edge in mesh[wall].edges}

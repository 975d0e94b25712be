"""Vertices and facets of a mesh's simplices, also across periodic boundaries and between ranks."""

import numpy as np
from ngsolve import H1, VOL, ElementId, FacetFESpace, FESpace, Mesh, Periodic

from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.exchange import Exchange, Halo


class Surroundings:
    """Vertices, facets and neighbours of cells.  Identified vertices and facets count once.

    Parameters
    ----------
    mesh : ngsolve.Mesh
        Mesh of triangles or tetrahedra.
    corners : array (cells, corners, dim)
        Places of the cells' corners, m; all arrays have the corners in this order.
    periodic : bool
        Whether the mesh has identified boundaries.
    ranks : Communicator

    Attributes
    ----------
    vertices : array (cells, corners)
        Numbers of the cells' vertices.
    facets : array (facets, 4)
        Facets between two cells: a cell, its corner opposite to the facet, the other cell and its opposite
        corner.  A halo cell has one facet, whose corner has the number 0.
    sides : array (cells, corners)
        For each corner the number, within the cell, of the facet opposite to it.
    shared : Exchange
        Vertices that ranks share.
    halo : Halo
        Cells of other ranks that are neighbours of this rank's cells.
    at_border : array (2, border facets)
        Cells and corners opposite to facets between ranks.
    """

    def __init__(self, mesh: Mesh, corners: np.ndarray, periodic: bool, ranks: Communicator) -> None:
        spaces = H1(mesh, order=1), FacetFESpace(mesh, order=0)
        nodes, facets = (Periodic(s) if periodic else s for s in spaces)
        vertices, sides = numbers_of_cells(nodes), numbers_of_cells(facets)
        self.shared, borders = (Exchange.of(space, ranks) for space in (nodes, facets))
        points = np.array([vertex.point for vertex in mesh.vertices])
        first, rows, opposite = dict[int, tuple[int, int]](), [], np.empty_like(sides)
        for cell, element in enumerate(mesh.Elements(VOL)):
            vertices_of = [vertex.nr for vertex in element.vertices]
            near = np.linalg.norm(corners[cell][:, None] - points[vertices_of], axis=2).argmin(axis=1)
            vertices[cell] = vertices[cell][near]
            for at, (number, facet) in enumerate(zip(sides[cell], element.facets, strict=True)):
                on = {vertex.nr for vertex in mesh[facet].vertices}
                corner = next(c for c, place in enumerate(near) if vertices_of[place] not in on)
                opposite[cell, corner] = at
                if number in first:
                    rows.append([*first[number], cell, corner])
                else:
                    first[number] = cell, corner
        border = np.array([first[number] for number in borders.places], dtype=int).reshape(-1, 2)
        self.halo, self.at_border = Halo(borders, border[:, 0], mesh.ne), border.T
        rows += [[*of_rank, mesh.ne + number, 0] for number, of_rank in enumerate(border)]
        self.vertices, self.sides = vertices, opposite
        self.facets = np.array(rows, dtype=int).reshape(-1, 4)


def numbers_of_cells(space: FESpace) -> np.ndarray:
    """Numbers of the dim + 1 unknowns of every cell, (cells, unknowns)."""
    numbers = [space.GetDofNrs(ElementId(VOL, cell)) for cell in range(space.mesh.ne)]
    return np.array(numbers, dtype=int).reshape(space.mesh.ne, space.mesh.dim + 1)

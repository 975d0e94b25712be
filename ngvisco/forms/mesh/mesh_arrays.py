"""What NGSolve's meshes and spaces know one by one, as arrays: no loop of Python's over cells or unknowns."""

from itertools import combinations

import numpy as np
from ngsolve import (
    BND,
    ET,
    VOL,
    BitArray,
    CoefficientFunction,
    Det,
    FacetFESpace,
    IntegrationRule,
    LinearForm,
    Mesh,
    Projector,
    dx,
    specialcf,
)
from ngsolve.la import CreateVVector

from ngvisco.errors import MeshError
from ngvisco.parallel.communicator import Communicator

_TRIANGLE = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]
VERTICES: dict[ET, list[tuple[float, ...]]] = {
    ET.SEGM: [(0.0,), (1.0,)],
    ET.TRIG: [*_TRIANGLE],
    ET.QUAD: [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)],
    ET.TET: [*((*point, 0.0) for point in _TRIANGLE), (0.0, 0.0, 1.0)],
}
"""Of NGSolve's reference facets and cells."""

SIMPLICES = (10, 12, 20, 21)
"""Netgen's numbers of triangles and tetrahedra, straight and of second order."""


def mask_of(bits: BitArray) -> np.ndarray:
    """A set of unknowns as an array of bool."""
    ones = CreateVVector(len(bits))
    ones[:] = 1.0
    Projector(bits, True).Project(ones)
    return ones.FV().NumPy() != 0


_KNOWN = {2: {ET.TRIG, ET.QUAD}, 3: {ET.TET}}
_WORDS = {ET.PYRAMID: "pyramids", ET.PRISM: "prisms", ET.HEX: "hexahedra"}


def unknown_cells(mesh: Mesh) -> list[str]:
    """Types of cells, in words, for which there are no spaces and rules here."""
    if is_simplicial(mesh):
        return []
    found = {cell.type for cell in mesh.Elements(VOL)} - _KNOWN[mesh.dim]
    return sorted(_WORDS.get(kind, str(kind)) for kind in found)


def _cells(mesh: Mesh) -> np.ndarray:
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    return elements.NumPy()


def is_simplicial(mesh: Mesh) -> bool:
    """Whether all cells are triangles or tetrahedra."""
    return bool(np.isin(_cells(mesh)["type"], SIMPLICES).all())


def vertices(mesh: Mesh) -> np.ndarray:
    """Vertices of the cells, cell by cell, from 0; (cells, dim + 1) where all are simplices."""
    if is_simplicial(mesh):
        return _cells(mesh)["nodes"][:, : mesh.dim + 1].astype(np.int64) - 1
    return np.array([v.nr for cell in mesh.Elements(VOL) for v in cell.vertices])


def coordinates(mesh: Mesh) -> np.ndarray:
    """Of the vertices, (vertices, dim), m."""
    return mesh.ngmesh.Coordinates()[: mesh.nv]


def rigid_motions(mesh: Mesh, width: int, count: int) -> np.ndarray:
    """Translations and rotations by the values at the vertices, (n, count).

    Components of v follow each other with ``width`` coefficients each, those of the vertices first.
    """
    dim, places = mesh.dim, coordinates(mesh).T
    pairs, at = list(combinations(range(dim), 2)), np.arange(mesh.nv)
    motions = np.zeros((dim + len(pairs), count))
    for i in range(dim):
        motions[i, i * width + at] = 1.0
    for motion, (i, j) in zip(motions[dim:], pairs, strict=True):
        motion[i * width + at] = -places[j]
        motion[j * width + at] = places[i]
    return motions


_OPPOSED = 1e-6  # of the facet's area: what is left of the normals' sum


def facets_with_two_sides(mesh: Mesh) -> np.ndarray:
    """Where two cells lie on different sides of a facet, so that their outward normals cancel; (facets,).

    Facets that the mesh identifies with another one have one side each.
    """
    n = specialcf.normal(mesh.dim)
    # the mean normals of both sides, over twice the area of the facet
    sums = np.array([facet_sums(mesh, n[i]) for i in range(mesh.dim)])
    return np.linalg.norm(sums, axis=0) <= _OPPOSED * facet_sums(mesh, 1 + 0 * n[0])


def facet_sums(mesh: Mesh, value: CoefficientFunction) -> np.ndarray:
    """Integrals over the facets, of both sides, (facets,); collective."""
    q = FacetFESpace(mesh, order=0).TestFunction()
    sums = LinearForm(value * q * dx(element_boundary=True)).Assemble().vec
    sums.Cumulate()  # the other side may belong to another rank
    return sums.FV().NumPy().copy()


def facets_of_walls(mesh: Mesh) -> np.ndarray:
    """The facet of every boundary element, (elements,), as an index into such arrays.

    Not its number as an edge or a face: a mesh that was refined counts those that were divided, too.
    """
    space = FacetFESpace(mesh, order=0)
    return np.array([space.GetDofNrs(element)[0] for element in mesh.Elements(BND)], dtype=int)


def boundary_facets(mesh: Mesh) -> np.ndarray:
    """Where the mesh has boundary elements: walls, identified boundaries, interfaces; (facets,)."""
    space = FacetFESpace(mesh, order=0)
    return mask_of(space.GetDofs(mesh.Boundaries(".*")))


_ORDER = 4  # degree of the points at which the determinant is looked at; curved cells vary inside


def check_orientation(mesh: Mesh) -> None:
    """Raise MeshError for a cell that is turned inside out, in part or as a whole.

    Two things are looked at.  The determinant of the map from the reference cell keeps its sign and
    is nowhere zero in a cell; which sign is only a matter of the order of its vertices.  The two cells
    of an inner facet lie on different sides of it, so that their outward normals cancel.
    """
    for check in (_of_determinants, _of_sides):
        error = Communicator.of(mesh).agree(check(mesh))
        if error is not None:
            raise error


def _of_determinants(mesh: Mesh) -> MeshError | None:
    types = (ET.TRIG, ET.QUAD) if mesh.dim == 2 else (ET.TET,)
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    for et in types:
        rule = IntegrationRule(et, _ORDER)
        points = mesh.MapToAllElements({et: rule}, VOL)
        values = np.asarray(determinant(points)).reshape(-1, len(rule.points))
        flat = np.sign(values).min(axis=1) * np.sign(values).max(axis=1) <= 0
        if flat.any():
            row = int(np.argmax(flat))
            numbers = [element.nr for element in mesh.Elements(VOL) if element.type == et]
            return MeshError(
                f"element {numbers[row]} is inverted or flat: the determinant of its map takes values from "
                f"{values[row].min():.3e} to {values[row].max():.3e}; expected one sign and no zero"
            )
    return None


def _of_sides(mesh: Mesh) -> MeshError | None:
    doubled = ~(facets_with_two_sides(mesh) | boundary_facets(mesh))
    if not doubled.any():
        return None
    facet = int(np.argmax(doubled))
    return MeshError(
        f"facet {facet}, on no boundary, has cells on one side only: "
        "a cell is inverted, cells overlap, or the mesh lacks a boundary element there"
    )

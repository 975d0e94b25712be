"""Arrays of NGSolve's meshes and spaces, without Python loops over cells or unknowns."""

from itertools import combinations

import numpy as np
from ngsolve import (
    BND,
    EDGE,
    ET,
    FACE,
    VOL,
    BitArray,
    CoefficientFunction,
    Det,
    FacetFESpace,
    GridFunction,
    IntegrationRule,
    LinearForm,
    Mesh,
    NodeId,
    Projector,
    Region,
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
"""Vertices of NGSolve's reference facets and cells."""

_KINDS = {1: (ET.SEGM,), 2: (ET.TRIG, ET.QUAD), 3: (ET.TET, ET.PRISM, ET.PYRAMID, ET.HEX)}


def rules(dim: int, degree: int) -> dict[ET, IntegrationRule]:
    """Rules of one degree for all types of cells, or facets, of dimension ``dim``."""
    return {et: IntegrationRule(et, degree) for et in _KINDS[dim]}


def values_on(wall: Region, function: CoefficientFunction, degree: int) -> np.ndarray:
    """Values of a function at the points of a rule on a wall, (points, components)."""
    return np.asarray(function(wall.mesh.MapToAllElements(rules(wall.mesh.dim - 1, degree), wall)))


SIMPLICES = (10, 12, 20, 21)
"""Netgen's type numbers of straight and second-order triangles and tetrahedra."""


def mask_of(bits: BitArray) -> np.ndarray:
    """A Boolean array that marks a set of unknowns."""
    ones = CreateVVector(len(bits))
    ones[:] = 1.0
    Projector(bits, True).Project(ones)
    return ones.FV().NumPy() != 0


def _cells(mesh: Mesh) -> np.ndarray:
    return (mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()).NumPy()


def is_simplicial(mesh: Mesh) -> bool:
    """Whether all cells are triangles or tetrahedra."""
    return bool(np.isin(_cells(mesh)["type"], SIMPLICES).all())


def vertices(mesh: Mesh) -> np.ndarray:
    """Numbers of the cells' vertices, from 0: (cells, dim + 1) for simplices, else one flat array."""
    if is_simplicial(mesh):
        return _cells(mesh)["nodes"][:, : mesh.dim + 1].astype(np.int64) - 1
    return np.array([v.nr for cell in mesh.Elements(VOL) for v in cell.vertices])


def coordinates(mesh: Mesh) -> np.ndarray:
    """Coordinates of the vertices, (vertices, dim), m."""
    return mesh.ngmesh.Coordinates()[: mesh.nv]


def rigid_motions(mesh: Mesh, width: int, count: int) -> np.ndarray:
    """Values of translations and rotations at the vertices, as coefficients of v, (n, count).

    Each component of v has ``width`` consecutive coefficients, the vertices' coefficients first.
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


_OPPOSED = 1e-6  # largest |sum| of both sides' integrated normals, divided by twice the facet's area


def facets_with_two_sides(mesh: Mesh) -> np.ndarray:
    """Mask of facets with cells on two sides, whose outward normals cancel; (facets,).

    A facet that the mesh identifies with another one has one side.
    """
    n = specialcf.normal(mesh.dim)
    # the sum of both sides' integrated normals, compared with twice the facet's area
    sums = np.array([facet_sums(mesh, n[i]) for i in range(mesh.dim)])
    return np.linalg.norm(sums, axis=0) <= _OPPOSED * facet_sums(mesh, 1 + 0 * n[0])


def facet_sums(mesh: Mesh, value: CoefficientFunction) -> np.ndarray:
    """Integrals over the facets, summed over both sides, (facets,); collective."""
    q = FacetFESpace(mesh, order=0).TestFunction()
    sums = LinearForm(value * q * dx(element_boundary=True)).Assemble().vec
    sums.Cumulate()  # the facet's other side may belong to another rank
    return sums.FV().NumPy().copy()


def facets_of_walls(mesh: Mesh) -> np.ndarray:
    """Facet of every boundary element, (elements,), as an index into arrays of facets.

    The number of the edge or face is another number, because a refined mesh also counts divided edges and
    faces.
    """
    space = FacetFESpace(mesh, order=0)
    return np.array([space.GetDofNrs(element)[0] for element in mesh.Elements(BND)], dtype=int)


def boundary_facets(mesh: Mesh) -> np.ndarray:
    """Mask of facets with a boundary element: walls, identified boundaries, interfaces; (facets,)."""
    return mask_of(FacetFESpace(mesh, order=0).GetDofs(mesh.Boundaries(".*")))


def periodic_facets(mesh: Mesh) -> set[int]:
    """Facets that the mesh identifies with another one, as indices into arrays of facets."""
    kind, space = EDGE if mesh.dim == 2 else FACE, FacetFESpace(mesh, order=0)
    pairs = (pair for pair, _ in mesh.GetPeriodicNodePairs(kind))
    return {facet for pair in pairs for nr in pair for facet in space.GetDofNrs(NodeId(kind, nr))}


def inner_facets(mesh: Mesh) -> GridFunction:
    """Indicator of facets: 1 between two cells, on identified facets and interfaces; 0 on walls."""
    indicator = GridFunction(FacetFESpace(mesh, order=0))
    wall = boundary_facets(mesh) & ~facets_with_two_sides(mesh)
    wall[list(periodic_facets(mesh))] = False
    indicator.vec.FV().NumPy()[:] = ~wall
    return indicator


_ORDER = 4  # degree of the points at which the determinant is checked; on curved cells it is not constant
_CELLS = {2: (ET.TRIG, ET.QUAD), 3: (ET.TET,)}
_WORDS = {ET.PYRAMID: "pyramids", ET.PRISM: "prisms", ET.HEX: "hexahedra"}


def check_mesh(mesh: Mesh) -> None:
    """Raise MeshError unless the mesh is 2D or 3D, has cells, all of known types, and none is inverted.

    The orientation of cells is checked by two conditions.  The determinant of the map from the reference
    cell keeps its sign and is nowhere zero in a cell; the sign itself depends on the order of the vertices
    only.  The two cells of an inner facet lie on different sides of it, so that their outward normals
    cancel.
    """
    if mesh.dim not in (2, 3):
        raise MeshError(f"the mesh has dimension {mesh.dim}; expected 2 (plane strain) or 3")
    if mesh.comm.Sum(mesh.ne) == 0:
        raise MeshError("the mesh has no volume elements; mesh the interior, not only its surface")
    unknown: set[ET] = set()
    if not is_simplicial(mesh):
        unknown = {cell.type for cell in mesh.Elements(VOL)}.difference(_CELLS[mesh.dim])
    if mesh.comm.Sum(len(unknown)):
        names = ", ".join(sorted(_WORDS.get(kind, str(kind)) for kind in unknown)) or "others"
        raise MeshError(
            f"the mesh has cells of the types {names}; expected triangles and quadrilaterals, or tetrahedra "
            "(mesh.ngmesh.Split2Tets() divides hexahedra and prisms)"
        )
    ranks = Communicator.of(mesh)
    with ranks.together(MeshError):
        _check_determinants(mesh)
    doubled = ~(facets_with_two_sides(mesh) | boundary_facets(mesh))
    with ranks.together(MeshError):
        if doubled.any():
            raise MeshError(
                f"facet {int(np.argmax(doubled))} is on no boundary, but has cells on one side only: either "
                "a cell is inverted, or cells overlap, or the mesh lacks a boundary element at this facet"
            )


def _check_determinants(mesh: Mesh) -> None:
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    for et, rule in rules(mesh.dim, _ORDER).items():
        values = np.asarray(determinant(mesh.MapToAllElements({et: rule}, VOL))).reshape(-1, len(rule.points))
        flat = np.sign(values).min(axis=1) * np.sign(values).max(axis=1) <= 0
        if flat.any():
            row = int(np.argmax(flat))
            numbers = [element.nr for element in mesh.Elements(VOL) if element.type == et]
            raise MeshError(
                f"element {numbers[row]} is inverted or flat: the determinant of its map takes values from "
                f"{values[row].min():.3e} to {values[row].max():.3e}; expected one sign and no zero"
            )

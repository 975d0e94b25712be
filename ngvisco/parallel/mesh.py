"""Distributed meshes: each rank has a part of the cells, but NGSolve leaves the first rank without cells."""

import pickle

import numpy as np
from ngsolve import CF, VERTEX, Integrate, Mesh, dx

from ngvisco.errors import MeshError
from ngvisco.parallel.communicator import Communicator

CURVED = (
    "curved cells are distributed over ranks only if their geometry is known, but this mesh has none; "
    "expected a mesh of a Netgen geometry, or straight cells, or one process"
)
_SHAPE = 1e-10
"""Allowed relative difference between the volume and surface of all parts and of the whole mesh."""


class MeshPart(Mesh):
    """A rank's part of a mesh; facets and vertices at its border belong to neighbouring parts as well.

    Attributes
    ----------
    whole : Mesh or None
        The whole mesh on the first rank, whose part has no cells; None on others.
    cells : array (cells,)
        Number of each cell of the part in the whole mesh.
    ranks : Communicator
    """

    whole: Mesh | None = None
    cells: np.ndarray = np.zeros(0, dtype=np.int64)
    ranks = Communicator()
    order = 1

    def GetCurveOrder(self) -> int:
        """The order of the whole mesh.  NGSolve gives a part without curved cells order 1, and results that
        depend on the order would differ between ranks."""
        return self.order


def distributed(mesh: Mesh | None, ranks: Communicator) -> Mesh:
    """Distribute the first rank's mesh by METIS, collectively; on one process return the mesh itself.

    Raises MeshError on every rank if the mesh is curved by no known geometry, if a facet has several images
    across periodic boundaries, if the mesh has fewer cells than there are ranks that need cells, or if METIS
    leaves one of these ranks without cells.

    Parameters
    ----------
    mesh : Mesh or None
        The whole mesh on the first rank; ignored on other ranks.

    Returns
    -------
    Mesh
        A ``MeshPart`` on several ranks.
    """
    from netgen.meshing import Mesh as NetgenMesh

    if not ranks.is_distributed:
        assert mesh is not None
        return mesh
    ranks.on_first(lambda: _check(mesh, ranks.size - 1))
    if mesh is not None and ranks.is_first:
        # Distribute empties the mesh, so it gets a copy; Netgen's ``Copy`` drops identified boundaries
        part = MeshPart(pickle.loads(pickle.dumps(mesh.ngmesh)).Distribute(ranks.mpi))
        part.whole = mesh
    else:
        part = MeshPart(NetgenMesh.Receive(ranks.mpi))
    _curve(part, mesh, ranks)
    if ranks.any(not ranks.is_first and not part.ne):
        cells = int(ranks.total(part.ne))
        message = f"one of {ranks.size - 1} ranks gets none of the {cells} cells from METIS"
        raise MeshError(f"{message}; expected fewer ranks, or a finer mesh")
    part.ranks, part.cells = ranks, _numbers(part, ranks)
    return part


def _curve(part: MeshPart, whole: Mesh | None, ranks: Communicator) -> None:
    """Curve a part's cells by the geometry of the whole mesh, since NGSolve distributes straight cells.

    Collective.  Raises MeshError on every rank if volume or surface then differ from the whole mesh's.
    """

    def shape() -> tuple[int, bytes, list[float]]:
        assert whole is not None
        order = whole.GetCurveOrder()
        geometry = pickle.dumps(whole.ngmesh.GetGeometry()) if order > 1 else b""
        return order, geometry, volume_and_surface(whole) if order > 1 else []

    order, geometry, sizes = ranks.on_first(shape)
    if order > 1:
        part.ngmesh.SetGeometry(pickle.loads(geometry))
        part.Curve(order)
        part.order = order
        if not np.allclose(volume_and_surface(part), sizes, rtol=_SHAPE, atol=0):
            raise MeshError(CURVED)


def volume_and_surface(mesh: Mesh) -> list[float]:
    """The volume and surface of a mesh's cells, m^dim and m^(dim - 1), summed over the ranks; collective.

    The surface is summed over all cells, with inner facets twice, because a part also contains identified
    boundaries whose cells belong to other ranks.
    """
    integrals = (CF(1.0) * dx, CF(1.0) * dx(element_boundary=True))  # sums over this rank's cells alone
    return [float(mesh.comm.Sum(Integrate(integral, mesh))) for integral in integrals]


def has_geometry(mesh: Mesh) -> bool:
    """Whether a mesh has a Netgen geometry that can curve its cells."""
    from netgen.meshing import NetgenGeometry

    return type(mesh.ngmesh.GetGeometry()) is not NetgenGeometry


def cell_numbers(mesh: Mesh) -> np.ndarray:
    """Numbers of this rank's cells in the whole mesh; 0, 1, ... on one process."""
    return mesh.cells if isinstance(mesh, MeshPart) else np.arange(mesh.ne)


def whole_of(mesh: Mesh) -> Mesh | None:
    """The whole mesh on the first rank, None on others; on one process the mesh itself."""
    return mesh.whole if isinstance(mesh, MeshPart) else mesh


def of_whole(mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """Collect the ranks' values of their cells, (cells,), in the order of the whole mesh, on the first rank
    alone; collective."""
    if not isinstance(mesh, MeshPart):
        return values
    numbers, parts = mesh.ranks.mpi.gather(mesh.cells), mesh.ranks.mpi.gather(values)
    return values[:0] if parts is None else np.concatenate(parts)[np.argsort(np.concatenate(numbers))]


def number_of(mesh: Mesh, cell: int) -> int | None:
    """Number in the whole mesh of this rank's ``cell``; None if the whole mesh is not known."""
    if isinstance(mesh, MeshPart):
        return int(mesh.cells[cell])
    return cell if mesh.comm.size == 1 else None


def _numbers(part: MeshPart, ranks: Communicator) -> np.ndarray:
    """Numbers of a part's cells in the whole mesh; collective.

    A cell is found by its vertices, which have equal order in both meshes, and a vertex by its coordinates,
    which NGSolve distributes bit for bit.
    """
    points, nodes = _corners(part)
    places = ranks.mpi.gather(points)
    cells = ranks.mpi.gather(nodes)
    answers = None
    if part.whole is not None:
        every, of_whole = _corners(part.whole)
        vertices = {place.tobytes(): number for number, place in enumerate(every)}
        number_of_cell = {nodes.tobytes(): number for number, nodes in enumerate(of_whole)}
        answers = []
        for points, nodes in zip(places, cells, strict=True):
            number = np.array([-1, *(vertices[place.tobytes()] for place in points)], dtype=np.int64)
            numbers = [number_of_cell[corners.tobytes()] for corners in number[nodes + 1]]
            answers.append(np.array(numbers, dtype=np.int64))
    return ranks.mpi.scatter(answers)


def _corners(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the vertices, and the cells' vertices, (cells, 4), padded with -1."""
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    nodes = elements.NumPy()["nodes"][:, :4].astype(np.int64) - 1
    nodes[nodes >= mesh.nv] = -1  # nodes at the middles of edges
    return np.array(mesh.ngmesh.Coordinates()[: mesh.nv]), nodes


def _check(mesh: Mesh | None, parts: int) -> None:
    assert mesh is not None
    if mesh.GetCurveOrder() > 1 and not has_geometry(mesh):
        raise MeshError(CURVED)
    if mesh.dim == 3 and (images := _images_of_facets(mesh)) > 1:
        raise MeshError(
            f"the corners of a facet are identified with the corners of {images} other facets, because the "
            "mesh is one cell wide along a periodic direction. Netgen does not distribute such a mesh; "
            "expected two or more cells along each periodic direction, or one process"
        )
    if mesh.ne < parts:
        raise MeshError(
            f"the mesh has {mesh.ne} cells, but {parts} ranks need at least one cell each; expected fewer "
            "ranks"
        )


def _images_of_facets(mesh: Mesh) -> int:
    """The largest number of images of a boundary facet: facets with an image of each of its corners.

    Netgen ends a process if a facet has two images (``Mesh::SendMesh``), as in a mesh of a single cell along
    two periodic directions.
    """
    images: dict[int, list[int]] = {}
    for (first, second), _ in mesh.GetPeriodicNodePairs(VERTEX):
        images.setdefault(first, []).append(second)
        images.setdefault(second, []).append(first)
    facets = (mesh.ngmesh.Elements2D().NumPy()["nodes"][:, :3].astype(np.int64) - 1).tolist()
    facets = [facet for facet in facets if all(corner in images for corner in facet)]
    at: dict[int, set[int]] = {}
    for number, facet in enumerate(facets):
        for corner in facet:
            at.setdefault(corner, set()).add(number)
    near = {corner: set().union(*(at.get(image, ()) for image in images[corner])) for corner in at}
    return max((len(set.intersection(*(near[corner] for corner in facet))) for facet in facets), default=0)

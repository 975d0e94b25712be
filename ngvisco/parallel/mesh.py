"""Meshes over the ranks: a part of the cells each, none on the first, as NGSolve has it."""

from __future__ import annotations

from ngsolve import VERTEX, Mesh

from ngvisco.errors import MeshError
from ngvisco.parallel.communicator import Communicator

CURVED = (
    "curved cells are not distributed: NGSolve's ranks do not get their shape; expected straight cells, or "
    "one process"
)
PERIODIC = (
    "identified boundaries are not distributed: NGSolve's partition parts them; expected a domain that is "
    "not periodic, or one process"
)


class Part(Mesh):
    """A rank's part of a mesh, with facets and vertices at its border that other ranks have too.

    Attributes
    ----------
    whole : Mesh or None
        The mesh itself on the first rank, which has no cells of the part; None on others.
    """

    whole: Mesh | None = None


def distributed(mesh: Mesh | None, ranks: Communicator) -> Mesh:
    """The first rank's mesh in parts by METIS, collective; on one process the mesh itself.

    Parameters
    ----------
    mesh : Mesh or None
        The whole mesh on the first rank, not looked at on others.
    ranks : Communicator

    Returns
    -------
    Mesh
        A ``Part`` on several ranks.

    Raises
    ------
    MeshError
        On every rank, for a mesh that is not distributed: curved or periodic, or one of less cells than
        there are ranks for them.
    """
    from netgen.meshing import Mesh as NetgenMesh

    if not ranks.is_distributed:
        assert mesh is not None
        return mesh
    refusal = ranks.on_first(lambda: _refusal(mesh, ranks.size - 1))
    if refusal is not None:
        raise MeshError(refusal)
    if mesh is not None and ranks.is_first:
        part = Part(mesh.ngmesh.Copy().Distribute(ranks.mpi))  # which takes the cells away
        part.whole = mesh
        return part
    return Part(NetgenMesh.Receive(ranks.mpi))


def _refusal(mesh: Mesh | None, parts: int) -> str | None:
    assert mesh is not None
    if mesh.GetCurveOrder() > 1:
        return CURVED
    if len(mesh.GetPeriodicNodePairs(VERTEX)):
        return PERIODIC
    if mesh.ne < parts:
        return f"the mesh has {mesh.ne} cells for {parts} ranks with cells: expected fewer ranks"
    return None

"""Meshes over the ranks: a part of the cells each, none on the first, as NGSolve has it."""

from __future__ import annotations

from typing import Any

from ngsolve import VERTEX, Mesh

from ngvisco.errors import MeshError

CURVED = (
    "curved cells are not distributed: NGSolve's ranks do not get their shape; expected straight cells, or "
    "one process"
)
PERIODIC = (
    "identified boundaries are not distributed: NGSolve's partition parts them; expected a domain that is "
    "not periodic, or one process"
)


def world() -> Any:
    """mpi4py's communicator of all processes that mpirun started, None where it started one or mpi4py is
    missing."""
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError):  # RuntimeError: no library of MPI
        return None
    return MPI.COMM_WORLD if MPI.COMM_WORLD.size > 1 else None


def distributed(mesh: Mesh | None, comm: Any) -> Mesh:
    """The first rank's mesh in parts by METIS; collective.

    Parameters
    ----------
    mesh : Mesh or None
        The whole mesh on the first rank, not looked at on others.
    comm : mpi4py communicator

    Raises
    ------
    MeshError
        On every rank, for a mesh that is not distributed: curved or periodic, or one of less cells than
        there are ranks for them.
    """
    from netgen.meshing import Mesh as NetgenMesh

    refusal = comm.bcast(_refusal(mesh, comm.size - 1) if mesh is not None else None)
    if refusal is not None:
        raise MeshError(refusal)
    if comm.rank == 0:
        assert mesh is not None
        return Mesh(mesh.ngmesh.Distribute(comm))
    return Mesh(NetgenMesh.Receive(comm))


def _refusal(mesh: Mesh, parts: int) -> str | None:
    if mesh.GetCurveOrder() > 1:
        return CURVED
    if len(mesh.GetPeriodicNodePairs(VERTEX)):
        return PERIODIC
    if mesh.ne < parts:
        return f"the mesh has {mesh.ne} cells for {parts} ranks with cells: expected fewer ranks"
    return None

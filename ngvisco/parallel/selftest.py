"""What distributed runs need, tried: a mesh in parts, the exchange of what ranks share, PETSc's solvers.

``mpirun -n 3 python -m ngvisco.parallel.selftest`` prints a line for each, from the first rank.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
from netgen.occ import Box, OCCGeometry, Pnt
from ngsolve import (
    H1,
    BilinearForm,
    Grad,
    InnerProduct,
    LinearForm,
    Mesh,
    VectorH1,
    dx,
    x,
    y,
)
from ngsolve.la import PARALLEL_STATUS

from ngvisco.errors import NgviscoError
from ngvisco.parallel.communicator import TRAFFIC, Communicator
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import distributed
from ngvisco.parallel.petsc import Direct, Rows, own_part, packages, petsc

_ROUNDING, _REDUCTION = 1e-9, 1e-8


def tried(ranks: Communicator) -> Iterator[tuple[str, str]]:
    """What was tried with what came of it, collective; raises what fails."""
    whole = None
    if ranks.is_first:
        cube = OCCGeometry(Box(Pnt(0, 0, 0), Pnt(1, 1, 1)))
        whole = Mesh(cube.GenerateMesh(maxh=0.25, parallel_meshing=False))
    mesh = distributed(whole, ranks)
    communicator = Communicator.of(mesh)
    cells = int(communicator.total(mesh.ne))
    if cells != ranks.total(whole.ne if whole is not None else 0):
        raise NgviscoError("the parts of the mesh are not the mesh")
    yield "mesh", f"{cells} cells on {ranks.size - 1} of {ranks.size} ranks"
    yield "exchange", _exchanged(mesh, communicator)
    yield from _solved(mesh, communicator)


def _exchanged(mesh: Mesh, communicator: Communicator) -> str:
    """Compare our exchange with NGSolve's."""
    space = H1(mesh, order=2)
    vector = LinearForm((1 + x * y) * space.TestFunction() * dx).Assemble().vec
    ours = Exchange.of(space, communicator).sum(vector.FV().NumPy().copy())
    vector.Cumulate()
    difference = communicator.most(np.abs(ours - vector.FV().NumPy()))
    if difference > _ROUNDING:
        raise NgviscoError(f"the exchange of shared unknowns is wrong by {difference:.1e}")
    messages = int(communicator.total(TRAFFIC.messages))
    return f"{messages} messages, as NGSolve's to {difference:.0e}"


def _solved(mesh: Mesh, communicator: Communicator) -> Iterator[tuple[str, str]]:
    """An elastic block by the direct solver and by each multigrid."""
    space = VectorH1(mesh, order=2, dirichlet=".*")
    u, w = space.TnT()
    form = BilinearForm(space, symmetric=True)
    form += InnerProduct(Grad(u) + Grad(u).trans, Grad(w)) * dx
    form.Assemble()
    load = LinearForm((1 + x) * w[0] * dx).Assemble().vec
    free, exchange = space.FreeDofs(), Exchange.of(space, communicator)
    mask = np.array(list(free), dtype=bool)
    found, residual = load.CreateVector(), load.CreateVector()

    def left() -> float:
        residual.data = load - form.mat * found
        residual.Cumulate()
        own = mask & exchange.owned
        load.Cumulate()
        return communicator.norm(residual.FV().NumPy()[own]) / communicator.norm(load.FV().NumPy()[own])

    if packages()["mumps"]:
        Direct(form.mat, free, communicator).Mult(load, found)
        if not (rest := left()) <= _ROUNDING:
            raise NgviscoError(f"MUMPS leaves a residual of {rest:.1e}")
        yield "MUMPS", f"{space.ndofglobal} unknowns, residual {rest:.0e}"
    rows = Rows(mask, exchange)
    matrix = None if communicator.is_idle else rows.matrix(own_part(form.mat))
    load.Distribute()
    parts = load.FV().NumPy().copy()
    for name in ("gamg", *(["hypre"] if packages()["hypre"] else [])):
        found.SetParallelStatus(PARALLEL_STATUS.CUMULATED)
        iterations = 0
        if not communicator.is_idle:
            solver = petsc().KSP().create(comm=rows.comm)
            solver.setOperators(matrix)
            solver.setType("cg")
            solver.getPC().setType(name)
            solver.setTolerances(rtol=_REDUCTION)
            found.FV().NumPy()[:] = rows.solve(solver, parts)
            iterations = solver.getIterationNumber()
        if not (rest := left()) <= 100 * _REDUCTION:  # what it reduces is the preconditioned residual
            raise NgviscoError(f"{name} leaves a residual of {rest:.1e}")
        yield name, f"{int(communicator.most(iterations))} iterations, residual {rest:.0e}"


def main() -> int:
    """Print what was tried; 1 where something failed."""
    ranks = Communicator.world()
    if not ranks.is_distributed:
        print("one process: expected mpirun -n 3 python -m ngvisco.parallel.selftest")
        return 1
    try:
        for name, result in tried(ranks):
            if ranks.is_first:
                print(f"{name:10s} {result}", flush=True)
    except NgviscoError as error:
        print(f"failed     {error}", flush=True)
        ranks.abort(1)
    return 0


if __name__ == "__main__":
    sys.exit(main())

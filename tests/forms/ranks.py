"""Values of all forms of a step that know nothing of numbering, printed as JSON; for one rank or several.

Run by ``test_ranks``.  Rank 0 holds no cells: two ranks with cells take three.
"""

from __future__ import annotations

import faulthandler
import json
import sys

import numpy as np
from mpi4py import MPI
from netgen.meshing import Mesh as NetgenMesh
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import (
    CF,
    BilinearForm,
    CGSolver,
    FESpace,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Mesh,
    Preconditioner,
    cos,
    dx,
    pi,
    sin,
    specialcf,
    x,
    y,
    z,
)

import ngvisco as nv
from ngvisco.forms.system import Step
from ngvisco.geometries import box
from ngvisco.run.passive import PassiveFields


def mesh_of(name: str) -> Mesh:
    """The mesh, distributed where there are several ranks."""
    comm = MPI.COMM_WORLD
    several = {"comm": comm} if comm.size > 1 else {}
    if name == "a disc":  # its geometry has to be on every rank, so that the cells can be curved
        wall = WorkPlane().Circle(1.0).Face()
        wall.edges.name = "wall"
        return Mesh(OCCGeometry(wall, dim=2).GenerateMesh(maxh=0.6, **several)).Curve(2)
    whole = None
    if comm.rank == 0:
        whole = (
            box((1, 1), maxh=0.3, periodic="x") if name == "a periodic square" else box((1,) * 3, maxh=0.6)
        )
    if not several:
        return whole
    return Mesh(NetgenMesh.Receive(comm) if whole is None else whole.ngmesh.Distribute(comm))


def model(dim: int) -> nv.Model:
    return nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=nv.StokesViscosity(K_v=0.1, G_v=0.1),
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
        creep=nv.Creep(G_m=2.0, nu=1e-3, q=4),
        loads=[nv.Gravity((0.0,) * (dim - 1) + (-1.0,))],
        regularisation=nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, epsilon=0.1, rho_max=1.0),
    )


class Functions:
    """Writes functions of position into every block of a state, traces by their L2 projections."""

    def __init__(self, step: Step) -> None:
        self.layout, self.dim = step.layout, step.mesh.dim
        self.solvers: dict = {}

    def __call__(self, target: GridFunction, kind: int) -> None:
        for i, name in enumerate(self.layout.names):
            part, level = target.components[i], 1.0 if name.startswith(("rho", "z")) else 0.1
            value = CF(tuple(level + self._wave(i, j, kind) for j in range(part.dim)))
            if name.endswith("_hat") or name.startswith("a_"):
                part.vec.data = self._projected(name, part.space, value)
            elif name == "wall_stress":
                part.vec.FV().NumPy()[:] = 0.1 * (kind + 1)  # constant on every facet
            else:
                part.Set(value)

    @staticmethod
    def _wave(i: int, j: int, kind: int) -> CF:
        phase = i + kind
        return 0.02 * (j + 1 + kind) * sin((1 + 0.1 * j) * 2 * pi * x + phase) * cos(2 * pi * y + 0.3 * i + z)

    def _projected(self, name: str, space: FESpace, value: CF):
        trial, test = space.TnT()
        if name.startswith("a_"):
            n = specialcf.normal(self.dim)
            trial, test, value = trial * n, test * n, CF((0.3 + x, value[0], z)[: self.dim]) * n
        if name not in self.solvers:
            mass = BilinearForm(space)
            mass += InnerProduct(trial, test) * dx(element_boundary=True)
            diagonal = Preconditioner(mass, "local")
            mass.Assemble()
            self.solvers[name] = mass, CGSolver(mass.mat, diagonal.mat, tol=1e-13, maxiter=60), diagonal
        load = LinearForm(InnerProduct(value, test) * dx(element_boundary=True)).Assemble()
        return self.solvers[name][1] * load.vec


def block_products(rows, w: GridFunction, names) -> dict[str, float]:
    """<rows, w> block by block."""
    result = {}
    for i, name in enumerate(names):
        part = GridFunction(w.space)
        part.components[i].vec.data = w.components[i].vec
        result[name] = float(InnerProduct(rows, part.vec))
    return result


def values(name: str) -> dict[str, dict[str, float]]:
    walls = {"top": nv.Traction(f=(1.0, 0.5, 0.0), friction=0.2)} if name == "a cube" else None
    step = Step(mesh_of(name), model(3 if name == "a cube" else 2), conditions=walls)
    fill, state = Functions(step), step.state
    w, d = (GridFunction(step.layout.space) for _ in range(2))
    for kind, target in enumerate((state, step.state_old, w, d)):
        fill(target, kind)
    step.start_from_old()
    step.context.tau.Set(0.02)
    rows = state.vec.CreateVector()
    step.residual.Apply(state.vec, rows)
    result = {"residual": block_products(rows, w, step.layout.names)}

    jacobian = BilinearForm(step.layout.space)
    u, t = (step.layout.fields(each) for each in step.layout.space.TnT())
    for term in step.terms:
        step.quadrature.add(jacobian, term.form(u, t))
    jacobian.AssembleLinearization(state.vec)
    rows.data = jacobian.mat * d.vec
    result["jacobian"] = block_products(rows, w, step.layout.names)

    result["ledger"] = {}
    for entry in step.entries():
        cells, facets = entry.integrand.cells, entry.integrand.facets
        total = 0.0 if cells is None else step.quadrature.integrate_cells(cells)
        total += 0.0 if facets is None else step.quadrature.integrate_facets(facets)
        result["ledger"][entry.name] = float(total)

    passive = PassiveFields(step, ("F_tot", "reference_map"))
    passive.begin()
    passive.stage(np.array([1.0]))
    passive.end(np.array([0.0, 1.0]))
    result["passive"] = {
        key: float(Integrate(InnerProduct(field, field), step.mesh, order=6))
        for key, field in passive.fields.items()
    }
    return result


if __name__ == "__main__":
    faulthandler.dump_traceback_later(100, exit=True)
    found = {name: values(name) for name in sys.argv[1:]}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))

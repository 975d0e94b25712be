"""Measures one row of the benchmark, and prints it as JSON."""

import json
import resource
import sys
import time
from typing import Any

from ngsolve import CF, Mesh, SetNumThreads, TaskManager, cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.algebra.factorised import DirectSolver
from ngvisco.geometries import box, structured_box
from ngvisco.reduced.residual import ReducedResidual

DIRECT_UP_TO = 5_000
"""Number of cells up to which the split solver's whole tangent is also factorised, for comparison."""


FIFTY_THOUSAND = 0.0405
"""Size of cells in the largest mesh, see ``domain``."""


STRUCTURED = {1 / n: n for n in (4, 13, 17)}
"""Number of cubes of six tetrahedra along an edge of the box, by the size of a cube."""


def domain(dim: int, maxh: float) -> Mesh:
    """The unit box, structured for sizes in ``STRUCTURED``.

    Netgen's boxes jump from 45 to 95 thousand cells. The mesh of 50,552 cells is that of a box that is taller
    by a hundredth: it is meshed with cells of twice the size and refined.
    """
    if dim == 3 and maxh in STRUCTURED:
        return structured_box((1, 1, 1), (STRUCTURED[maxh],) * 3)
    if (dim, maxh) != (3, FIFTY_THOUSAND):
        return box((1,) * dim, maxh=maxh)
    mesh = box((1, 1, 1.01), maxh=2 * maxh)
    mesh.Refine()
    return mesh


def bodies(which: str, dim: int) -> list[nv.Body]:
    """A body with a ball of another stiffness in its middle, or one body that transports its stiffness."""

    def body(name: str, G_e: float | nv.Parameter, **place: Any) -> nv.Body:
        material = nv.ReferentialNeoHookean(K_e=10.0, G_e=G_e)
        viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
        return nv.Body(name=name, material=material, viscosity=viscosity, density=1.0, **place)

    if which == "one body":
        return [body("whole", nv.Parameter("stiffness", start=5.0))]
    return [body("ball", 5.0, where=nv.Ball((0.5,) * dim, 0.3)), body("rest", 2.0)]


def swirl_on(mesh: Mesh, newton: nv.NewtonOptions) -> nv.Simulation:
    """The swirl without creep, with the split solver, in a box that may be distributed."""
    return _swirl(mesh, "", solver="split", dt=0.02, newton=newton)


def swirl(
    dim: int, maxh: float, method: str, creeping: str = "", dt: float = 0.02, scheme: str = "backward-euler"
) -> nv.Simulation:
    """The benchmark's swirl.

    ``creeping`` is "F" or "B" for creep with the elastic state by F or by B, and "" for no creep.  "one body"
    and "two bodies" have the same number of unknowns: one body has a parameter, two bodies have a second
    amount.
    """
    return _swirl(domain(dim, maxh), creeping, solver=method, dt=dt, scheme=scheme)


def _swirl(mesh: Mesh, creeping: str, **options: Any) -> nv.Simulation:
    dim = mesh.dim
    is_of_bodies, state = creeping.endswith(("body", "bodies")), "B" if creeping == "B" else "F"
    what = {
        "material": nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state=state),
        "creep": nv.Creep(G_m=5.0) if creeping else None,
        "viscosity": nv.StokesViscosity(K_v=0.01, G_v=0.01),
    }
    model = nv.Model(
        **({"bodies": bodies(creeping, dim)} if is_of_bodies else what),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=[nv.Gravity((0.0,) * (dim - 1) + (-1.0,))],
    )
    height = (1 + z) / 2 if dim == 3 else CF(1.0)
    velocity = (height * sin(pi * x) * cos(pi * y), -height * cos(pi * x) * sin(pi * y), CF(0.0))[:dim]
    initial = nv.Initial(velocity=velocity)
    return nv.Simulation(mesh, model, initial=initial, **options)


def main(dim: int, maxh: float, method: str, threads: int, steps: int, creeping: str = "") -> dict:
    SetNumThreads(threads)
    began = time.perf_counter()
    run = swirl(dim, maxh, method, creeping)
    row = {
        "creeping": creeping,
        "dim": dim,
        "maxh": maxh,
        "structured": dim == 3 and maxh in STRUCTURED,
        "method": method,
        "threads": threads,
        "cells": run.mesh.ne,
    }
    row["set-up"] = time.perf_counter() - began
    newton = run.solver.newton
    row["unknowns"] = run.rothe_step.layout.space.ndof
    began = time.perf_counter()
    run.advance()
    row["first"] = time.perf_counter() - began
    parts = timed_parts(newton) if method == "split" else {}
    began, iterations = time.perf_counter(), 0
    for _ in range(steps):
        last = run.advance()
        iterations += int(last["newton_iterations"])
    row["step"] = (time.perf_counter() - began) / steps
    row["iterations"] = iterations / steps
    row["closure"] = abs(last["closure_relative"])
    if method == "split":
        row["parts"] = {name: seconds / steps for name, seconds in parts.items()}
    row["floor"] = floor(run, method)
    if method == "split" and run.mesh.ne <= DIRECT_UP_TO:
        row["direct"] = direct_floor(run)
    row["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return row


def timed_parts(split: Any) -> dict[str, float]:
    """Seconds by parts of the split solver's work from now on; the dictionary grows with the run."""
    seconds = dict.fromkeys(("residuals", "assembly", "factorisation", "solves"), 0.0)
    preconditioner = split.preconditioner

    def timed(name: str, work: Any) -> Any:
        def measured(*arguments: Any, **words: Any) -> Any:
            began = time.perf_counter()
            try:
                return work(*arguments, **words)
            finally:
                seconds[name] += time.perf_counter() - began

        return measured

    class Timed(ReducedResidual):
        __call__ = timed("residuals", ReducedResidual.__call__)

    split.residual.__class__ = Timed
    split.solved = timed("solves", split.solved)
    preconditioner.linearise = timed("assembly", preconditioner.linearise)
    preconditioner.operator.tangent = timed("assembly", preconditioner.operator.tangent)
    preconditioner.solver.factorise = timed("factorisation", preconditioner.solver.factorise)
    return seconds


def floor(run: nv.Simulation, method: str) -> float:
    """Time of one assembly and factorisation of the tangent, and one solve, which every implicit step
    needs."""
    step, newton = run.rothe_step, run.solver.newton
    with TaskManager():
        if method == "coupled":
            increment, rows = step.state.vec.CreateVector(), step.state.vec.CreateVector()
            step.residual.Apply(step.state.vec, rows)
            newton.reset()
            began = time.perf_counter()
            newton.jacobian.factorise(step.state.vec)
            newton.jacobian.solve(rows, increment)
            return time.perf_counter() - began
        newton.residual.start()
        at = newton.residual(newton.unknowns.pack())
        began = time.perf_counter()
        newton.preconditioner.update(at)
        newton.preconditioner._block(at.residual[: newton.preconditioner._size])
        return time.perf_counter() - began


def direct_floor(run: nv.Simulation) -> float:
    """Time of a factorisation of the whole velocity tangent, if the solver takes two levels."""
    newton = run.solver.newton
    preconditioner = newton.preconditioner
    solver = DirectSolver(preconditioner.free, symmetric=True)
    with TaskManager():
        at = newton.residual(newton.unknowns.pack())
        began = time.perf_counter()
        preconditioner.operator.update(at)
        solver.factorise(preconditioner.operator.tangent(at, preconditioner.hyper_tangent))
        solver(at.residual[: preconditioner.operator.size])
        return time.perf_counter() - began


if __name__ == "__main__":
    values = sys.argv[1:]
    result = main(int(values[0]), float(values[1]), values[2], int(values[3]), int(values[4]), *values[5:])
    print(json.dumps(result))

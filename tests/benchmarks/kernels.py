"""The cost of kernels that are written by hand: ``python -m tests.benchmarks.kernels`` in the project's root.

Each kernel is timed by turns with the general way to the same numbers, a complex increment of the terms, in
processor time. A kernel that is no longer several times as fast is to go.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from ngsolve import CF, SetNumThreads, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.arrays import TINY
from ngvisco.reduced.facet_tangent import FacetTangent

MESHES = ((2, 0.12), (3, 0.4))
"""Dimension and size of cells of each row."""
HEAD = ("kernel", "dim", "cells", "by hand, ms", "by increments, ms", "ratio")
TURNS = 5


def swirl(dim: int, maxh: float) -> nv.Simulation:
    """A swirl with hyperviscosity in the split solver, after its first step."""
    along = (sin(pi * x) ** 2 * sin(2 * pi * y), -sin(2 * pi * x) * sin(pi * y) ** 2, CF(0.0))
    model = nv.Model(
        material=nv.ReferentialNeoHookean(K_e=10.0, G_e=5.0),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-3, p=4.0),
    )
    initial = nv.Initial(density=1.0, velocity=along[:dim])
    run = nv.Simulation(box((1,) * dim, maxh=maxh), model, dt=0.02, solver="split", initial=initial)
    run.advance()
    return run


def kernels(run: nv.Simulation) -> dict[str, tuple[Callable[[], object], Callable[[], object]]]:
    """The kernels by name, each with the general way to the same numbers, at the run's present state."""
    split = run.solver.newton
    residual, preconditioner = split.residual, split.preconditioner
    at = residual(split.unknowns.pack())
    c, rng = at.coefficients, np.random.default_rng(1)
    dv, da = rng.standard_normal(c["v"].shape), rng.standard_normal(c["a"].shape)
    derivative, sweep = preconditioner.operator.derivative, preconditioner.sweep
    along, h = np.concatenate([dv, da], axis=1), TINY * 1j
    moving = [term for term in run.rothe_step.point_terms if term.impulse in ("Kinematics", "Upwinding")]
    size = len(at.cells.z.value)
    tangent = FacetTangent(residual, moving, range(size), sweep.coupling)
    return {
        "hyperviscosity": (
            lambda: derivative(along),
            lambda: residual.hyper(c["v"] + h * dv, c["a"] + h * da, c["z"]).rows.imag / TINY,
        ),
        "transport": (lambda: sweep.update(at), lambda: tangent(at)),
    }


def rows(meshes: Sequence[tuple[int, float]] = MESHES, turns: int = TURNS) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield "| " + " | ".join(HEAD) + " |"
    yield "|" + "---|" * len(HEAD)
    for dim, maxh in meshes:
        run = swirl(dim, maxh)
        for name, ways in kernels(run).items():
            seconds = [[], []]
            for _ in range(turns):
                for way, taken in zip(ways, seconds, strict=True):
                    begin = time.process_time()
                    way()
                    taken.append(time.process_time() - begin)
            hand, general = (1e3 * min(taken) for taken in seconds)
            yield f"| {name} | {dim} | {run.mesh.ne} | {hand:.1f} | {general:.1f} | {general / hand:.1f} |"


if __name__ == "__main__":
    SetNumThreads(1)
    for line in rows():
        print(line)
        sys.stdout.flush()

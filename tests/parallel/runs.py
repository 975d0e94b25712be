"""Runs of small cases by one process or several; the first rank prints their ledgers as JSON.

Run by ``test_runs``.  Everything is as in a script for one process: ``Simulation`` distributes the mesh.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from ngsolve import cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.parallel.communicator import TRAFFIC, Communicator
from ngvisco.reduced.residual import Evaluation
from ngvisco.solver.options import SplitOptions, TwoLevelOptions
from ngvisco.solver.split.preconditioner import Preconditioner

SWIRL = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
NEO_HOOKEAN = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
VISCOSITY = nv.StokesViscosity(K_v=0.05, G_v=0.05)
TWO_LEVELS = nv.NewtonOptions(split=SplitOptions(direct_up_to=(100, 100)))
KRYLOV = nv.NewtonOptions(split=SplitOptions(slow=4))
GAMG, HYPRE = (
    nv.NewtonOptions(split=SplitOptions(direct_up_to=(100, 100), two_level=TwoLevelOptions(coarse=coarse)))
    for coarse in ("gamg", "hypre")
)
REGULARISED = nv.Regularisation(delta_density=1e-3, delta_fields=1e-2, epsilon=0.1, rho_max=1.0)


def gravity(dim: int) -> nv.Gravity:
    return nv.Gravity((0.0,) * (dim - 1) + (-1.0,))


def swirl(maxh: float, **options) -> nv.Simulation:
    model = nv.Model(
        material=NEO_HOOKEAN,
        viscosity=VISCOSITY,
        hyperviscosity=nv.HyperViscosity(mu=1e-4, p=4),
        loads=[gravity(2)],
    )
    options = {"dt": 0.02, "initial": nv.Initial(velocity=SWIRL), "solver": "coupled"} | options
    return nv.Simulation(box((1, 1), maxh=maxh), model, **options)


def block(solver: str = "coupled", maxh: float = 0.9, **options) -> nv.Simulation:
    hyper = None if solver == "coupled" else nv.HyperViscosity(mu=1e-4, p=4)
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY, hyperviscosity=hyper, loads=[gravity(3)])
    initial = nv.Initial(velocity=(*SWIRL, 0.0))
    mesh = box((1, 1, 1), maxh=maxh)
    return nv.Simulation(mesh, model, dt=0.02, initial=initial, solver=solver, **options)


def lid(solver: str = "coupled") -> nv.Simulation:
    walls = {
        "top": nv.PrescribedTangential((x * (1 - x), 0.0)),
        "bottom": nv.NoSlip(),
        "left": nv.NavierFriction(0.3),
    }
    model = nv.Model(material=NEO_HOOKEAN, viscosity=VISCOSITY)
    mesh = box((1, 1), maxh=0.3)
    return nv.Simulation(mesh, model, dt=0.05, walls=walls, scheme="midpoint", solver=solver)


def creep(solver: str = "coupled", regularisation: nv.Regularisation | None = REGULARISED) -> nv.Simulation:
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1, elastic_state="F"),
        viscosity=VISCOSITY,
        creep=nv.Creep(G_m=2.0, nu=1e-3, q=4),
        regularisation=regularisation,
    )
    initial = nv.Initial(velocity=SWIRL)
    return nv.Simulation(box((1, 1), maxh=0.5), model, dt=0.02, initial=initial, solver=solver)


def limited() -> nv.Simulation:
    """A body under a lid of full speed, near whose corners cells are limited in the ninth step."""
    model = nv.Model(
        material=nv.NeoHookean(K_e=20.0, G_e=0.05, epsilon=0.1),
        viscosity=nv.StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
    )
    walls = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    mesh = box((1, 1), maxh=0.25)
    return nv.Simulation(mesh, model, dt=0.05, walls=walls, scheme="midpoint", solver="coupled")


CASES = {
    "swirl": lambda: swirl(0.3),
    "midpoint": lambda: swirl(0.3, scheme="midpoint"),
    "sdirk2": lambda: swirl(0.4, scheme="sdirk2"),
    "adaptive": lambda: swirl(0.4, stepping=nv.AdaptiveSteps(dt_min=1e-4, dt_max=0.1, tolerance=1e-2)),
    "block": block,
    "lid": lid,
    "creep": creep,
    "limited": limited,
    "split": lambda: swirl(0.3, scheme="midpoint", solver="split"),
    "split, two levels": lambda: swirl(0.2, newton=TWO_LEVELS, solver="split"),
    "split, Newton-Krylov": lambda: swirl(0.4, newton=KRYLOV, solver="split"),
    "split, long steps": lambda: swirl(0.25, dt=0.15, solver="split"),
    "split block": lambda: block("split"),
    "split block, two levels": lambda: block("split", 0.5, newton=TWO_LEVELS),
    "split block, gamg": lambda: block("split", 0.5, newton=GAMG),
    "split block, hypre": lambda: block("split", 0.5, newton=HYPRE),
    "split lid": lambda: lid("split"),
    "split creep": lambda: creep("split", nv.Regularisation(epsilon=0.1)),
}
STEPS = {"limited": 9}
"""Where there are more than three."""

LINEAR: list[int] = []
"""Iterations of the split solver's linear systems of the flow."""


def counted(self: Preconditioner, at: Evaluation, tolerance: float) -> np.ndarray:
    increment = solved(self, at, tolerance)
    LINEAR.append(self.iterations)
    return increment


solved, Preconditioner.__call__ = Preconditioner.__call__, counted

if __name__ == "__main__":
    found = {}
    for name in sys.argv[1:]:
        before = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        LINEAR.clear()
        run = CASES[name]()
        for _ in range(STEPS.get(name, 3)):
            run.advance()
        rows = [{key: float(value) for key, value in row.items()} for row in run.ledger.rows]
        found[name] = {"cells": run.cells, "unknowns": run.unknowns, "rows": rows, "linear": sum(LINEAR)}
        after = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        found[name]["traffic"] = [b - a for a, b in zip(before, after, strict=True)]
    if Communicator.world().is_first:
        print(json.dumps(found))

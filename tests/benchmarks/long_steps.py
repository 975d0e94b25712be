"""Long steps: ``python -m tests.benchmarks.long_steps [NAME ...]`` in the project's root.

The runs are a grid of stiffness, K_e/G_e, viscosity and step. A row has the steps that were solved and the
steps that were divided, iterations, limited cells, the Courant numbers v dt/h and c dt/h, the ratio of the
slowest step to the median in processor time, and the reason of an early end. NAMEs are beginnings of names
like "2D, linearised" and "3D, finite". Cavities, recoils, impacts and released loads are in ``hard_starts``.
"""

import os
import sys
import time
from collections.abc import Iterator
from functools import cache
from itertools import product

os.environ.setdefault("NGS_NUM_THREADS", "1")  # further threads wait actively, which processor time counts
os.environ.setdefault("NGVISCO_THREADS", "1")

import numpy as np
from ngsolve import CF, Mesh, cos, pi, sin, x, y, z

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.run.advice import scales
from tests.verification.cases import robustness
from tests.verification.setups import KINDS, block, elastic

LARGEST_ELASTIC = 100.0
"""Largest Courant number c dt/h of longitudinal waves; points of the grid with larger Courant numbers are
left out."""
TAUS = {2: (0.014, 0.14, 0.4, 1.0), 3: (0.03, 0.3, 1.0, 3.0)}
"""Steps, s, by dimension. The Courant numbers of the flow are up to 10; those of waves are as close to 100 as
the stiffnesses allow."""
STEPS = 8
DRIFT_IN_SPACE = (
    1 + 0.5 * sin(2 * pi * x) * cos(2 * pi * y) * cos(2 * pi * z),
    0.5 - 0.5 * cos(2 * pi * x) * sin(2 * pi * y) * cos(2 * pi * z),
    CF(0.25),
)
COLUMNS = (
    *("run", "steps", "in parts", "iterations: median", "most", "limited cells"),
    *("v dt/h", "c dt/h", "dearest/median", "closure", "why it ended"),
)
Point = tuple[float, float, float, float]
"""Stiffness, Pa, K_e/G_e, viscosity, Pa s, and dt, s."""


@cache
def periodic_mesh(dim: int) -> Mesh:
    """The unit box, periodic: 98 triangles, 162 tetrahedra."""
    if dim == 2:
        return box((1, 1), 0.15, periodic="xy")
    return structured_box((1, 1, 1), (3, 3, 3), periodic="xyz")


def points(dim: int) -> Iterator[Point]:
    """Points of the grid of ``robustness`` up to ``LARGEST_ELASTIC``."""
    cell = scales(block("linearised", 1.0, mesh=periodic_mesh(dim))).cell
    viscosities = robustness.VISCOSITIES if dim == 2 else (0.1,)
    for point in product(robustness.STIFFNESS, robustness.RATIOS, viscosities, TAUS[dim]):
        stiffness, ratio, _, tau = point
        if float(np.sqrt(stiffness * (ratio + 4 / 3))) * tau / cell <= LARGEST_ELASTIC:  # rho is 1 kg/m^3
            yield point


def drifting(kind: str, dim: int, point: Point) -> nv.Simulation:
    """The block of ``robustness`` at a point of its grid, carried by a mean flow, by the split solver."""
    stiffness, ratio, viscosity, tau = point
    drift = robustness.DRIFT if dim == 2 else DRIFT_IN_SPACE
    return block(
        kind,
        tau,
        mesh=periodic_mesh(dim),
        of=elastic(kind, ratio * stiffness, stiffness),
        viscosity=viscosity,
        initial=nv.Initial(density=1 + 0.2 * cos(2 * pi * x), velocity=drift),
        solver="split",
    )


def row(run: nv.Simulation, steps: int = STEPS) -> list[object]:
    """Make steps of dt, divided if necessary, and return their costs by ``COLUMNS`` without the first."""
    elastic_courant = scales(run).numbers["Courant of longitudinal waves, c dt/h"]
    seconds, solved, parts, failure = [], 0, 0, ""
    for number in range(1, steps + 1):
        rows, began = max(len(run.ledger.rows), 1), time.process_time()
        try:
            run.run(number * run.dt)
        except nv.StepError as error:
            failure = f"step {number}: {str(error.__cause__ or error)[-200:]}"
        seconds.append(time.process_time() - began)
        if failure:
            break
        solved += 1
        parts += len(run.ledger.rows) > rows + 1
    column = run.ledger.column if len(run.ledger.rows) > 1 else lambda name: np.zeros(2)
    iterations, dearest = column("newton_iterations")[1:], max(seconds) / float(np.median(seconds))
    found = [f"{solved} of {steps}", parts, f"{np.median(iterations):g}", f"{iterations.max():g}"]
    found += [f"{column('limited_cells')[1:].sum():g}", f"{column('cfl').max():.2g}"]
    closure = float(np.abs(column("closure_relative")).max())
    return [*found, f"{elastic_courant:.2g}", f"{dearest:.1f}", f"{closure:.0e}", failure]


def main(names: list[str]) -> None:
    """Print the table, each row when it is complete."""
    print("| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS), sep="\n")
    for kind, dim in product(KINDS, (2, 3)):
        family = f"{dim}D, {kind}"
        if names and not family.startswith(tuple(names)):
            continue
        for point in points(dim):
            name = family + ": G = {:g}, K/G = {:g}, viscosity {:g}, dt = {:g}".format(*point)
            print("| " + " | ".join([name, *map(str, row(drifting(kind, dim, point)))]) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

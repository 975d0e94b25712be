"""Runs that were hard to solve: ``python -m tests.benchmarks.hard_starts [NAME ...]`` in the project's root.

A row for each: iterations of the first step, their median and most, steps taken in parts, steps that the
coupled solver was asked for, limited cells, and the dearest step over the median, of processor time.  The
table of ``ngvisco/timestepping/README.md`` is made of these.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from ngsolve import Mesh

from ngvisco.errors import StepError
from ngvisco.geometries import box
from ngvisco.run.simulation import Simulation
from ngvisco.solver.options import NewtonOptions
from ngvisco.verification.cases import long_steps

COLUMNS = (
    *("run", "cells", "steps", "iterations: first", "median", "most"),
    *("in parts", "retries", "limited", "dearest"),
)


def _cavity(p: float, maxh: float, options: NewtonOptions) -> Simulation:
    """The cavity of ``long_steps`` on a mesh of this size."""
    return long_steps.cavity(p, 2, None, 0.02, options, mesh=box((1, 1), maxh))


RUNS: dict[str, tuple[Callable[[NewtonOptions], Simulation], int]] = {
    "impulsive cavity, p = 4": (partial(_cavity, 4.0, 0.1), 20),
    "impulsive cavity, p = 2": (partial(_cavity, 2.0, 0.1), 20),
    "impulsive cavity, p = 4, fine": (partial(_cavity, 4.0, 0.05), 2),
    "impulsive cavity, p = 2, fine": (partial(_cavity, 2.0, 0.05), 2),
    "shear wave, 10 % strain": (partial(long_steps.shear_wave, 0.01), 100),
    "impact at a fifth of the speed of sound": (partial(long_steps.impact, "backward-euler"), 100),
    "released load, p = 2": (partial(long_steps.released, 2.0, 0.02), 20),
    "released load, p = 4": (partial(long_steps.released, 4.0, 0.02), 20),
}


def row(name: str) -> list[str]:
    """What the run of this name takes."""
    make, steps = RUNS[name]
    run = make(NewtonOptions(method="split"))
    mesh: Mesh = run.mesh
    seconds, iterations, parts = [], [], 0
    for number in range(1, steps + 1):
        rows, began = max(len(run.ledger.rows), 1), time.process_time()
        try:
            run.run(number * run.dt)
        except StepError:
            break
        seconds.append(time.process_time() - began)
        own = run.ledger.column("newton_iterations")[rows:]
        iterations.append(int(own.sum()))
        parts += len(own) > 1
    limited = int(run.ledger.column("limited_cells")[1:].sum())
    dearest = max(seconds) / float(np.median(seconds))
    numbers = [mesh.ne, len(seconds), iterations[0], f"{np.median(iterations):g}", max(iterations)]
    return [name, *map(str, [*numbers, parts, run.solver.retried, limited]), f"{dearest:.1f}"]


def main(names: Sequence[str]) -> None:
    """Print the table, a row as soon as it is known."""
    print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    for name in names or RUNS:
        print("| " + " | ".join(row(name)) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

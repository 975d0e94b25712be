"""Time to a given error, by time schemes: prints rows as JSON.

The kinetic energy of the swirl at a given time, against its value converged in time on the same mesh.  A row
is a run whose error is within a tolerance, with as few steps as that takes.  All runs are of one process with
one thread, and times are the processor's, which other processes disturb less than the clock's.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Sequence

from ngsolve import SetNumThreads

from ngvisco.timestepping.scheme import scheme_of
from tests.benchmarks.case import swirl

COMPARED = ("backward-euler", "midpoint", "sdirk2")
FIRST = 4
"""Steps of the first run of each scheme."""

NEAR = 0.9
"""Share of the error asked for above which a run has few steps more than needed."""


def run(scheme: str, steps: int, maxh: float, until: float) -> dict:
    """One run to ``until``, s: seconds (set-up left out), solver iterations, and what it ends with, J."""
    simulation = swirl(2, maxh, "split", dt=until / steps, scheme=scheme)
    began = time.process_time()
    ledger = simulation.run(until)
    seconds = time.process_time() - began
    return {
        "scheme": scheme,
        "steps": steps,
        "dt": until / steps,
        "seconds": seconds,
        "iterations": int(ledger.column("newton_iterations").sum()),
        "kinetic": float(ledger.column("kinetic")[-1]),
        "numerical": float((ledger.column("inertial") + ledger.column("bregman")).sum()),
        "closure": float(abs(ledger.column("closure_relative")).max()),
    }


def extrapolated(coarse: float, fine: float, order: int) -> float:
    """The limit for short steps, from a run and one of twice as many steps (Richardson)."""
    return fine + (fine - coarse) / (2**order - 1)


def within(
    tolerances: Sequence[float], measure: Callable[[int], dict], exact: float, order: int, first: int = FIRST
) -> list[dict]:
    """A row for each relative error, the largest first: a run within it, with few steps more than needed.

    The number of steps follows the scheme's order from runs that are too coarse; between such a one and one
    that is much finer than needed it is interpolated.
    """
    rows: dict[int, dict] = {}
    chosen = []
    for tolerance in sorted(tolerances, reverse=True):
        steps = max(rows, default=first)
        while True:
            if steps not in rows:
                row = measure(steps)
                rows[steps] = row | {"error": abs(row["kinetic"] / exact - 1)}
            fine = min((n for n in rows if rows[n]["error"] <= tolerance), default=None)
            coarse = max(
                (n for n in rows if rows[n]["error"] > tolerance and n < (fine or math.inf)), default=0
            )
            if fine is None:
                growth = (rows[coarse]["error"] / tolerance) ** (1 / order)
                steps = max(coarse + 1, math.ceil(coarse * growth))
            elif fine == coarse + 1 or rows[fine]["error"] >= NEAR * tolerance:
                break
            elif coarse == 0:
                steps = fine // 2
            else:
                ends = [math.log(rows[n]["error"] / tolerance) for n in (coarse, fine)]
                between = coarse * (fine / coarse) ** (ends[0] / (ends[0] - ends[1]))
                steps = min(max(coarse + 1, math.ceil(between)), fine - 1)
        chosen.append(rows[fine] | {"tolerance": tolerance})
    return chosen


def main(maxh: float, until: float, finest: int, tolerances: Sequence[float]) -> list[dict]:
    """Rows of all schemes; the converged value is extrapolated from the midpoint rule's finest runs."""
    SetNumThreads(1)
    run("midpoint", 1, maxh, until / finest)  # what is loaded and compiled once
    coarse, fine = (run("midpoint", steps, maxh, until)["kinetic"] for steps in (finest // 2, finest))
    exact = extrapolated(coarse, fine, order=2)
    rows = []
    for scheme in COMPARED:

        def measure(steps: int, scheme: str = scheme) -> dict:
            return run(scheme, steps, maxh, until)

        rows += within(tolerances, measure, exact, scheme_of(scheme).order)
    return [row | {"maxh": maxh, "exact": exact} for row in rows]


if __name__ == "__main__":
    values = sys.argv[1:]
    result = main(float(values[0]), float(values[1]), int(values[2]), [float(v) for v in values[3:]])
    print(json.dumps(result))

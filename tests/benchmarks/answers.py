"""Error over seconds by order, cells, step and scheme: ``python -m tests.benchmarks.answers [PROBLEM ...]``.

The kinetic energy at the end of a run against that of a finer one, with steps of half the length by the
midpoint rule and velocities of degree 3.  Seconds are the processor's, of one thread, set-up left out; only
their ratios within one call travel.  Of each problem's runs those are marked that no cheaper one beats.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from itertools import product

from ngsolve import CF, SetNumThreads, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.benchmarks.table import add_files, against, read, write

SCHEMES = ("backward-euler", "midpoint")
ORDERS = ((2, 1), (3, 2))
CELLS = (3, 6)
STEPS = (5, 20)
REFERENCE = ((3, 2), 9, 40, "midpoint")
UNTIL = 0.2
"""s."""

SOLID = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
VISCOSITY = nv.StokesViscosity(K_v=0.01, G_v=0.01)


def swirl(cells: int, **options: object) -> nv.Simulation:
    """The swirl of ``case`` in a box with walls."""
    hyper = nv.HyperViscosity(mu=1e-5, p=4)
    model = nv.Model(material=SOLID, viscosity=VISCOSITY, hyperviscosity=hyper)
    velocity = (sin(pi * x) * cos(pi * y), -cos(pi * x) * sin(pi * y))
    mesh = structured_box((1, 1), (cells, cells))
    return nv.Simulation(mesh, model, initial=nv.Initial(velocity=velocity), **options)  # type: ignore[arg-type]


def shear_wave(cells: int, **options: object) -> nv.Simulation:
    """A standing wave of 10 % strain in a periodic cell."""
    model = nv.Model(material=SOLID, viscosity=VISCOSITY)
    initial = nv.Initial(velocity=CF((0.0, 0.1 * 5**0.5 * cos(2 * pi * x))))
    mesh = structured_box((1, 1), (cells, cells), periodic="xy")
    return nv.Simulation(mesh, model, initial=initial, **options)  # type: ignore[arg-type]


PROBLEMS: dict[str, Callable[..., nv.Simulation]] = {"swirl": swirl, "shear wave": shear_wave}


def measured(name: str, order: tuple[int, int], cells: int, steps: int, scheme: str) -> tuple[float, float]:
    """The kinetic energy at the end, J, and seconds."""
    k, m = order
    discretisation = nv.Discretisation(k=k, m=m)
    run = PROBLEMS[name](cells, dt=UNTIL / steps, scheme=scheme, discretisation=discretisation)
    began = time.process_time()
    ledger = run.run(UNTIL)
    return float(ledger.column("kinetic")[-1]), time.process_time() - began


def rows_of(name: str) -> list[dict]:
    """A problem's runs, the cheapest first; "best" where no cheaper one has a smaller error."""
    exact, _ = measured(name, *REFERENCE)
    rows = []
    for (k, m), cells, steps, scheme in product(ORDERS, CELLS, STEPS, SCHEMES):
        kinetic, seconds = measured(name, (k, m), cells, steps, scheme)
        choice = {"problem": name, "scheme": scheme, "k": k, "m": m, "cells": 2 * cells**2}
        row = {"dt": UNTIL / steps, "error": abs(kinetic / exact - 1), "seconds": seconds, "exact": exact}
        rows.append(choice | row)
    rows.sort(key=lambda row: row["seconds"])
    least = float("inf")
    for row in rows:
        row["best"] = row["error"] < least
        least = min(least, row["error"])
    return rows


def markdown(rows: list[dict]) -> str:
    """A Markdown table of one problem's rows."""
    lines = [f"| {rows[0]['problem']} | k, m | cells | dt, s | error | time, s | best |", "|" + "---|" * 7]
    for row in rows:
        values = f"{row['k']}, {row['m']} | {row['cells']} | {row['dt']:g} | {row['error']:.2%}"
        lines.append(f"| {row['scheme']} | {values} | {row['seconds']:.1f} | {'*' if row['best'] else ''} |")
    return "\n".join([*lines, "", f"Reference: {rows[0]['exact']:.6g} J.", ""])


def main(arguments: list[str] | None = None) -> int:
    """Print a table of each problem, and ratios to an older one."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.answers")
    parser.add_argument(
        "problems", nargs="*", metavar="PROBLEM", help=f"of {', '.join(PROBLEMS)}: default all"
    )
    add_files(parser)
    chosen = parser.parse_args(arguments)
    if unknown := sorted(set(chosen.problems) - set(PROBLEMS)):
        parser.error(f"no problem {unknown[0]!r}: there are {', '.join(PROBLEMS)}")
    older = read(chosen.against)
    SetNumThreads(1)
    rows, text = [], ""
    for name in chosen.problems or PROBLEMS:
        rows += (new := rows_of(name))
        text += f"{markdown(new)}\n"
        print(markdown(new), flush=True)
    compared = against(rows, older, ("problem", "scheme", "k", "m", "cells", "dt"), ("seconds", "error"))
    print(compared)
    write(chosen.output, "answers", rows, text + compared)
    return 0


if __name__ == "__main__":
    sys.exit(main())

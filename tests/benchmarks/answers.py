"""Error over seconds by order, cells, step and scheme: ``python -m tests.benchmarks.answers [PROBLEM ...]``.

The error is that of the kinetic energy at the end, against a finer run with the midpoint rule, half of the
smallest step and velocities of degree 3. For the soft disc it is the distance of the centroid, over the
length of its path, from the path by another method (``tests/verification/cases/soft_disc.py``). Seconds are
processor time of one thread without the set-up; only their ratios within one call are comparable. A table
marks a problem's runs for which no cheaper run has a smaller error.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from ngsolve import CF, SetNumThreads, cos, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box, structured_box
from ngvisco.physics.variables import Jacobian
from tests.benchmarks.table import add_files, against, read, write
from tests.verification.cases.soft_disc import PATH

SCHEMES = ("backward-euler", "midpoint")
REFERENCE = ((3, 2), 9, 40, "midpoint")
"""Orders, cells a side, number of steps and scheme of the finer run."""

SOLID = nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1)
VISCOSITY = nv.StokesViscosity(K_v=0.01, G_v=0.01)
CENTRE = np.array([0.6, 0.5])
"""The soft disc's centre at the start, m."""


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


def soft_disc(cells: int, **options: object) -> nv.Simulation:
    """The disc of Zhao, Freund and Moser in a lid-driven cavity; cells of 1 m/cells, halved at the lid."""
    fluid = nv.CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: 25 * (J + 1 / J - 2))
    solid = nv.IsochoricNeoHookean(K_e=50.0, G_e=0.05, elastic_state="B")
    both = {"viscosity": VISCOSITY, "density": 1.0}
    disc = nv.Body(name="disc", where=nv.Ball(tuple(CENTRE), 0.2), material=solid, **both)  # type: ignore[arg-type]
    rest = nv.Body(name="rest", material=fluid, **both)  # type: ignore[arg-type]
    walls = {"top": nv.PrescribedTangential((1.0, 0.0)), ("left", "right", "bottom"): nv.NoSlip()}
    mesh = box((1, 1), maxh=1 / cells, refine={"top": 0.5 / cells}, split_corners=True)
    return nv.Simulation(mesh, nv.Model(bodies=[rest, disc]), walls=walls, **options)  # type: ignore[arg-type]


def kinetic(run: nv.Simulation) -> np.ndarray:
    """The kinetic energy, J."""
    return np.array([run.ledger.rows[-1]["kinetic"]])


def displacement(run: nv.Simulation) -> np.ndarray:
    """Displacement of the disc's centroid, m."""
    amount = run.rothe_step.now.z_tensors["n_disc"]
    volume, *moments = run.rothe_step.quadrature.integrate_cells(CF((amount, amount * x, amount * y)))
    return np.array(moments) / volume - CENTRE


@dataclass(frozen=True)
class Problem:
    """A problem: how to make a run, and the numbers that are compared.

    Attributes
    ----------
    make : callable
        Makes a run with a number of cells a side.
    answer : callable
        Returns the numbers at the end of a run.
    until : float
        End of the run, s.
    orders, cells, steps : tuple
        The pairs k and m, the cells a side, and the numbers of steps.
    exact : array, optional
        The exact answer; the default is the answer of ``REFERENCE``.
    """

    make: Callable[..., nv.Simulation]
    answer: Callable[[nv.Simulation], np.ndarray] = kinetic
    until: float = 0.2
    orders: tuple[tuple[int, int], ...] = ((2, 1), (3, 2))
    cells: tuple[int, ...] = (3, 6)
    steps: tuple[int, ...] = (5, 20)
    exact: np.ndarray | None = None


PROBLEMS = {
    "swirl": Problem(swirl),
    "shear wave": Problem(shear_wave),
    "soft disc": Problem(
        soft_disc,
        displacement,
        until=2.0,
        orders=((2, 1), (3, 1)),
        cells=(6, 10),
        steps=(20, 40),
        exact=PATH[PATH[:, 0] == 2.0][0, 1:] - CENTRE,
    ),
}


def measured(
    name: str, order: tuple[int, int], cells: int, steps: int, scheme: str
) -> tuple[np.ndarray, float]:
    """The answer of a run, and its seconds."""
    problem, (k, m) = PROBLEMS[name], order
    discretisation = nv.Discretisation(k=k, m=m)
    run = problem.make(cells, dt=problem.until / steps, scheme=scheme, discretisation=discretisation)
    began = time.process_time()
    run.run(problem.until)
    return problem.answer(run), time.process_time() - began


def rows_of(name: str) -> list[dict]:
    """A problem's runs, the cheapest first; a run is "best" if no cheaper run has a smaller error."""
    problem = PROBLEMS[name]
    exact = measured(name, *REFERENCE)[0] if problem.exact is None else problem.exact
    size, rows = float(np.linalg.norm(exact)), []
    for (k, m), cells, steps, scheme in product(problem.orders, problem.cells, problem.steps, SCHEMES):
        answer, seconds = measured(name, (k, m), cells, steps, scheme)
        error = float(np.linalg.norm(answer - exact)) / size
        choice = {"problem": name, "scheme": scheme, "k": k, "m": m, "cells": cells}
        rows.append(choice | {"dt": problem.until / steps, "error": error, "seconds": seconds, "exact": size})
    rows.sort(key=lambda row: row["seconds"])
    least = float("inf")
    for row in rows:
        row["best"] = row["error"] < least
        least = min(least, row["error"])
    return rows


def markdown(rows: list[dict]) -> str:
    """A Markdown table of one problem's rows."""
    lines = [
        f"| {rows[0]['problem']} | k, m | cells a side | dt, s | error | time, s | best |",
        "|" + "---|" * 7,
    ]
    for row in rows:
        values = f"{row['k']}, {row['m']} | {row['cells']} | {row['dt']:g} | {row['error']:.2%}"
        lines.append(f"| {row['scheme']} | {values} | {row['seconds']:.1f} | {'*' if row['best'] else ''} |")
    return "\n".join([*lines, "", f"Size of the reference: {rows[0]['exact']:.6g}.", ""])


def main(arguments: list[str] | None = None) -> int:
    """Print a table for each problem, and ratios to an older table."""
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

"""The cost of a second branch: ``python -m tests.benchmarks.branches [--steps N] [--rounds N]`` in the
project's root.

Swirls of networks with one and with two creeping branches, on one mesh and with one solver, take steps in
turn, in several rounds of the same steps. Each step counts with its least processor time, which other work on
the machine affects least.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence

import numpy as np
from ngsolve import CF, SetNumThreads, pi, sin, x, y

import ngvisco as nv
from ngvisco.geometries import box

PROBLEMS = ((2, 0.1, "split"), (2, 0.25, "coupled"), (3, 0.35, "split"), (3, 0.7, "coupled"))
"""Dimension, size of cells and solver of each row."""
HEAD = ("dim", "cells", "solver", "one branch, s", "two, s", "ratio", "iterations", "of two")


def network(count: int) -> nv.Network:
    """A network of one or two creeping neo-Hookean branches; the first one has the volumetric energy."""
    moduli = ((10.0, 5.0, 5.0), (0.0, 2.0, 1.0))[:count]
    made = {
        f"mode_{i}": nv.Branch(material=nv.ReferentialNeoHookean(K_e=K_e, G_e=G_e), creep=nv.Creep(G_m=G_m))
        for i, (K_e, G_e, G_m) in enumerate(moduli, 1)
    }
    return nv.Network(branches=made)


def swirl(dim: int, maxh: float, solver: str, count: int) -> nv.Simulation:
    """The swirl of the unit box, after its first step."""
    along = (sin(pi * x) ** 2 * sin(2 * pi * y), -sin(2 * pi * x) * sin(pi * y) ** 2, CF(0.0))
    viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
    model = nv.Model(material=network(count), viscosity=viscosity)
    initial = nv.Initial(density=1.0, velocity=along[:dim])
    run = nv.Simulation(box((1,) * dim, maxh=maxh), model, dt=0.02, solver=solver, initial=initial)
    run.advance()
    return run


def measured(dim: int, maxh: float, solver: str, steps: int, rounds: int) -> tuple[object, ...]:
    """Measure a row of the table."""
    least, iterations = np.full((2, steps), np.inf), [0, 0]
    for _ in range(rounds):
        runs, iterations = [swirl(dim, maxh, solver, count) for count in (1, 2)], [0, 0]
        for step in range(steps):
            for i, run in enumerate(runs):
                begin = time.process_time()
                iterations[i] += int(run.advance()["newton_iterations"])
                least[i, step] = min(least[i, step], time.process_time() - begin)
    one, two = least.mean(axis=1)
    return dim, runs[0].mesh.ne, solver, f"{one:.3f}", f"{two:.3f}", f"{two / one:.2f}", *iterations


def rows(steps: int, rounds: int = 1, problems: Sequence[tuple[int, float, str]] = PROBLEMS) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield "| " + " | ".join(HEAD) + " |"
    yield "|" + "---|" * len(HEAD)
    for problem in problems:
        yield "| " + " | ".join(str(value) for value in measured(*problem, steps, rounds)) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=5, help="steps of each run after its first")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of these steps")
    options = parser.parse_args(arguments)
    SetNumThreads(1)
    for line in rows(options.steps, options.rounds):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

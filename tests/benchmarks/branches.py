"""The cost of a second branch: ``python -m tests.benchmarks.branches [--steps N] [--rounds N] [--before
CHECKOUT]`` in the project's root.

Swirls of networks with one and with two creeping branches, on one mesh and with one solver, take steps in
turn, in several rounds of the same steps. Each step counts with its least processor time, which other work on
the machine affects least. With ``--before CHECKOUT``, another clone, its code takes every step in turn with
this one, and has rows of its own. Each run is a separate process.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import CF, SetNumThreads, pi, sin, x, y

HERE = Path(__file__).resolve()
PROBLEMS = ((2, 0.1, "split"), (2, 0.25, "coupled"), (3, 0.35, "split"), (3, 0.7, "coupled"))
"""Dimension, size of cells and solver of each row."""
HEAD = ("dim", "cells", "solver", "code", "one branch, s", "two, s", "ratio", "iterations", "of two")


def network(nv: Any, count: int) -> Any:
    """A network of one or two creeping neo-Hookean branches; the first one has the volumetric energy."""
    moduli = ((10.0, 5.0, 5.0), (0.0, 2.0, 1.0))[:count]
    made = {
        f"mode_{i}": nv.Branch(material=nv.ReferentialNeoHookean(K_e=K_e, G_e=G_e), creep=nv.Creep(G_m=G_m))
        for i, (K_e, G_e, G_m) in enumerate(moduli, 1)
    }
    return nv.Network(branches=made)


def swirl(dim: int, maxh: float, solver: str, count: int) -> Any:
    """The swirl of the unit box, after its first step."""
    import ngvisco as nv
    from ngvisco.geometries import box

    along = (sin(pi * x) ** 2 * sin(2 * pi * y), -sin(2 * pi * x) * sin(pi * y) ** 2, CF(0.0))
    viscosity = nv.StokesViscosity(K_v=0.01, G_v=0.01)
    model = nv.Model(material=network(nv, count), viscosity=viscosity)
    initial = nv.Initial(density=1.0, velocity=along[:dim])
    run = nv.Simulation(box((1,) * dim, maxh=maxh), model, dt=0.02, solver=solver, initial=initial)
    run.advance()
    return run


def take_steps(dim: int, maxh: float, solver: str, count: int) -> None:
    """For each line of the standard input, start the run anew or take a step of the run, and print a line.

    A line has the number of cells, or the seconds of processor time and the iterations of the step.
    """
    SetNumThreads(1)
    output, sys.stdout = sys.stdout, sys.stderr
    run = swirl(dim, maxh, solver, count)
    for line in sys.stdin:
        if line.strip() == "start":
            run = swirl(dim, maxh, solver, count)
            print(run.mesh.ne, file=output, flush=True)
        else:
            begin = time.process_time()
            iterations = int(run.advance()["newton_iterations"])
            print(time.process_time() - begin, iterations, file=output, flush=True)


class Steps:
    """A process that takes the steps of one run, by the code of a clone."""

    def __init__(self, root: Path, *problem: object) -> None:
        paths = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
        self._process = subprocess.Popen(
            [sys.executable, str(HERE), "--take", *map(str, problem)],
            **{"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True},
            env=os.environ | {"PYTHONPATH": paths, "NGS_NUM_THREADS": "1"},
        )

    def ask(self, what: str) -> list[float]:
        """Send a line, and return the numbers of the answer."""
        assert self._process.stdin is not None and self._process.stdout is not None
        print(what, file=self._process.stdin, flush=True)
        return [float(number) for number in self._process.stdout.readline().split()]

    def end(self) -> None:
        """Close the input of the process, which ends it."""
        self._process.communicate()


def measured(
    dim: int, maxh: float, solver: str, steps: int, rounds: int, roots: Sequence[Path]
) -> Iterator[tuple[object, ...]]:
    """Measure a problem with the code of each clone in ``roots``; yield a row for each clone."""
    processes = [Steps(root, dim, maxh, solver, count) for root in roots for count in (1, 2)]
    least, iterations = np.full((len(processes), steps), np.inf), np.zeros((len(processes), steps))
    cells = 0.0
    for _ in range(rounds):
        for process in processes:
            (cells,) = process.ask("start")
        for step in range(steps):
            for i, process in enumerate(processes):
                seconds, iterations[i, step] = process.ask("step")
                least[i, step] = min(least[i, step], seconds)
    for process in processes:
        process.end()
    for k in range(len(roots)):
        (one, two), (of_one, of_two) = (a[2 * k : 2 * k + 2] for a in (least.mean(1), iterations.sum(1)))
        code = "here" if k == len(roots) - 1 else "before"
        ratio = f"{two / one:.2f}"
        yield dim, int(cells), solver, code, f"{one:.4f}", f"{two:.4f}", ratio, int(of_one), int(of_two)


def rows(
    steps: int,
    rounds: int = 1,
    problems: Sequence[tuple[int, float, str]] = PROBLEMS,
    before: Path | None = None,
) -> Iterator[str]:
    """The lines of a Markdown table."""
    yield "| " + " | ".join(HEAD) + " |"
    yield "|" + "---|" * len(HEAD)
    roots = [HERE.parents[2]] if before is None else [before.resolve(), HERE.parents[2]]
    for problem in problems:
        for row in measured(*problem, steps, rounds, roots):
            yield "| " + " | ".join(str(value) for value in row) + " |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=5, help="steps of each run after its first")
    parser.add_argument("--rounds", type=int, default=12, help="rounds of these steps")
    parser.add_argument("--before", type=Path, help="a clone of the project with other code")
    parser.add_argument("--solver", choices=("split", "coupled"), help="by default both")
    parser.add_argument("--take", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.take:
        dim, maxh, solver, count = options.take
        take_steps(int(dim), float(maxh), solver, int(count))
        return 0
    problems = [problem for problem in PROBLEMS if options.solver in (None, problem[2])]
    for line in rows(options.steps, options.rounds, problems, options.before):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())

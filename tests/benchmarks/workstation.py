"""A step's time and memory beside an older code and another method: ``python -m tests.benchmarks.workstation
[--before CHECKOUT] [--cells N ...] [--threads 1 2] [--steps N] [-o DIRECTORY]`` in the project's root.

The rows of a mesh are the swirl of ``case``: by the code of another clone (``--before``), by this code with
each number of threads, and, on tetrahedra, by ``LagrangianSwirl`` with algebraic multigrid, if a Python has
petsc4py: this one, or ``NGVISCO_PARALLEL_PYTHON``. Each row is a process of its own, and all are run one
after the other. Seconds are those of a clock, in brackets those of the processors; compare them within one
call only. The kinetic energy after the last step shows that all rows solve one problem; the Lagrangian solid
has no hyperviscosity.
"""

import argparse
import itertools
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve()
CUBES = {200: (10, 10), 2_312: (34, 34), 48: (2, 2, 2), 2_058: (7, 7, 7), 13_182: (13, 13, 13)}
"""Squares of two triangles, or cubes of six tetrahedra, along the box's edges, by the number of cells."""
REFINED = 50_552
"""Number of cells of ``case``'s largest mesh."""
CELLS = (200, 2_312, 48, 2_058)
"""Meshes by default."""
HEAD = ("cells", "code", "threads", "set-up, s", "first step, s", "later step, s")
HEAD += ("iterations", "directions", "peak, GB", "kB a cell", "kinetic energy, J")


def mesh_of(cells: int) -> Any:
    """The mesh with a number of cells."""
    from ngvisco.geometries import structured_box
    from tests.benchmarks.case import FIFTY_THOUSAND, domain

    if cells == REFINED:
        return domain(3, FIFTY_THOUSAND)
    return structured_box((1,) * len(CUBES[cells]), CUBES[cells])


def swirl(mesh: Any) -> tuple[Callable[[], tuple[int, int]], Callable[[], float]]:
    """Two functions that compute the swirl with the version of ngvisco on Python's path. The first function
    makes a step and returns the numbers of iterations and directions. The second function returns the kinetic
    energy."""
    import ngvisco as nv
    from ngvisco.solver.split.preconditioner import Preconditioner
    from tests.benchmarks.case import swirl_on

    directions: list[int] = []

    class Counted(Preconditioner):
        def _flow(self, *arguments: Any) -> Any:
            result = super()._flow(*arguments)
            directions.append(self.iterations)
            return result

    run = swirl_on(mesh, nv.NewtonOptions())
    run.solver.newton.preconditioner.__class__ = Counted

    def step() -> tuple[int, int]:
        directions.clear()
        return int(run.advance()["newton_iterations"]), sum(directions)

    return step, lambda: float(run.ledger.rows[-1]["kinetic"])


def lagrangian(mesh: Any) -> tuple[Callable[[], tuple[int, int]], Callable[[], float]]:
    """Start the Lagrangian code; return two functions like those of ``swirl``."""
    from tests.benchmarks.multigrid import Multigrid
    from tests.verification.lagrangian_swirl import LagrangianSwirl

    run = LagrangianSwirl(mesh, 0.02, Multigrid)

    def step() -> tuple[int, int]:
        before = run.iterations, run.directions
        run.advance()
        return run.iterations - before[0], run.directions - before[1]

    return step, lambda: run.kinetic


def peak() -> float:
    """The largest memory of this process so far, GB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def clocks() -> tuple[float, float]:
    """Seconds of a clock, and of the processors."""
    return time.perf_counter(), time.process_time()


def measure(code: str, cells: int, steps: int) -> dict[str, Any]:
    """Measure a row in this process."""
    from ngsolve import SetNumThreads

    SetNumThreads(1)
    mesh = mesh_of(cells)
    imported, times, counts = peak(), [clocks()], list[tuple[int, int]]()
    step, kinetic = {"swirl": swirl, "lagrangian": lagrangian}[code](mesh)
    times.append(clocks())
    for _ in range(steps + 1):
        counts.append(step())
        times.append(clocks())
    spent = [[b - a for a, b in zip(*pair, strict=True)] for pair in itertools.pairwise(times)]
    later = [sum(values) / steps for values in zip(*spent[2:], strict=True)]
    iterations, directions = (sum(values) / steps for values in zip(*counts[1:], strict=True))
    return {
        **{"set-up": spent[0], "first": spent[1], "later": later},
        **{"iterations": iterations, "directions": directions, "first counts": counts[0]},
        **{"peak": peak(), "imported": imported, "kinetic": kinetic()},
    }


def row(code: str, name: str, root: Path, threads: int, cells: int, steps: int) -> dict[str, Any]:
    """Measure a row in another process with the code of ``root``."""
    python = sys.executable
    if code == "lagrangian":
        python = os.environ.get("NGVISCO_PARALLEL_PYTHON", python)
    paths = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    limits = {"NGVISCO_THREADS": str(threads), "NGS_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [python, str(HERE), "--row", code, str(cells), str(steps)]
    environment = os.environ | limits | {"PYTHONPATH": paths}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    what: dict[str, Any] = {"cells": cells, "code": name, "threads": threads}
    if done.returncode:
        return what | {"failed": (done.stderr.strip() or "no message").splitlines()[-1]}
    return what | json.loads(done.stdout.splitlines()[-1])


def line(row: dict[str, Any]) -> str:
    """A line of the Markdown table."""
    entries = [f"{row['cells']:,}", row["code"], str(row["threads"])]
    if "failed" in row:
        entries += [row["failed"]] + [""] * (len(HEAD) - 4)
    else:
        entries += [
            f"{wall:.3g} ({spent:.3g})" for wall, spent in (row[n] for n in ("set-up", "first", "later"))
        ]
        entries += [f"{row['iterations']:.1f}", f"{row['directions']:.0f}", f"{row['peak']:.2f}"]
        entries += [f"{1e6 * (row['peak'] - row['imported']) / row['cells']:.0f}", f"{row['kinetic']:.5f}"]
    return f"| {' | '.join(entries)} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--before", type=Path, metavar="CHECKOUT", help="a clone of the project with other code"
    )
    sizes = [*CUBES, REFINED]
    parser.add_argument("--cells", type=int, nargs="+", choices=sizes, default=CELLS, help="numbers of cells")
    parser.add_argument("--threads", type=int, nargs="+", default=(1, 2), help="threads of this code")
    parser.add_argument("--steps", type=int, default=2, help="steps after the first")
    parser.add_argument("-o", "--output", type=Path, metavar="DIRECTORY", help="keeps rows and table there")
    parser.add_argument("--row", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.row:
        code, cells, steps = options.row
        print(json.dumps(measure(code, int(cells), int(steps))))
        return 0
    lines = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
    print("\n".join(lines), flush=True)
    rows, root = [], HERE.parents[2]
    for cells in options.cells:
        codes = [("swirl", "here", root, threads) for threads in options.threads]
        if options.before is not None:
            codes.insert(0, ("swirl", "before", options.before.resolve(), 1))
        if len(CUBES.get(cells, (1, 1, 1))) == 3:
            codes.append(("lagrangian", "Lagrangian, GAMG", root, 1))
        for code, name, path, threads in codes:
            rows.append(row(code, name, path, threads, cells, options.steps))
            lines.append(line(rows[-1]))
            print(lines[-1], flush=True)
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        (options.output / "workstation.json").write_text(json.dumps(rows, indent=1))
        (options.output / "workstation.md").write_text("\n".join(lines) + "\n")
    return 1 if any("failed" in one for one in rows if not one["code"].startswith("Lagrangian")) else 0


if __name__ == "__main__":
    sys.exit(main())

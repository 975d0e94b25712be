"""Cost of a step of the split solver over ranks: one row a process, printed as JSON by the first rank.

Run ``python -m tests.benchmarks.ranks [-o DIRECTORY] [--ranks 0 1 2 4 8] [--cells 13]`` in the project's
root, with a Python that has petsc4py. The module computes the neo-Hookean swirl of ``case`` in a box of n x n
x n cubes of six tetrahedra. The swirl is computed in turn on each given number of ranks with cells, by mpirun
with one more rank, the first. The number 0 means one process without MPI. Times are comparable within one
call, for as many ranks as processors at most; iterations, messages, bytes and memory are comparable in all
calls.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from ngsolve import Mesh, SetNumThreads

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.parallel.communicator import TRAFFIC, Communicator, Working
from ngvisco.parallel.exchange import Exchange
from ngvisco.parallel.mesh import distributed
from ngvisco.solver.options import SplitOptions
from ngvisco.solver.split.preconditioner import Preconditioner
from tests.benchmarks.case import swirl_on

METHODS = ("direct", "gamg", "hypre")


def resident(field: str = "VmHWM") -> float:
    """Memory of this process, GB; by default the largest so far."""
    with Path("/proc/self/status").open() as lines:
        return next(float(line.split()[1]) for line in lines if line.startswith(field)) / 1e6


def newton(coarse: str, unknowns: int | None) -> nv.NewtonOptions:
    """Options with the solver ``coarse`` for the vertices, and with two levels from a number of unknowns of v
    on."""
    split = SplitOptions() if unknowns is None else SplitOptions(direct_up_to=(unknowns, unknowns))
    return nv.NewtonOptions(coarse=coarse, split=split)


def timed(waits: list[float], owner: type, name: str) -> None:
    """Add up the processor time of a method in which a rank waits for others."""
    method = getattr(owner, name)

    def wrapped(*arguments: Any) -> Any:
        began = time.process_time()
        result = method(*arguments)
        waits[0] += time.process_time() - began
        return result

    setattr(owner, name, wrapped)


def mesh(n: int, ranks: Communicator) -> Mesh:
    """The distributed box; only the first rank has the whole mesh, as with a mesh file."""
    return distributed(structured_box((1, 1, 1), (n, n, n)) if ranks.is_first else None, ranks)


def measured(n: int, steps: int, coarse: str, two_levels_from: int | None) -> list[dict[str, Any]]:
    """Costs of the steps on every rank; the first step is not timed."""
    SetNumThreads(1)
    imported = resident("VmRSS")
    linear: list[int] = []
    waits = [0.0]
    for owner, name in ((Exchange, "_got"), (Working, "sums"), (Communicator, "_reduced")):
        timed(waits, owner, name)

    class Counted(Preconditioner):
        def _flow(self, *arguments: Any) -> Any:
            result = super()._flow(*arguments)
            linear.append(self.iterations)
            return result

    ranks = Communicator.world()
    began = time.perf_counter()
    run = swirl_on(mesh(n, ranks), newton(coarse, two_levels_from))
    run.solver.newton.preconditioner.__class__ = Counted
    row: dict[str, Any] = {
        "n": n,
        "ranks": max(ranks.size - 1, 0),
        "rank": ranks.rank,
        "coarse": coarse,
        "cells": run.cells,
        "own cells": run.mesh.ne,
        "neighbours": len(run.solver.newton.residual.exchange.shared),
        "imports": imported,
    }
    row["set-up"] = time.perf_counter() - began
    row["wall"], row["processor"], row["iterations"], row["linear"] = [], [], [], []
    row["busy"] = []
    row["messages"], row["bytes"], row["reductions"] = [], [], []
    for _ in range(steps):
        before = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        linear.clear()
        waits[0] = 0.0
        ranks.total(0.0)
        wall, processor = time.perf_counter(), time.process_time()
        last = run.advance()
        row["wall"].append(time.perf_counter() - wall)
        row["processor"].append(time.process_time() - processor)
        row["busy"].append(row["processor"][-1] - waits[0])
        row["iterations"].append(int(last["newton_iterations"]))
        row["linear"].append(sum(linear))
        after = TRAFFIC.messages, TRAFFIC.bytes, TRAFFIC.reductions
        for name, a, b in zip(("messages", "bytes", "reductions"), after, before, strict=True):
            row[name].append(a - b)
    row["closure"] = abs(last["closure_relative"])
    row["ledger"] = [{name: float(value) for name, value in each.items()} for each in run.ledger.rows]
    row["memory"] = resident()
    return ranks.gathered(row)


def started(ranks: int, words: list[str], prefix: list[str], timeout: float) -> list[dict[str, Any]]:
    """The rows of a run by a number of ranks with cells (0 is without MPI), or a row with the reason of a
    failure."""
    command = [sys.executable, "-m", "tests.benchmarks.ranks", "--child", *words]
    environment = os.environ | {"NGS_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    # a container's user is root, and there may be more ranks than processors
    allowed = (
        "OMPI_ALLOW_RUN_AS_ROOT",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM",
        "OMPI_MCA_rmaps_base_oversubscribe",
    )
    environment |= dict.fromkeys(allowed, "1")
    if ranks:
        command[1:1] = ["-m", "mpi4py"]
        # the first rank sleeps; other ranks have to yield only if they exceed the processors
        gives_way = ["--mca", "mpi_yield_when_idle", str(int(ranks > (os.cpu_count() or 1)))]
        mpirun = shutil.which("mpirun")
        if mpirun is None:
            return [{"ranks": ranks, "rank": 0, "failed": "there is no mpirun"}]
        command = [mpirun, "-n", str(ranks + 1), *gives_way, *command]
    try:
        done = subprocess.run(
            [*prefix, *command], capture_output=True, text=True, timeout=timeout, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        return [{"ranks": ranks, "rank": 0, "failed": f"more than {timeout:g} s"}]
    if done.returncode:
        said = [line.strip() for line in done.stderr.splitlines() if line.strip(" -\n")]
        return [{"ranks": ranks, "rank": 0, "failed": " ".join(said[:3]) or "no message"}]
    rows = json.loads(done.stdout.splitlines()[-1])
    for row in rows:
        row["ranks"] = ranks
    return rows


def of_step(row: dict[str, Any], name: str) -> float:
    """The median of the steps but the first."""
    return float(statistics.median(row[name][1:] or row[name]))


def by_ranks(rows: list[dict[str, Any]]) -> dict[tuple[int, str], list[dict[str, Any]]]:
    """The table's rows of ranks with cells, by runs."""
    runs: dict[tuple[int, str], list[dict[str, Any]]] = {}
    for row in rows:
        if row.get("own cells"):
            runs.setdefault((row["ranks"], row["coarse"]), []).append(row)
    return runs


def difference(a: list[dict[str, float]], b: list[dict[str, float]]) -> float:
    """The largest difference of two ledgers' columns, without iterations, relative to a column's size or
    1e-3.

    The result is infinite if only one of two entries is a number.
    """
    energy, found = a[0]["kinetic"] + a[0]["stored"], 0.0
    for name in (name for name in a[0] if "iterations" not in name):
        for x, y in zip(a, b, strict=True):
            size = energy if name.startswith("closure") else max(abs(x[name]), 1e-3)
            if not (x[name] != x[name] and y[name] != y[name]):
                differs = abs(x[name] - y[name]) / size
                found = max(found, differs if differs == differs else float("inf"))
    return found


def markdown(rows: list[dict[str, Any]]) -> str:
    """A table of runs with medians of the steps after the first one, for the rank that has most.

    ``busy`` is processor time without waiting for messages and reductions; wall time would include other work
    on the processors.
    """
    runs = by_ranks(rows)
    head = (
        "| ranks | coarse | cells of a rank | wall | busy | iterations | linear "
        "| messages | MB | reductions | memory, GB | ledger |"
    )
    lines = [head, "|" + "---|" * head.count(" |")]
    reference = next(iter(runs.values()), [{}])[0]
    for (ranks, coarse), of in runs.items():
        first = of[0]

        def most(name: str, of: list[dict[str, Any]] = of) -> float:
            return max(of_step(row, name) for row in of)

        memory = max(row["memory"] - row["imports"] for row in of)
        cells = f"{min(row['own cells'] for row in of)} to {max(row['own cells'] for row in of)}"
        lines.append(
            f"| {ranks or 'no MPI'} | {coarse} | {cells if ranks > 1 else first['own cells']} "
            f"| {most('wall'):.2f} s | {most('busy'):.2f} s "
            f"| {sum(first['iterations'])} | {sum(first['linear'])} "
            f"| {most('messages'):.0f} | {most('bytes') / 1e6:.1f} | {most('reductions'):.0f} | {memory:.2f} "
            f"| {difference(reference['ledger'], first['ledger']):.0e} |"
        )
    failed = [f"{row['ranks']} ranks: {row['failed']}" for row in rows if "failed" in row]
    return "\n".join([*lines, "", *failed, ""])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.ranks", description=__doc__.splitlines()[0]
    )
    parser.add_argument("-o", "--output", type=Path, help="directory for ranks.json and ranks.md")
    parser.add_argument("--ranks", type=int, nargs="*", default=[0, 1, 2], help="ranks with cells")
    parser.add_argument("--cells", type=int, default=13, help="cubes along an edge; 13: 13,182 tetrahedra")
    parser.add_argument("--steps", type=int, default=4, help="steps, of which the first is not timed")
    parser.add_argument("--coarse", nargs="*", default=["direct"], choices=METHODS, help="for the vertices")
    parser.add_argument("--two-levels-from", type=int, help="unknowns of v (default: the solver's)")
    parser.add_argument("--prefix", default="", help="words before each command, as nice -n -5")
    parser.add_argument("--timeout", type=float, default=3600, help="seconds a run may take")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.child:
        rows = measured(chosen.cells, chosen.steps, chosen.coarse[0], chosen.two_levels_from)
        if Communicator.world().is_first:
            print(json.dumps(rows), flush=True)
        return 0
    rows = []
    for coarse in chosen.coarse:
        for ranks in chosen.ranks:
            words = ["--cells", str(chosen.cells), "--steps", str(chosen.steps), "--coarse", coarse]
            if chosen.two_levels_from is not None:
                words += ["--two-levels-from", str(chosen.two_levels_from)]
            rows += started(ranks, words, chosen.prefix.split(), chosen.timeout)
            print(f"{ranks} ranks, {coarse}: " + rows[-1].get("failed", "done"), flush=True)
    print(markdown(rows))
    if chosen.output:
        chosen.output.mkdir(parents=True, exist_ok=True)
        (chosen.output / "ranks.json").write_text(json.dumps(rows, indent=1))
        (chosen.output / "ranks.md").write_text(markdown(rows))
    return 1 if any("failed" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())

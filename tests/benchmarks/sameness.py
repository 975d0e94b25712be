"""Whether ranks change what a run gives: ledgers and iterations of small cases over 1, 2, 3, 4 and 8 ranks.

``python -m tests.benchmarks.sameness [-o DIRECTORY] [--ranks 1 2 3 4 8] [CASES]`` in the project's root, by a
Python that has petsc4py: the cases ``TABULATED`` of ``tests/parallel/runs.py`` on one process without MPI and
on so many ranks with cells.  Ends with 1 where a ledger differs by more than 1e-10 of a column's size, or
iterations grow by more than 1.3 from the fewest ranks to the most.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.benchmarks.ranks import difference
from tests.parallel.launch import ROOT, run

CASES = [
    f"{name}, {solver}"
    for name in (
        *("2D", "3D", "slip on a circle", "slip on a sphere", "lid", "creep, nu > 0", "three bodies"),
        *("delta, 2D", "delta, 3D", "cut-off, 2D", "cut-off, 3D"),
    )
    for solver in ("coupled", "split")
]
LEDGER, GROWTH = 1e-10, 1.3
"""Bounds of differences and of the growth of iterations."""


def results(names: list[str], ranks: int, timeout: float) -> dict[str, Any]:
    """What ``runs.py`` prints of these cases, with so many ranks with cells, 0: without MPI."""
    script = ROOT / "tests" / "parallel" / "runs.py"
    words = ["-W", "ignore", *(["-m", "mpi4py"] if ranks else []), script, *names]
    try:
        done = run(*words, ranks=ranks + 1, timeout=timeout)
    except subprocess.TimeoutExpired:
        return {"failed": f"more than {timeout:g} s"}
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip(" -")]
        return {"failed": " ".join(said[-3:]) or "no message"}
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def iterations(of: dict[str, Any]) -> tuple[int, int]:
    """Of all steps: of the nonlinear solver, and of the split solver's linear systems."""
    return int(sum(row["newton_iterations"] for row in of["rows"])), of["linear"]


def table(found: dict[int, dict[str, Any]]) -> tuple[str, list[str]]:
    """Markdown of the results by ranks, the first of them the reference, and what misses a bound."""
    reference, *others = found
    names = list(found[reference])
    head = ["case", "cells", "one process", *map(str, others)]
    lines, missed = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"], []
    for name in names:
        one = found[reference][name]
        cells = [name, str(one["cells"]), _counts(one)]
        for ranks in others:
            if name not in found[ranks]:
                cells.append("–")
                missed.append(f"{name} on {ranks} ranks: {found[ranks].get('failed', 'no result')}")
                continue
            several = found[ranks][name]
            differs = difference(one["rows"], several["rows"])
            cells.append(f"{differs:.0e}; {_counts(several)}")
            if not differs <= LEDGER:
                missed.append(f"{name} on {ranks} ranks: the ledger differs by {differs:.1e}")
        lines.append(f"| {' | '.join(cells)} |")
        ran = [iterations(found[ranks][name]) for ranks in others if name in found[ranks]]
        for kind, few, many in zip(("", "linear "), ran[0], ran[-1], strict=True) if ran else ():
            if many > GROWTH * few:
                missed.append(f"{name}: {kind}iterations grow from {few} to {many}")
    return "\n".join(lines) + "\n", missed


def _counts(of: dict[str, Any]) -> str:
    nonlinear, linear = iterations(of)
    return f"{nonlinear} ({linear})" if linear else str(nonlinear)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.sameness", description=__doc__.splitlines()[0]
    )
    parser.add_argument("cases", nargs="*", default=CASES, help="of tests/parallel/runs.py")
    parser.add_argument("-o", "--output", type=Path, help="directory for sameness.json and sameness.md")
    parser.add_argument("--ranks", type=int, nargs="*", default=[1, 2, 3, 4, 8], help="ranks with cells")
    parser.add_argument(
        "--timeout", type=float, default=3600, help="seconds the cases may take on some ranks"
    )
    chosen = parser.parse_args(arguments)
    found: dict[int, dict[str, Any]] = {}
    text, missed = "", []
    for ranks in (0, *chosen.ranks):
        found[ranks] = results(chosen.cases, ranks, chosen.timeout)
        print(f"{ranks or 'no'} ranks: {found[ranks].get('failed', 'done')}", flush=True)
        if "failed" in found[0]:
            return 1
        text, missed = table(found)
        if chosen.output:
            chosen.output.mkdir(parents=True, exist_ok=True)
            (chosen.output / "sameness.json").write_text(json.dumps(found, indent=1))
            (chosen.output / "sameness.md").write_text("\n".join([text, *missed, ""]))
    print(text, *missed, sep="\n")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())

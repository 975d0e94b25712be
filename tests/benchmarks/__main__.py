"""What a Rothe step costs: ``python -m tests.benchmarks [-o DIRECTORY] [--sizes ...]`` in the project's root.

The neo-Hookean swirl (P2 velocity, DG1 fields, p = 4, tau = 0.02 s) in series of meshes, by both solvers,
and with creep by F and by B.  Every row is a process of its own, so that its peak memory is its own.  Times
compare within one call only: ratios are what is meant to be quoted.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from itertools import product
from pathlib import Path

from tests.benchmarks.case import FIFTY_THOUSAND
from tests.benchmarks.table import markdown, summary

SIZES = {
    "2D": [0.1, 0.055, 0.032],
    "3D": [0.3, 0.18, 0.13, 0.112, 0.07, 0.0515, FIFTY_THOUSAND],
    "2D coupled": [0.1, 0.055, 0.032],
    "3D coupled": [0.5, 0.3],
    "2D creep": [0.055],
    "3D creep": [0.18],
}
QUICK = {
    "2D": [0.3],
    "3D": [0.7],
    "2D coupled": [0.3],
    "3D coupled": [0.7],
    "2D creep": [0.3],
    "3D creep": [0.7],
}


def measure(
    dim: int, maxh: float, method: str, threads: int, steps: int, timeout: float, creeping: str = ""
) -> dict:
    """One row, from a process of its own."""
    command = [
        sys.executable,
        "-m",
        "tests.benchmarks.case",
        str(dim),
        str(maxh),
        method,
        str(threads),
        str(steps),
        *([creeping] if creeping else []),
    ]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return {"dim": dim, "maxh": maxh, "method": method, "failed": f"more than {timeout:g} s"}
    if done.returncode:
        return {"dim": dim, "maxh": maxh, "method": method, "failed": done.stderr.strip().splitlines()[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="directory for benchmark.json and benchmark.md")
    parser.add_argument("--quick", action="store_true", help="tiny meshes, to see that it works")
    parser.add_argument("--series", nargs="*", choices=list(SIZES), default=list(SIZES))
    parser.add_argument("--largest", type=float, help="leave out meshes finer than this maxh")
    parser.add_argument("--threads", type=int, default=2, choices=(1, 2), help="threads (default 2)")
    parser.add_argument("--steps", type=int, default=2, help="steps timed, after a first one (default 2)")
    parser.add_argument("--timeout", type=float, default=3600, help="seconds a row may take")
    chosen = parser.parse_args(arguments)
    rows = []
    for series in chosen.series:
        dim, method = int(series[0]), "coupled" if "coupled" in series else "split"
        sizes = [h for h in (QUICK if chosen.quick else SIZES)[series] if h >= (chosen.largest or 0)]
        forms = ("F", "B") if "creep" in series else ("",)
        for maxh, creeping in product(sizes, forms):
            rows.append(measure(dim, maxh, method, chosen.threads, chosen.steps, chosen.timeout, creeping))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
        if method == "split" and "creep" not in series:  # two threads over one, in the middle of the series
            middle, others = sizes[len(sizes) // 2], 3 - chosen.threads
            rows.append(measure(dim, middle, method, others, chosen.steps, chosen.timeout))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
    text = f"{markdown(rows)}\n{summary(rows)}"
    print(f"\n{text}")
    if chosen.output:
        chosen.output.mkdir(parents=True, exist_ok=True)
        (chosen.output / "benchmark.json").write_text(json.dumps(rows, indent=1))
        (chosen.output / "benchmark.md").write_text(text)
    return 1 if any("failed" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())

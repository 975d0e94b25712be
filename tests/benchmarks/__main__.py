"""What a Rothe step costs: ``python -m tests.benchmarks [-o DIRECTORY]`` in the project's root.

The neo-Hookean swirl (P2 velocity, DG1 fields, p = 4, tau = 0.02 s) in series of meshes, by both solvers,
with creep by F and by B, and as one body and as two.  Every row is a process of its own, so that its peak
memory is its own.  Times compare within one call only: ratios are what is meant to be quoted.

The series "schemes" is the time to a given error in time (see ``schemes``), in a process of its own too.
"""

import argparse
import json
import subprocess
import sys
from itertools import product

from tests.benchmarks.case import FIFTY_THOUSAND, STRUCTURED
from tests.benchmarks.table import (
    add_files,
    against,
    markdown,
    markdown_of_schemes,
    read,
    summary,
    summary_of_schemes,
    write,
)

SIZES = {
    "2D": [0.1, 0.055, 0.032],
    "3D": [0.3, 0.18, 0.13, 0.112, 0.07, 0.0515, FIFTY_THOUSAND],
    "3D structured": list(STRUCTURED)[1:],
    "2D coupled": [0.1, 0.055, 0.032],
    "3D coupled": [0.5, 0.3],
    "2D creep": [0.055],
    "3D creep": [0.18],
    "2D bodies": [0.055],
    "3D bodies": [0.18],
}
QUICK = {
    "2D": [0.3],
    "3D": [0.7],
    "3D structured": list(STRUCTURED)[:1],
    "2D coupled": [0.3],
    "3D coupled": [0.7],
    "2D creep": [0.3],
    "3D creep": [0.7],
    "2D bodies": [0.3],
    "3D bodies": [0.7],
}
FORMS = {"creep": ("F", "B"), "bodies": ("one body", "two bodies")}
"""What is compared in a series, on each of its meshes."""

LARGEST = 0.07
"""maxh, m, of the finest mesh by default: finer ones, 33,000 and 50,000 tetrahedra, take hours."""

SCHEMES = ["0.25", "0.2", "160", "0.02", "0.002"]
QUICK_SCHEMES = ["0.5", "0.06", "6", "0.2"]
"""maxh, m, end, s, steps of the reference, and the relative errors to be met, of the series of schemes."""


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


def measure_schemes(arguments: list[str], timeout: float) -> list[dict]:
    """Rows of the time to a given error, from one process; one that says why where it failed."""
    command = [sys.executable, "-m", "tests.benchmarks.schemes", *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return [{"scheme": "all", "failed": f"more than {timeout:g} s"}]
    if done.returncode:
        return [{"scheme": "all", "failed": done.stderr.strip().splitlines()[-1]}]
    return json.loads(done.stdout.splitlines()[-1])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__.splitlines()[0])
    add_files(parser)
    parser.add_argument("--quick", action="store_true", help="tiny meshes, to see that it works")
    parser.add_argument("--series", nargs="*", choices=[*SIZES, "schemes"], default=[*SIZES, "schemes"])
    parser.add_argument(
        "--largest", type=float, default=LARGEST, help=f"leave out meshes finer than this maxh ({LARGEST:g})"
    )
    parser.add_argument("--threads", type=int, default=2, choices=(1, 2), help="threads (default 2)")
    parser.add_argument("--steps", type=int, default=2, help="steps timed, after a first one (default 2)")
    parser.add_argument("--timeout", type=float, default=3600, help="seconds a row may take")
    chosen = parser.parse_args(arguments)
    older = read(chosen.against)
    rows: list[dict] = []
    for series in (name for name in SIZES if name in chosen.series):
        dim, method = int(series[0]), "coupled" if "coupled" in series else "split"
        sizes = [h for h in (QUICK if chosen.quick else SIZES)[series] if h >= chosen.largest]
        forms = FORMS.get(series[3:], ("",))
        for maxh, creeping in product(sizes, forms):
            rows.append(measure(dim, maxh, method, chosen.threads, chosen.steps, chosen.timeout, creeping))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
        if series in ("2D", "3D"):  # two threads over one, in the middle of the series
            middle, others = sizes[len(sizes) // 2], 3 - chosen.threads
            rows.append(measure(dim, middle, method, others, chosen.steps, chosen.timeout))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
    text, of_schemes = "", []
    if rows:
        text += f"{markdown(rows)}\n{summary(rows)}"
    if "schemes" in chosen.series:
        of_schemes = measure_schemes(QUICK_SCHEMES if chosen.quick else SCHEMES, chosen.timeout)
        text += f"\n{markdown_of_schemes(of_schemes)}\n{summary_of_schemes(of_schemes)}"
    text += against(
        rows,
        [row for row in older if "dim" in row],
        ("dim", "maxh", "method", "threads", "creeping"),
        ("step", "first", "set-up", "iterations", "memory"),
    )
    of_older = [row for row in older if "tolerance" in row]
    text += against(of_schemes, of_older, ("scheme", "tolerance"), ("seconds", "iterations"))
    print(f"\n{text}")
    write(chosen.output, "benchmark", rows + of_schemes, text)
    return 1 if any("failed" in row for row in rows + of_schemes) else 0


if __name__ == "__main__":
    sys.exit(main())

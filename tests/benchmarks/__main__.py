"""Cost of a Rothe step: ``python -m tests.benchmarks [-o DIRECTORY]`` in the project's root.

The neo-Hookean swirl (P2 velocity, DG1 fields, p = 4, tau = 0.02 s) is computed on series of meshes, with
both solvers, with creep by F and by B, and as one body and as two. Each row is a separate process, so that
its peak memory is measured. Times are comparable within one call only: quote ratios.
"""

import argparse
import json
import subprocess
import sys
from itertools import product

from tests.benchmarks.case import FIFTY_THOUSAND, STRUCTURED
from tests.benchmarks.table import add_files, against, markdown, read, summary, write

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
FORMS = {"creep": ("F", "B"), "bodies": ("one body", "two bodies")}
"""Forms that a series compares on each of its meshes."""

LARGEST = 0.07
"""The finest mesh's maxh, m, by default; finer meshes, 33,000 and 50,000 tetrahedra, take hours."""


def measure(
    dim: int, maxh: float, method: str, threads: int, steps: int, timeout: float, creeping: str = ""
) -> dict:
    """One row, computed in a separate process."""
    words = [str(dim), str(maxh), method, str(threads), str(steps), *([creeping] if creeping else [])]
    command = [sys.executable, "-m", "tests.benchmarks.case", *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    except subprocess.TimeoutExpired:
        return {"dim": dim, "maxh": maxh, "method": method, "failed": f"more than {timeout:g} s"}
    if done.returncode:
        return {"dim": dim, "maxh": maxh, "method": method, "failed": done.stderr.strip().splitlines()[-1]}
    return json.loads(done.stdout.splitlines()[-1])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__.splitlines()[0])
    add_files(parser)
    parser.add_argument("--quick", action="store_true", help="tiny meshes, to see that it works")
    parser.add_argument("--series", nargs="*", choices=list(SIZES), default=list(SIZES))
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
        sizes = [h for h in SIZES[series] if h >= chosen.largest]
        if chosen.quick:
            sizes = [next(iter(STRUCTURED)) if "structured" in series else 0.3 if dim == 2 else 0.7]
        if not sizes:
            print(f"{series}: has no mesh of {chosen.largest:g} m or more")
            continue
        forms = FORMS.get(series[3:], ("",))
        for maxh, creeping in product(sizes, forms):
            rows.append(measure(dim, maxh, method, chosen.threads, chosen.steps, chosen.timeout, creeping))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
        if series in ("2D", "3D"):  # one mesh is also measured with the other number of threads
            middle, others = sizes[len(sizes) // 2], 3 - chosen.threads
            rows.append(measure(dim, middle, method, others, chosen.steps, chosen.timeout))
            print(markdown(rows[-1:]).splitlines()[-1], flush=True)
    text = f"{markdown(rows)}\n{summary(rows)}"
    text += against(
        rows,
        older,
        ("dim", "maxh", "method", "threads", "creeping"),
        ("step", "first", "set-up", "iterations", "memory"),
    )
    print(f"\n{text}")
    write(chosen.output, "benchmark", rows, text)
    return 1 if any("failed" in row for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())

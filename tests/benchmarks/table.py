"""The benchmark's rows as a table, and their ratios."""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

PARTS = ("residuals", "assembly", "factorisation", "solves")


def _part(name: str) -> Callable[[dict], str]:
    return lambda row: f"{row['parts'].get(name, 0.0):.2f}" if "parts" in row else ""


COLUMNS: dict[str, Callable[[dict], str]] = {
    "cells": lambda row: f"{row['cells']:,}",
    "unknowns": lambda row: f"{row['unknowns']:,}",
    "threads": lambda row: str(row["threads"]),
    "its": lambda row: f"{row['iterations']:.1f}",
    "step, s": lambda row: f"{row['step']:.2f}",
    **{name: _part(name) for name in PARTS},
    "floor, s": lambda row: f"{row['floor']:.2f}",
    "step/floor": lambda row: f"{row['step'] / row['floor']:.1f}",
    "step/direct": lambda row: f"{row['step'] / row['direct']:.1f}" if "direct" in row else "",
    "set-up/step": lambda row: f"{row['set-up'] / row['step']:.1f}",
    "first/step": lambda row: f"{row['first'] / row['step']:.1f}",
    "GB": lambda row: f"{row['memory']:.2f}",
    "closure": lambda row: f"{row['closure']:.0e}",
}
"""Texts of a row's entries, by the heads of the columns."""

FITTED = (700, 40_000)
"""Least and largest number of cells of the rows that growth exponents are computed from, if there are at
least three such rows. With fewer cells, the interpreter takes most of a step's time; the largest mesh is
refined, and therefore of another kind."""


def markdown(rows: list[dict]) -> str:
    """A Markdown table with seconds a step, divided into parts if the solver has them, and GB.

    "floor" is one assembly, factorisation and solve with the solver's tangent; "direct" is that with a
    factorisation of the whole tangent; "step" is the mean of the steps after the first.
    """
    head = ["case", *COLUMNS]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        name = f"{row['dim']}D {row['method']}, h = {row['maxh']:g}"
        if row.get("creeping"):
            name += f", {row['creeping']}" if " " in row["creeping"] else f", creep by {row['creeping']}"
        if "failed" in row:
            lines.append(f"| {name} | {row['failed']} |" + " |" * (len(head) - 2))
            continue
        cells = [name, *(say(row) for say in COLUMNS.values())]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def summary(rows: list[dict]) -> str:
    """Ratios of rows of one call, and exponents of cost and memory in the number of cells."""
    done = [row for row in rows if "failed" not in row]
    lines = []
    creeping = {(r["dim"], r["maxh"], r["creeping"]): r["step"] for r in done if r.get("creeping")}
    for (dim, maxh, form), seconds in creeping.items():
        if form == "B" and (dim, maxh, "F") in creeping:
            ratio = seconds / creeping[dim, maxh, "F"]
            lines.append(f"- {dim}D, h = {maxh:g}, with creep: a step by B over one by F {ratio:.2f}")
        if form == "two bodies" and (dim, maxh, "one body") in creeping:
            ratio = seconds / creeping[dim, maxh, "one body"]
            lines.append(f"- {dim}D, h = {maxh:g}: a step of two bodies over one of one {ratio:.2f}")
    done = [row for row in done if not row.get("creeping")]
    steps = {(row["dim"], row["maxh"], row["method"], row["threads"]): row["step"] for row in done}
    for row in done:
        dim, maxh, method, threads = (row[name] for name in ("dim", "maxh", "method", "threads"))
        for name, other in {
            "coupled over split": (dim, maxh, "coupled", threads),
            "one thread over two": (dim, maxh, method, 1),
        }.items():
            if other in steps and other != (dim, maxh, method, threads):
                lines.append(f"- {dim}D, {row['cells']:,} cells: {name} {steps[other] / row['step']:.2f}")
    for dim in (2, 3):
        split = [
            r for r in done if r["dim"] == dim and r["method"] == "split" and not r.get("structured", False)
        ]
        threads = [r["threads"] for r in split]
        series = [r for r in split if r["threads"] == max(threads, key=threads.count)]
        if len(fitted := [r for r in series if FITTED[0] <= r["cells"] <= FITTED[1]]) >= 3:
            series = fitted
        if len(series) >= 2:
            size = np.log([row["cells"] for row in series])
            cells = f"{series[0]['cells']:,} to {series[-1]['cells']:,} cells"
            for name in ("step", "memory"):
                exponent = np.polyfit(size, np.log([row[name] for row in series]), 1)[0]
                lines.append(f"- {dim}D split, {cells}: {name} grows like cells^{exponent:.2f}")
    return "\n".join(lines) + "\n"


def against(rows: list[dict], older: list[dict], keys: Sequence[str], quantities: Sequence[str]) -> str:
    """Ratios of a row's quantities to those of an older table's row with the same keys, and geometric means.

    Rows that only one of the tables has, or that failed in one, are named at the end; without an older table
    the text is empty.
    """
    if not older:
        return ""

    def known(table: list[dict]) -> dict[tuple, dict]:
        return {tuple(row.get(key) for key in keys): row for row in table if "failed" not in row}

    new, old = known(rows), known(older)
    lines = [f"| {' | '.join(keys)} | {' | '.join(f'{name}, new/old' for name in quantities)} |"]
    lines.append("|" + "---|" * (len(keys) + len(quantities)))
    ratios = []
    for which in [which for which in new if which in old]:
        ratios.append([_ratio(new[which].get(name), old[which].get(name)) for name in quantities])
        said = ["" if value is None else f"{value}" for value in which]
        lines.append(f"| {' | '.join(said)} | {' | '.join(f'{ratio:.2f}' for ratio in ratios[-1])} |")
    lines.append("")
    for name, column in zip(quantities, np.transpose(ratios) if ratios else (), strict=False):
        if len(finite := column[np.isfinite(column) & (column > 0)]):
            lines.append(f"- {name}, new over old, geometric mean of {len(finite)}: {_mean(finite):.2f}")
    for which in sorted(set(new) ^ set(old), key=str):
        lines.append(f"- only in the {'new' if which in new else 'old'} table: {which}")
    return "\n".join(lines) + "\n"


def _ratio(new: float | None, old: float | None) -> float:
    return float("nan") if new is None or not old else new / old


def _mean(ratios: np.ndarray) -> float:
    return float(np.exp(np.log(ratios).mean()))


def add_files(parser: argparse.ArgumentParser) -> None:
    """Add options for a table's directory, and for the table that it is compared with."""
    parser.add_argument("-o", "--output", type=Path, metavar="DIRECTORY", help="keeps rows and tables there")
    parser.add_argument("--against", type=Path, metavar="JSON", help="rows of an older call: prints ratios")


def read(path: Path | None) -> list[dict]:
    """Rows that ``write`` has stored; none without a path."""
    return [] if path is None else json.loads(path.read_text())


def write(directory: Path | None, name: str, rows: list[dict], text: str) -> None:
    """Store rows and text if a directory is given."""
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / f"{name}.json").write_text(json.dumps(rows, indent=1))
        (directory / f"{name}.md").write_text(text)

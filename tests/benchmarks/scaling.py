"""A model of strong and weak scaling from what was counted: ``python -m tests.benchmarks.scaling FILES``.

``FILES`` are ``ranks.json`` of ``tests.benchmarks.ranks``, of several meshes and numbers of ranks.  Fitted
are, of a rank with cells and a step: processor time to its cells and a fixed part, and bytes to the surface
of its part, (cells)^(2/3).  Messages to a neighbour and reductions are counted; the network is not
measured but given.  The result is a MODEL: nothing in it beyond the measured ranks has been run.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.ranks import by_ranks, of_step

RANKS = (1, 2, 4, 8, 16, 32, 64, 125, 250, 500, 1000)
STRONG, WEAK = 1_000_000, 10_000
"""Tetrahedra of the mesh of strong scaling, and of a rank in weak scaling."""

FACES = {1: 0.0, 2: 2 ** (2 / 3), 4: 4 ** (2 / 3), 8: 3.0}
"""Of parts of a cube what they share, over (volume)^(2/3): halves one face, quarters two, eighths three."""
ALL_FACES = 6.0
"""The same for a part in the middle of many."""


@dataclass(frozen=True)
class Network:
    """What is assumed and not measured."""

    latency: float = 5e-6
    """Of a message, s, with what mpi4py takes to send it."""
    bandwidth: float = 1e9
    """Bytes a second of one rank, its share of a node's."""
    neighbours: int = 16
    """Of a rank's part at most, as METIS's parts in 3D have them."""
    imbalance: float = 0.05
    """Cells and time by which the slowest rank is above the mean."""
    cycle: int = 6
    """Exchanges of a level of the vertices' multigrid, of eight times fewer vertices from level to level.
    The factorisation is left out, since it does not divide."""


@dataclass(frozen=True)
class Fit:
    """Of a rank with cells and a step; sizes by its cells."""

    fixed: float
    """Processor time that no division makes less, s."""
    of_cell: float
    surface: float
    """Bytes of a part's face, over (cells)^(2/3)."""
    spread: float
    """Largest over least of these bytes among the runs: 1 where they are the surface's."""
    exchanges: float
    """Messages to one neighbour, on the finest mesh, as what follows."""
    reductions: float
    linear: float
    """Iterations of linear systems."""


def fitted(rows: list[dict[str, Any]]) -> Fit:
    """From the rows of several meshes, and several ranks with neighbours."""
    of = [row for row in rows if row.get("own cells") and row["coarse"] == "direct"]
    alone = [row for row in of if row["ranks"] == 1] or [row for row in of if row["ranks"] <= 2]
    cells = np.array([row["own cells"] for row in alone], dtype=float)
    times = np.array([of_step(row, "busy") for row in alone])
    # relative errors count, so that small meshes say what is fixed
    matrix = np.column_stack([np.ones_like(cells), cells]) / times[:, None]
    fixed, of_cell = np.linalg.lstsq(matrix, np.ones_like(times), rcond=None)[0]
    several = [row for row in of if row["neighbours"]]
    own = np.array([row["own cells"] for row in several], dtype=float)
    sent = np.array([of_step(row, "bytes") for row in several])
    of_face = sent / own ** (2 / 3) / [FACES.get(row["ranks"], ALL_FACES) for row in several]
    finest = [row for row in several if row["n"] == max(each["n"] for each in several)]
    return Fit(
        fixed=max(float(fixed), 0.0),
        of_cell=float(of_cell),
        surface=float(np.mean(of_face)),
        spread=float(np.max(of_face) / np.min(of_face)),
        exchanges=float(np.mean([of_step(row, "messages") / row["neighbours"] for row in finest])),
        reductions=float(np.mean([of_step(row, "reductions") for row in finest])),
        linear=float(np.mean([of_step(row, "linear") for row in finest])),
    )


def seconds(fit: Fit, network: Network, cells: float, ranks: int) -> dict[str, float]:
    """Of a step on a mesh of so many cells: its parts, and their sum by the name ``step``."""
    own = cells / ranks
    busy = (1 + network.imbalance * (ranks > 1)) * fit.of_cell * own
    parts = {"cells": busy, "fixed": fit.fixed}
    parts |= dict.fromkeys(("messages", "bytes", "reductions", "coarse"), 0.0)
    if ranks > 1:
        neighbours, rounds = min(network.neighbours, ranks - 1), np.ceil(np.log2(ranks))
        parts["messages"] = fit.exchanges * neighbours * network.latency
        parts["bytes"] = fit.surface * FACES.get(ranks, ALL_FACES) * own ** (2 / 3) / network.bandwidth
        parts["reductions"] = fit.reductions * 2 * rounds * network.latency
        levels = max(np.log(cells / 6) / np.log(8), 1.0)
        of_level = network.cycle * neighbours + 2 * rounds
        parts["coarse"] = fit.linear * levels * of_level * network.latency
    return parts | {"step": sum(parts.values())}


def table(fit: Fit, network: Network, sizes: list[tuple[int, float]]) -> str:
    """Seconds by parts, and the efficiency: what the cells of a rank take over the whole step."""
    head = "| ranks | tetrahedra | step | cells | fixed | messages | reductions | coarse | efficiency |"
    lines = [head, "|" + "---|" * (head.count("|") - 1)]
    for ranks, cells in sizes:
        p = seconds(fit, network, cells, ranks)
        sent = p["messages"] + p["bytes"]
        lines.append(
            f"| {ranks} | {cells:,.0f} | {p['step']:.3g} s | {p['cells']:.3g} | {p['fixed']:.2g} "
            f"| {sent:.2g} | {p['reductions']:.2g} | {p['coarse']:.2g} "
            f"| {_efficiency(fit, network, cells, ranks):.0%} |"
        )
    return "\n".join(lines)


def _efficiency(fit: Fit, network: Network, cells: float, ranks: int) -> float:
    """The time of a rank's share of the cells, without its fixed part and others, over that of the step."""
    return fit.of_cell * cells / ranks / seconds(fit, network, cells, ranks)["step"]


def report(rows: list[dict[str, Any]], network: Network) -> str:
    """What was counted and fitted, and the model's two tables, as Markdown."""
    fit = fitted(rows)
    strong = [(ranks, float(STRONG)) for ranks in RANKS]
    weak = [(ranks, float(WEAK * ranks)) for ranks in RANKS]
    return "\n".join(
        [
            counted(rows),
            "",
            f"Fitted: {1e3 * fit.of_cell:.2f} ms a cell and {fit.fixed:.2f} s of processor time a step; "
            f"{fit.surface / 1e3:.1f} kB (cells)^(2/3) sent for each face of a rank's part (largest over "
            f"least of the runs {fit.spread:.1f}), {fit.exchanges:.0f} messages to each neighbour, "
            f"{fit.reductions:.0f} reductions.",
            "",
            f"A model: {network}; iterations as measured, whatever the number of ranks.",
            "",
            f"Strong scaling, {STRONG:,} tetrahedra:",
            "",
            table(fit, network, strong),
            "",
            f"Weak scaling, {WEAK:,} tetrahedra a rank:",
            "",
            table(fit, network, weak),
            "",
        ]
    )


def counted(rows: list[dict[str, Any]]) -> str:
    """Of a rank with cells the most that it sent in a step, by mesh and ranks."""
    head = "| tetrahedra | ranks | of a rank | neighbours | messages | MB | of a face | reductions |"
    lines = [head, "|" + "---|" * (head.count("|") - 1)]
    meshes = sorted({row["n"] for row in rows if "n" in row})
    for n in meshes:
        for (ranks, coarse), of in by_ranks([row for row in rows if row.get("n") == n]).items():
            if ranks < 2 or coarse != "direct":
                continue
            most = max(of, key=lambda row: of_step(row, "bytes"))
            sent, own = of_step(most, "bytes"), most["own cells"]
            lines.append(
                f"| {most['cells']:,} | {ranks} | {own:,} | {most['neighbours']} "
                f"| {of_step(most, 'messages'):.0f} | {sent / 1e6:.1f} "
                f"| {sent / own ** (2 / 3) / FACES.get(ranks, ALL_FACES) / 1e3:.1f} kB "
                f"| {of_step(most, 'reductions'):.0f} |"
            )
    return "\n".join(lines)


def picture(rows: list[dict[str, Any]], network: Network, path: Path) -> None:
    """Both scalings of the model, with what was measured."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fit, figure = fitted(rows), Figure(figsize=(9, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for cells in (1e5, 1e6, 1e7):
        times = [seconds(fit, network, cells, ranks)["step"] for ranks in RANKS]
        (line,) = left.loglog(RANKS, times, label=f"{cells:,.0f} tetrahedra")
        left.loglog(RANKS, [times[0] / ranks for ranks in RANKS], ":", color=line.get_color(), lw=0.8)
    left.set(
        xlabel="ranks with cells", ylabel="seconds a step", title="Strong scaling, a model; dotted: ideal"
    )
    left.legend(fontsize=8)
    for own in (1e3, 1e4, 1e5):
        share = [_efficiency(fit, network, own * ranks, ranks) for ranks in RANKS]
        right.semilogx(RANKS, share, label=f"{own:,.0f} tetrahedra a rank")
    right.set(xlabel="ranks with cells", ylabel="efficiency", ylim=(0, 1.05), title="Weak scaling, a model")
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.scaling", description=__doc__.splitlines()[0]
    )
    parser.add_argument("files", type=Path, nargs="+", help="ranks.json of tests.benchmarks.ranks")
    parser.add_argument("-o", "--output", type=Path, help="directory for scaling.md and scaling.png")
    parser.add_argument("--latency", type=float, default=Network.latency, help="of a message, s")
    parser.add_argument("--bandwidth", type=float, default=Network.bandwidth, help="of a rank, bytes/s")
    chosen = parser.parse_args(arguments)
    rows = [row for file in chosen.files for row in json.loads(file.read_text())]
    network = Network(latency=chosen.latency, bandwidth=chosen.bandwidth)
    print(report(rows, network))
    if chosen.output:
        chosen.output.mkdir(parents=True, exist_ok=True)
        (chosen.output / "scaling.md").write_text(report(rows, network))
        picture(rows, network, chosen.output / "scaling.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""``ngvisco plot`` and ``ngvisco scene``: what a run looks like."""

from __future__ import annotations

import argparse
from pathlib import Path

from ngsolve import CoefficientFunction, SetNumThreads

from ngvisco import case as cases
from ngvisco.case.directory import Results
from ngvisco.run.fields import field_unit, scalar_fields
from ngvisco.run.plots import plot_energies, plot_fields, plot_history
from ngvisco.run.scene import write_scene


def plot(options: argparse.Namespace) -> int:
    """Energies, history and fields as PNG into the run directory."""
    results, chosen = _load(options)
    out = Path(options.directory)
    ledger = results.simulation.ledger
    plot_energies(ledger, out / "energies.png")
    plot_history(ledger, out / "history.png")
    titled = [(_titled(name), value) for name, value in chosen.items()]
    plot_fields(results.mesh, titled, out / "fields.png")
    for name in ("energies.png", "history.png", "fields.png"):
        print(out / name)
    return 0


def scene(options: argparse.Namespace) -> int:
    """The state as one HTML file in the run directory."""
    results, chosen = _load(options)
    path = Path(options.directory) / "scene.html"
    title = f"{results.case.sections.title or 'ngvisco'}, t = {results.time:g} s"
    write_scene(results.mesh, chosen, path, title)
    print(path)
    return 0


def _load(options: argparse.Namespace) -> tuple[Results, dict[str, CoefficientFunction]]:
    SetNumThreads(1)
    results = cases.load(options.directory, options.step)
    names = None if options.fields is None else [name.strip() for name in options.fields.split(",")]
    return results, scalar_fields(results.fields, names)


def _titled(name: str) -> str:
    title, unit = name.replace("_", " "), field_unit(name)
    return f"{title}, {unit}" if unit else title

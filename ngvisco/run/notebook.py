"""Displays of a simulation, a ledger and results in a notebook."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ngvisco.errors import NgviscoError
from ngvisco.forms.system import Step

_WIDTH, _HEIGHT = 420, 120


class NotebookError(NgviscoError, RuntimeError):
    """A package that a notebook needs is not installed."""


def simulation_html(step: Step, time: str) -> str:
    """The description of a simulation's step, with its present time in words."""
    layout, model, mesh = step.layout, step.model, step.mesh
    mechanisms = [
        f"{name} {html.escape(_short(part))}"
        for name in ("viscosity", "hyperviscosity", "creep", "regularisation")
        if (part := getattr(model, name)) is not None
    ]
    rows = {
        "material": html.escape(_short(model.material)),
        "mechanisms": "<br>".join(mechanisms) or "none",
        "loads": "<br>".join(html.escape(_short(load)) for load in model.loads) or "none",
        "walls": "<br>".join(
            f"{html.escape(name)}: {html.escape(_short(wall))}"
            for name, wall in step.walls.conditions.items()
        ),
        "mesh": f"{mesh.ne} cells in {mesh.dim}D, {layout.space.ndof} unknowns",
        "time": time,
    }
    return _table(rows)


def results_html(title: str, time: float, ledger: Mapping[str, np.ndarray]) -> str:
    """The contents of a run directory."""
    return _table({"run": html.escape(title), "state": f"t = {time:g} s"}) + ledger_html(ledger)


def ledger_html(ledger: Mapping[str, np.ndarray]) -> str:
    """A drawing of a ledger's energies over time, and a table of its last row's balance."""
    if not len(ledger["time"]):
        return "<div>no step yet</div>"
    shown = {
        "time": f"{ledger['time'][-1]:.6g} s",
        "kinetic": f"{ledger['kinetic'][-1]:.6e} J",
        "stored": f"{ledger['stored'][-1]:.6e} J",
        "largest |closure|": f"{abs(ledger['closure_relative']).max():.1e} of the energy",
        "mass drift": f"{ledger['mass_drift'][-1]:+.1e}",
    }
    return _curves(ledger) + _table(shown)


def _curves(ledger: Mapping[str, np.ndarray]) -> str:
    t = ledger["time"]
    if len(t) < 2:
        return ""
    curves = {"kinetic": ledger["kinetic"], "stored − initial": ledger["stored"] - ledger["stored"][0]}
    high = max(curve.max() for curve in curves.values())
    span = (high - min(curve.min() for curve in curves.values())) or 1.0
    X, parts = _WIDTH * (t - t[0]) / ((t[-1] - t[0]) or 1.0), []
    for i, ((name, curve), colour) in enumerate(zip(curves.items(), ("#1f77b4", "#ff7f0e"), strict=True)):
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(X, _HEIGHT * (high - curve) / span, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        parts.append(f'<text x="{4 + 80 * i}" y="{_HEIGHT + 16}" fill="{colour}">{name}</text>')
    size = f'width="{_WIDTH}" height="{_HEIGHT + 22}" viewBox="0 -2 {_WIDTH} {_HEIGHT + 24}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-size="12">{"".join(parts)}</svg>'


def _table(rows: Mapping[str, str]) -> str:
    cells = (
        f"<tr><th style='text-align:left'>{k}</th><td style='text-align:left'>{v}</td></tr>"
        for k, v in rows.items()
    )
    return f"<table>{''.join(cells)}</table>"


def _short(thing: object) -> str:
    text = re.sub(r"<[^<>]* at 0x[0-9a-f]+>", "a function", repr(thing))
    return text if len(text) <= 160 else text[:157] + "..."


def data_frame(columns: Mapping[str, np.ndarray]) -> Any:
    """The columns of a ledger as a pandas frame, with the step as index.

    Raises NotebookError when pandas is missing.
    """
    try:
        import pandas
    except ImportError as error:
        raise NotebookError("pandas is missing; run pip install pandas") from error
    return pandas.DataFrame(dict(columns)).set_index("step")

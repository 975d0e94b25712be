"""In notebooks: what a simulation, a ledger and results show of themselves, live progress, NGSolve's web
viewer."""

from __future__ import annotations

import html
import re
import time as clock
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Mesh

from ngvisco.errors import NgviscoError, ParameterError, UnknownNameError

if TYPE_CHECKING:
    from ngvisco.run.simulation import Simulation

_WIDTH, _HEIGHT = 420, 120


class NotebookError(NgviscoError, RuntimeError):
    """Something that a notebook needs is not installed."""


def draw(field: CoefficientFunction | str, where: Any = None, **options: Any) -> Any:
    """Show a field by NGSolve's viewer in the browser.

    Raises NotebookError, ParameterError or UnknownNameError if an argument is not what is said of it.

    Parameters
    ----------
    field : str or coefficient function
        A name out of ``where.fields``, or a function.
    where : Simulation, Results or ngsolve.Mesh, optional
        Not needed for a grid function, which knows its mesh.
    options
        As of ``ngsolve.webgui.Draw``: ``min``, ``max``, ``clipping``, ``deformation``, ``order``, ...

    Returns
    -------
    The viewer's scene, with ``Redraw()``.
    """
    fields: Mapping[str, CoefficientFunction] = getattr(where, "fields", {})
    name = options.pop("name", field if isinstance(field, str) else "field")
    if isinstance(field, str):
        if field not in fields:
            if not fields:
                raise ParameterError("draw.where", where, "a simulation or results, for a field by its name")
            raise UnknownNameError("field", field, fields)
        value = fields[field]
    else:
        value = field
    if not isinstance(value, CoefficientFunction):
        raise ParameterError("draw.field", field, "a name or a coefficient function")
    mesh = where if isinstance(where, Mesh) else getattr(where, "mesh", None)
    if mesh is None and isinstance(value, GridFunction):
        mesh = value.space.mesh
    if mesh is None:
        raise ParameterError("draw.where", where, "a mesh, a simulation or results")
    with np.errstate():  # importing the viewer silences numpy's warnings for the whole process
        try:
            from ngsolve.webgui import Draw
        except ImportError as error:
            raise NotebookError(f"NGSolve's viewer cannot be loaded ({error})") from error
        return Draw(value, mesh, name, **options)


class NotebookProgress:
    """An observer that redraws itself below a notebook's cell: a bar, the time, the energies, the closure.

    Raises NotebookError when IPython is missing.

    Parameters
    ----------
    until : float
        End time of the run, s.
    seconds : float
        Least time between two drawings, s.
    """

    def __init__(self, until: float, seconds: float = 0.5) -> None:
        if not (isinstance(until, (int, float)) and until > 0):
            raise ParameterError("NotebookProgress.until", until, "a finite number > 0")
        self.until, self.seconds = until, seconds
        self._display()

    @staticmethod
    def _display() -> tuple[Any, Any]:
        try:
            from IPython.display import HTML, display
        except ImportError as error:
            raise NotebookError("IPython is missing: pip install ipython") from error
        return HTML, display

    def start(self, simulation: Simulation) -> None:
        make, display = self._display()
        self._began, self._from, self._drawn = clock.perf_counter(), simulation.t, 0.0
        self._handle = display(make(self._page(simulation)), display_id=True)

    def step(self, simulation: Simulation, row: dict[str, float]) -> None:
        now = clock.perf_counter()
        if now - self._drawn >= self.seconds:
            self._drawn = now
            self._update(simulation)

    def finish(self, simulation: Simulation) -> None:
        self._update(simulation)

    def _update(self, simulation: Simulation) -> None:
        if self._handle is not None:  # there is none outside of a notebook
            self._handle.update(self._display()[0](self._page(simulation)))

    def _page(self, simulation: Simulation) -> str:
        share = min(1.0, simulation.t / self.until)
        spent = clock.perf_counter() - self._began
        covered = simulation.t - self._from
        left = f"{spent * (self.until - simulation.t) / covered:.0f} s left" if covered > 0 else "starting"
        bar = (
            '<div style="width:420px;border:1px solid #888;height:10px">'
            f'<div style="width:{100 * share:.1f}%;background:#31688e;height:10px"></div></div>'
        )
        return f"{bar}<div>step {simulation.step_number}, {left}</div>{ledger_html(simulation.ledger.rows)}"


def simulation_html(simulation: Simulation) -> str:
    """What a simulation is and how far it got."""
    layout, model = simulation.rothe_step.layout, simulation.model
    mechanisms = [
        f"{name} {html.escape(_short(part))}"
        for name in ("viscosity", "hyperviscosity", "creep", "regularisation")
        if (part := getattr(model, name)) is not None
    ]
    steps = "adaptive steps" if simulation.is_adaptive else f"steps of {simulation.dt:g} s"
    rows = {
        "material": html.escape(_short(model.material)),
        "mechanisms": "<br>".join(mechanisms) or "none",
        "loads": "<br>".join(html.escape(_short(load)) for load in model.loads) or "none",
        "walls": "<br>".join(
            f"{html.escape(name)}: {html.escape(_short(wall))}"
            for name, wall in simulation.rothe_step.walls.conditions.items()
        ),
        "mesh": f"{simulation.mesh.ne} cells in {simulation.mesh.dim}D, {layout.space.ndof} unknowns",
        "time": f"t = {simulation.t:g} s, step {simulation.step_number}, {steps}",
    }
    return _table(rows) + ledger_html(simulation.ledger.rows)


def results_html(title: str, time: float, ledger: Mapping[str, np.ndarray]) -> str:
    """What a run directory holds."""
    count = len(ledger["time"])
    rows = [{name: float(column[i]) for name, column in ledger.items()} for i in range(count)]
    return _table({"run": html.escape(title), "state": f"t = {time:g} s"}) + ledger_html(rows)


def ledger_html(rows: list[dict[str, float]]) -> str:
    """Energies over time as a drawing, and the last row's balance."""
    if not rows:
        return "<div>no step yet</div>"
    last = rows[-1]
    closure = max(abs(row["closure_relative"]) for row in rows)
    shown = {
        "time": f"{last['time']:.6g} s",
        "kinetic": f"{last['kinetic']:.6e} J",
        "stored": f"{last['stored']:.6e} J",
        "largest |closure|": f"{closure:.1e} of the energy",
        "mass drift": f"{last['mass_drift']:+.1e}",
    }
    return _curves(rows) + _table(shown)


def _curves(rows: list[dict[str, float]]) -> str:
    """Kinetic energy and the stored one's change over time, as an SVG."""
    if len(rows) < 2:
        return ""
    t = np.array([row["time"] for row in rows])
    curves = {
        "kinetic": np.array([row["kinetic"] for row in rows]),
        "stored − initial": np.array([row["stored"] - rows[0]["stored"] for row in rows]),
    }
    values = np.concatenate(list(curves.values()))
    low, high = values.min(), values.max()
    span, length = (high - low) or 1.0, (t[-1] - t[0]) or 1.0
    parts = []
    for (name, curve), colour in zip(curves.items(), ("#1f77b4", "#ff7f0e"), strict=True):
        X, Y = _WIDTH * (t - t[0]) / length, _HEIGHT * (high - curve) / span
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(X, Y, strict=True))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        parts.append(
            f'<text x="{4 + 80 * (len(parts) // 2)}" y="{_HEIGHT + 16}" fill="{colour}">{name}</text>'
        )
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
    """Columns of a ledger as a pandas frame, with the step as index.

    Raises NotebookError when pandas is missing.
    """
    try:
        import pandas
    except ImportError as error:
        raise NotebookError("pandas is missing: pip install pandas") from error
    return pandas.DataFrame(dict(columns)).set_index("step")

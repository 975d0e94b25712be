"""Pictures of a run, drawn without a display (needs the extra ``plots``: matplotlib)."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule, Mesh, x, y

from ngvisco.errors import NgviscoError, ParameterError
from ngvisco.forms.mesh_arrays import coordinates
from ngvisco.run.files import write_atomically

if TYPE_CHECKING:
    from ngvisco.run.ledger import Ledger


class PlotError(NgviscoError, RuntimeError):
    """A picture cannot be drawn (matplotlib missing)."""


def figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A matplotlib figure on the Agg canvas and its axes, (rows, columns); never opens a window."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PlotError('matplotlib is missing: pip install "ngvisco[plots]"') from error
    result = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(result)
    return result, result.subplots(rows, columns, squeeze=False)


def plot_energies(ledger: Ledger, path: str | os.PathLike[str]) -> None:
    """Energies and what was exchanged, and the closure, over time, as PNG.

    Stored energy is drawn as its change since the start: its constant part is arbitrary.
    """
    fig, ((above,), (below,)) = figure(2, 1, (8, 7))
    t = ledger.column("time")
    above.plot(t, ledger.column("kinetic"), label="kinetic")
    above.plot(t, ledger.column("stored") - ledger.column("stored")[0], label="stored − initial")
    dt = ledger.column("dt")
    for entry in ledger.entries:
        rate = ledger.column(entry.name) * (1 if entry.kind == "numerical" else dt)
        label = entry.name.replace("_", " ")
        label = f"numerical: {label}" if entry.kind == "numerical" else label
        above.plot(t, np.cumsum(rate), "--" if entry.kind == "power" else ":", label=f"∫ {label}")
    above.set_ylabel("energy, J")
    above.legend(fontsize="small", ncols=2)
    closure = np.abs(ledger.column("closure_relative"))[1:]
    below.semilogy(t[1:], np.maximum(closure, 1e-18), "k.", label="|closure|, relative")
    below.set(xlabel="time, s", ylabel="relative", ylim=(1e-18, 1e-8))
    drift = np.maximum(np.abs(ledger.column("mass_drift"))[1:], 1e-18)
    below.semilogy(t[1:], drift, "r+", label="|mass drift|")
    below.legend(fontsize="small")
    _save(fig, path)


def plot_history(ledger: Ledger, path: str | os.PathLike[str]) -> None:
    """Dissipations and powers, extrema, iterations and step lengths over time, as PNG."""
    fig, axes = figure(2, 2, (12, 8))
    (rates, extrema), (effort, steps) = axes
    t = ledger.column("time")
    for entry in ledger.entries:
        if entry.kind != "numerical":
            style = "--" if entry.kind == "power" else "-"
            rates.plot(t, ledger.column(entry.name), style, label=entry.name.replace("_", " "))
    rates.set(title="dissipations and powers", ylabel="W")
    for name, label in (("rho_min", "min ρ, kg/m³"), ("rho_max", "max ρ, kg/m³"), ("J_min", "min J")):
        if not np.isnan(ledger.column(name)).all():
            extrema.plot(t, ledger.column(name), label=label)
    extrema.plot(t, ledger.column("v_max"), ":", label="max |v|, m/s")
    extrema.set(title="extrema")
    effort.plot(t[1:], ledger.column("newton_iterations")[1:], ".-", label="Newton iterations")
    effort.plot(t[1:], ledger.column("rejections")[1:], ".", label="rejected attempts")
    effort.set(title="effort of each step", xlabel="time, s")
    steps.semilogy(t[1:], ledger.column("dt")[1:], label="step length, s")
    steps.semilogy(t[1:], np.maximum(ledger.column("cfl")[1:], 1e-16), label="CFL number")
    steps.set(title="steps", xlabel="time, s")
    for axis in axes.ravel():
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize="small")
    _save(fig, path)


def plot_fields(
    mesh: Mesh,
    fields: Sequence[tuple[str, CoefficientFunction]],
    path: str | os.PathLike[str],
    plane: float = 0.5,
    subdivisions: int = 3,
) -> None:
    """Scalar fields side by side, as PNG; in 3D on a plane of constant z.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    fields : sequence of (title, scalar coefficient function)
    path : path of the PNG
    plane : float
        In 3D, height of the plane as a fraction of the mesh's extent in z.
    subdivisions : int
        In 2D every cell is drawn as subdivisions^2 triangles, so that jumps between cells show.
    """
    for title, value in fields:
        if value.dim != 1:
            raise ParameterError(f"plot_fields field {title!r}", value.dim, "a scalar")
    count = len(fields)
    corners = coordinates(mesh)
    extent = corners.max(axis=0) - corners.min(axis=0)
    height = 1.2 + 3.6 * min(max(extent[1] / extent[0], 0.3), 2.0)
    fig, ((*axes,),) = figure(1, count, (5.0 * count, height))
    draw = _draw_plane if mesh.dim == 3 else _draw_cells
    option = plane if mesh.dim == 3 else subdivisions
    for axis, (title, value) in zip(axes, fields, strict=True):
        image = draw(axis, mesh, value, option)
        axis.set(title=title, aspect="equal", xlabel="x, m", ylabel="y, m")
        fig.colorbar(image, ax=axis, shrink=0.8)
    _save(fig, path)


def _draw_cells(axis: Any, mesh: Mesh, value: CoefficientFunction, subdivisions: float) -> Any:
    """Every triangle (or quadrilateral) by its own points: nothing is averaged between cells."""
    n = int(subdivisions)
    lattice = [(i / n, j / n) for j in range(n + 1) for i in range(n + 1 - j)]
    index = {p: k for k, p in enumerate((i, j) for j in range(n + 1) for i in range(n + 1 - j))}
    small = []
    for i, j in index:
        if i + j < n:
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
        if i + j < n - 1:
            small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    rule = IntegrationRule(lattice, [0.0] * len(lattice))
    points = mesh.MapToAllElements({ET.TRIG: rule, ET.QUAD: rule}, VOL)
    X, Y, values = (np.asarray(f(points)).ravel() for f in (x, y, value))
    cells = len(X) // len(lattice)
    triangles = np.add.outer(np.arange(cells) * len(lattice), np.array(small)).reshape(-1, 3)
    return axis.tripcolor(X, Y, triangles, values, shading="gouraud", cmap="viridis")


def _draw_plane(axis: Any, mesh: Mesh, value: CoefficientFunction, fraction: float) -> Any:
    corners = coordinates(mesh)
    low, high = corners.min(axis=0), corners.max(axis=0)
    inset = 1e-9 * (high - low)
    xs, ys = (np.linspace(low[i] + inset[i], high[i] - inset[i], 81) for i in range(2))
    X, Y = np.meshgrid(xs, ys)
    height = low[2] + fraction * (high[2] - low[2])
    values = np.full(X.size, np.nan)
    for k, (px, py) in enumerate(zip(X.ravel(), Y.ravel(), strict=True)):
        if mesh.Contains(px, py, height):
            values[k] = value(mesh(px, py, height))
    return axis.pcolormesh(X, Y, values.reshape(X.shape), shading="gouraud", cmap="viridis")


def _save(fig: Any, path: str | os.PathLike[str]) -> None:
    image = io.BytesIO()
    fig.savefig(image, dpi=110, format="png")
    write_atomically(Path(path), image.getvalue())

"""Plots of runs over time, and comparisons of runs, without a display (extra ``plots``: matplotlib).

Pictures are PNG, PDF or SVG by the suffix of their path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ngvisco.errors import CheckpointError, ParameterError, UnknownNameError, require_type
from ngvisco.forms.term import PRODUCTION
from ngvisco.run.fields import USUAL, field_unit
from ngvisco.run.files import AnyPath
from ngvisco.run.ledger import Ledger
from ngvisco.run.pictures import LABELS, PAGE, figure, save, widened
from ngvisco.run.series import read_columns
from ngvisco.run.snapshot import read_ledger
from ngvisco.timestepping.integrator import LIMITER, LIMITER_WALLS

_OF_ENERGY = ("dissipation", "power")
"""Kinds of entries in W; other kinds are states, entropies, masses."""
_PANELS = {
    "least and largest density, kg/m³": ["rho_min", "rho_max"],
    "least J": ["J_min"],
    "largest |v|, m/s": ["v_max"],
    "Newton iterations of a step": ["newton_iterations"],
    "rejected attempts of a step": ["rejections"],
    "step length, s": ["dt"],
    "Courant number |v| dt/h": ["cfl"],
}
_OF_STEPS = ("newton_iterations", "rejections", "dt", "cfl")
"""Columns that belong to a step, so that the initial row does not have them."""
_OF_BODIES = {"x": "m", "y": "m", "z": "m", "kinetic": "J", "stored": "J"}
_MOST = 16
"""Largest number of axes in a picture; further columns are left out."""


def plot_energies(ledger: Ledger, path: AnyPath) -> None:
    """Plot energies, exchanged energy and the closure over time, as PNG, PDF or SVG by the path's suffix.

    Stored energy is drawn as its change since the start, since its constant part is arbitrary.  Raises
    ParameterError for a ledger without steps; PlotError.
    """
    _require_steps("plot_energies.ledger", ledger)
    fig, ((above,), (below,)) = figure(2, 1, (PAGE, 7.5))
    t, stored = ledger.column("time"), ledger.column("stored")
    above.plot(t, ledger.column("kinetic"), label="kinetic")
    above.plot(t, stored - stored[0], label="stored − initial")
    for entry in ledger.entries:
        label, column = entry.name.replace("_", " "), ledger.column(entry.name)
        # this column is a part of the stored energy
        if entry.kind == "monitor" and entry.name.startswith("stored_"):
            above.plot(t, column - column[0], "-.", label=f"{label} − initial")
        elif entry.kind in _OF_ENERGY:
            style = "--" if entry.kind == "power" else ":"
            above.plot(t, ledger.exchanged(entry.name), style, label=f"∫ {label}")
        elif entry.kind == "numerical" and (entry.name not in (LIMITER, LIMITER_WALLS) or column.any()):
            above.plot(t, ledger.exchanged(entry.name), ":", label=f"∫ numerical: {label}")
    above.set_ylabel("energy, J")
    above.legend(fontsize=LABELS, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for name, style, label in (
        ("closure_relative", "k.", "|closure|, relative"),
        ("mass_drift", "r+", "|mass drift|"),
    ):
        below.semilogy(t[1:], np.maximum(np.abs(ledger.column(name))[1:], 1e-18), style, label=label)
    below.set(xlabel="time, s", ylabel="relative", ylim=(1e-18, 1e-8))
    below.legend(fontsize=LABELS)
    save(fig, path)


def plot_schemes(ledgers: Mapping[str, Ledger], path: AnyPath) -> None:
    """Plot kinetic energies of runs by different time schemes, and each scheme's and model's dissipation.

    Raises ParameterError for a ledger without steps.

    Parameters
    ----------
    ledgers : mapping of labels to ledgers
        At most four ledgers, drawn solid, dashed, dotted and dash-dotted.
    path : path
        The picture's file.
    """
    for label, ledger in ledgers.items():
        _require_steps(f"plot_schemes.ledgers[{label!r}]", ledger)
    fig, ((left, right),) = figure(1, 2, (11, 4.6))
    for (label, ledger), style in zip(ledgers.items(), ("-", "--", ":", "-."), strict=False):
        t = ledger.column("time")
        left.plot(t, ledger.column("kinetic"), f"C0{style}", label=label)
        for kind, whose, color in (("dissipation", "model", "C1"), ("numerical", "scheme", "C3")):
            dissipated = ledger.exchanged(*(entry.name for entry in ledger.entries if entry.kind == kind))
            right.plot(t, dissipated, color + style, label=f"{label}, by the {whose}: {dissipated[-1]:.2g} J")
    for axis, title in ((left, "kinetic energy, J"), (right, "dissipated, J")):
        axis.set(title=title, xlabel="time, s")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    save(fig, path)


def plot_history(ledger: Ledger, path: AnyPath) -> None:
    """Plot dissipations and powers, extrema, iterations and step lengths over time, each in its own axes.

    A run with heat also has axes of the production of entropy and of the temperature.  Formats are those of
    ``plot_energies``.  A quantity that varies by rounding only is drawn as a horizontal line.
    """
    _require_steps("plot_history.ledger", ledger)
    kinds = {entry.name: entry.kind for entry in ledger.entries}
    rates = [name for name, kind in kinds.items() if kind in _OF_ENERGY]
    panels = {"dissipations and powers, W": rates, **_PANELS}
    if "temperature_min" in ledger.columns:
        panels["production of entropy, W/K"] = [name for name in kinds if name.startswith(PRODUCTION)]
        panels["least and largest temperature, K"] = ["temperature_min", "temperature_max"]
    fig, axes = figure(len(panels) // 2, 2, (PAGE, 1.2 * len(panels) - 0.1))
    t = ledger.column("time")
    for axis, (title, names) in zip(axes.ravel(), panels.items(), strict=True):
        for name in names:
            values, of_steps = ledger.column(name), name in _OF_STEPS
            first = int(of_steps or name in kinds)  # there is no rate before the first step
            style = "--" if kinds.get(name) == "power" else "." if of_steps and len(t) < 200 else "-"
            axis.plot(t[first:], values[first:], style, label=name.removeprefix(PRODUCTION).replace("_", " "))
            if of_steps:
                axis.set_ylim(0, 1.1 * float(values[1:].max()) or 1.0)
            if np.isnan(values).all():
                where = {"ha": "center", "va": "center", "transform": axis.transAxes}
                axis.text(0.5, 0.5, "the material has no such quantity", **where)
        axis.set(title=title, ylim=widened(*axis.get_ylim()))
        if kinds.keys() & set(names):
            axis.legend(fontsize=LABELS)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    save(fig, path)


def _require_steps(field: str, ledger: Ledger) -> None:
    require_type(field, ledger, Ledger)
    if len(ledger.rows) < 2:
        raise ParameterError(field, "a ledger without steps", "a ledger with at least one step")


def plot_comparison(
    runs: Mapping[str, AnyPath], out: AnyPath, fields: Sequence[str] | None = None, kind: str = "png"
) -> list[Path]:
    """Compare at least two runs, given as directories by label; write pictures to ``out`` and return their
    paths.

    The pictures are ``comparison-energies``, and ``-probes`` and ``-bodies`` with columns that all runs have;
    ``kind`` is "png", "pdf" or "svg".  ``fields`` are fields or components of the probes; default density, J,
    velocity, pressure and von Mises stress.  Raises ParameterError, UnknownNameError, CheckpointError,
    PlotError.
    """
    if len(runs) < 2:
        raise ParameterError("plot_comparison.runs", list(runs), "at least two runs")
    places = {label: Path(place) for label, place in runs.items()}
    probes = {label: _probes(place) for label, place in places.items()}
    pictures = {
        "energies": {label: _energies(place) for label, place in places.items()},
        "probes": {label: _of_fields(table, fields) for label, table in probes.items()},
        "bodies": {label: _bodies(place) for label, place in places.items()},
    }
    written = {}
    for name, tables in pictures.items():
        first, *later = tables.values()
        common = [column for column in first if all(column in table for table in later) and column != "time"]
        if common:
            written[name] = Path(out) / f"comparison-{name}.{kind}"
            _draw(tables, common[:_MOST], written[name])
    if fields is not None and "probes" not in written:
        field_names = {column.partition(".")[2] for table in probes.values() for column in table}
        raise UnknownNameError("field of the probes", ", ".join(fields), field_names - {""}, "fields")
    return list(written.values())


def _draw(tables: Mapping[str, dict[str, np.ndarray]], columns: Sequence[str], path: Path) -> None:
    """Draw columns of all tables over time, an axis for each column."""
    rows = -(-len(columns) // 2)
    fig, axes = figure(rows, min(len(columns), 2), (PAGE, 2.3 * rows + 0.25 * len(tables) + 0.4))
    for axis, name in zip(axes.ravel(), columns, strict=False):
        for number, (label, table) in enumerate(tables.items()):
            style = ("-", "--", "-.", ":")[number // 10 % 4]
            axis.plot(table["time"], table[name], f"C{number % 10}{style}", label=label)
        axis.set(title=name.replace("_", " "), ylim=widened(*axis.get_ylim()))
    for axis in axes.ravel()[len(columns) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    ncols = 1 if max(map(len, labels)) > 30 else 2
    fig.legend(handles, labels, loc="outside lower center", ncols=ncols, fontsize=LABELS)
    save(fig, path)


def _energies(place: Path) -> dict[str, np.ndarray]:
    path = place / "run.h5"
    if not path.exists():
        raise CheckpointError(f"{place}: this is not a run directory with results, since run.h5 is missing")
    ledger = read_ledger(path)
    columns = {"time": ledger["time"], "kinetic energy, J": ledger["kinetic"]}
    columns["stored energy − initial, J"] = ledger["stored"] - ledger["stored"][0]
    for prefix, title in (("dissipation_", "dissipated, J"), ("power_", "work of loads and walls, J")):
        rates = [column for name, column in ledger.items() if name.startswith(prefix)]
        if rates:
            columns[title] = np.cumsum(ledger["dt"] * sum(rates))
    return columns


def _probes(place: Path) -> dict[str, np.ndarray]:
    """The columns of all probes, without those of lines, forces and integrals."""
    columns: dict[str, np.ndarray] = {}
    for path in sorted((place / "samples").glob("*.csv")):
        table = read_columns(path)
        if any(column.startswith(f"{path.stem}.") for column in table):
            columns = table | columns
    return columns


def _of_fields(probes: dict[str, np.ndarray], fields: Sequence[str] | None) -> dict[str, np.ndarray]:
    """The times, and the columns of the named fields or components, with their units."""
    chosen, columns = USUAL if fields is None else fields, {}
    for column, values in probes.items():
        field = column.partition(".")[2]
        if column == "time" or field in chosen or field.rpartition("_")[0] in chosen:
            unit = field_unit(field)
            columns[f"{column}, {unit}" if unit else column] = values
    return columns


def _bodies(place: Path) -> dict[str, np.ndarray]:
    path = place / "bodies.csv"
    table = read_columns(path) if path.exists() else {}
    columns = {}
    for name, values in table.items():
        unit = _OF_BODIES.get(name.rpartition("_")[2])
        if "_" in name and unit is not None and "_momentum_" not in name:
            columns[f"{name}, {unit}"] = values
    return columns | {"time": table["time"]} if columns else {}

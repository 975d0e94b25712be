"""Pictures of several runs, each quantity in an axis of its own: energies, probes, bodies over time."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ngvisco.errors import CheckpointError, ParameterError, UnknownNameError
from ngvisco.run.checkpoint import read_ledger
from ngvisco.run.fields import USUAL, field_unit
from ngvisco.run.plots import LABELS, PAGE, figure, save, widened
from ngvisco.run.series import read_columns

_OF_BODIES = ("x", "y", "z", "kinetic", "stored")
_MOST = 16
"""Axes of a picture; more fields have to be chosen from."""

Table = Mapping[str, np.ndarray]


def plot_comparison(
    runs: Mapping[str, str | os.PathLike[str]],
    out: str | os.PathLike[str],
    fields: Sequence[str] | None = None,
    kind: str = "png",
) -> list[Path]:
    """Compare runs: ``comparison-energies``, and ``-probes`` and ``-bodies`` of what all of them measure.

    Raises ParameterError, UnknownNameError, CheckpointError, PlotError.

    Parameters
    ----------
    runs : mapping of labels to run directories
        At least two.
    out : path
        The directory of the pictures, made if missing.
    fields : sequence of str, optional
        Of the probes: fields or components; default density, J, velocity, pressure and von Mises stress.
    kind : str
        ``"png"``, ``"pdf"`` or ``"svg"``.

    Returns
    -------
    list of Path
        What was written.
    """
    if len(runs) < 2:
        raise ParameterError("plot_comparison.runs", list(runs), "at least two runs")
    places = {label: Path(place) for label, place in runs.items()}
    written = []
    pictures = {"energies": {label: _energies(place) for label, place in places.items()}}
    probes = {label: _probes(place, fields) for label, place in places.items()}
    bodies = {label: _bodies(place) for label, place in places.items()}
    for name, tables in (pictures | {"probes": probes, "bodies": bodies}).items():
        first, *others = tables.values()
        common = [column for column in first if all(column in table for table in others) and column != "time"]
        if common:
            path = Path(out) / f"comparison-{name}.{kind}"
            _draw(tables, common[:_MOST], path)
            written.append(path)
    if fields is not None and not any(path.stem == "comparison-probes" for path in written):
        known = {column.partition(".")[2] for table in map(_all_probes, places.values()) for column in table}
        raise UnknownNameError("field of the probes", ", ".join(fields), known - {""})
    return written


def _draw(tables: Mapping[str, Table], columns: Sequence[str], path: Path) -> None:
    rows = -(-len(columns) // 2)
    wide = min(len(columns), 2)
    fig, axes = figure(rows, wide, (PAGE, 2.3 * rows + 0.25 * len(tables) + 0.4))
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


def _energies(place: Path) -> Table:
    """Energies, J, and what was dissipated and done since the start."""
    path = place / "run.h5"
    if not path.exists():
        raise CheckpointError(f"{place}: not a run directory with results (no run.h5)")
    ledger = read_ledger(path)
    found = {"time": ledger["time"], "kinetic energy, J": ledger["kinetic"]}
    found["stored energy − initial, J"] = ledger["stored"] - ledger["stored"][0]
    for what, title in (("dissipation_", "dissipated, J"), ("power_", "work of loads and walls, J")):
        rates = [column for name, column in ledger.items() if name.startswith(what)]
        if rates:
            found[title] = np.cumsum(ledger["dt"] * sum(rates))
    return found


def _probes(place: Path, fields: Sequence[str] | None) -> Table:
    every = _all_probes(place)

    def is_wanted(column: str) -> bool:
        field = column.partition(".")[2]
        names = USUAL if fields is None else fields
        return field in names or field.rpartition("_")[0] in names

    wanted = {column: values for column, values in every.items() if column == "time" or is_wanted(column)}
    return {_with_unit(column): values for column, values in wanted.items()}


def _with_unit(column: str) -> str:
    field = column.partition(".")[2]
    unit = field_unit(field) if field else ""
    return f"{column}, {unit}" if unit else column


def _all_probes(place: Path) -> dict[str, np.ndarray]:
    """The columns of all probes; those of lines, forces and integrals are none."""
    found: dict[str, np.ndarray] = {}
    for path in sorted((place / "samples").glob("*.csv")):
        table = _columns(path)
        if any(column.startswith(f"{path.stem}.") for column in table):
            found |= {name: values for name, values in table.items() if name != "step" and name not in found}
    return found


def _bodies(place: Path) -> Table:
    path = place / "bodies.csv"
    table = _columns(path) if path.exists() else {}
    ends = tuple(f"_{quantity}" for quantity in _OF_BODIES)
    kept = {n: values for n, values in table.items() if n.endswith(ends) and "_momentum_" not in n}
    units = {"kinetic": "J", "stored": "J"}
    named = {f"{n}, {units.get(n.rpartition('_')[2], 'm')}": values for n, values in kept.items()}
    return named | {"time": table["time"]} if named else {}


def _columns(path: Path) -> dict[str, np.ndarray]:
    """The columns of a table by name; raises CheckpointError where it is none."""
    head, rows = read_columns(path)
    return dict(zip(head, rows.T, strict=True))

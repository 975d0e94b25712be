"""Columns of a run over time, by name, from the ledger and from observers' tables."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError, UnknownNameError
from ngvisco.run.body_tables import Bodies
from ngvisco.run.fields import field_unit
from ngvisco.run.ledger import unit
from ngvisco.run.momentum import SIZE
from ngvisco.run.probes import Integrals, Probes, WallForces
from ngvisco.run.series import Series
from ngvisco.run.simulation import Simulation

_TABLES = (Probes, Integrals, WallForces, Bodies)
_RATES = ("dissipation", "power", "production", "flux")


def tables_of(simulation: Simulation) -> list[Series]:
    """Copies of the tables among a run's observers; the copies write no files."""
    tables: list[Series] = []
    for observer in simulation.observers:
        if isinstance(observer, _TABLES):
            table = copy.copy(observer)
            table.path, table.rows = None, []
            tables.append(table)
    return tables


def arguments_of(table: Series) -> dict[str, Any]:
    """A table's class and the arguments that say what it measures, by name."""
    names = sorted(set(inspect.signature(type(table)).parameters) - {"path", "every"})
    return {"kind": type(table).__name__, **{name: getattr(table, name) for name in names}}


class Columns:
    """Values of columns at the present state of a simulation.

    Raises UnknownNameError for an unknown column, ParameterError for a column without a derivative.
    """

    has_ends = has_means = True
    """Whether values at the ends of steps are read, and whether means over stages are."""

    def __init__(self, simulation: Simulation, names: Sequence[str], tables: Sequence[Series]) -> None:
        self.simulation, self.names = simulation, list(names)
        ledger = simulation.ledger
        self._tables = [copy.copy(table) for table in tables]
        of_tables = [table.prepare(simulation) for table in self._tables]
        rates = {entry.name for entry in ledger.entries if entry.kind in _RATES}
        state = {"kinetic", "stored", "mass"} | {e.name for e in ledger.entries if e.kind == "monitor"}
        state |= set(ledger.momentum.densities()) - {SIZE}  # the size has a kink at rest
        differentiable = rates | state | {name for columns in of_tables for name in columns}
        jumping: dict[str, str] = {}
        for table in self._tables:
            jumping |= table.jumping if isinstance(table, Bodies) else {}
        for name in self.names:
            if name in jumping:
                raise ParameterError("of", name, f"a column that has a derivative: {jumping[name]}")
            if name in ledger.columns and name not in differentiable:
                expected = (
                    "a column that has a derivative: an energy, a rate, mass, momentum, or one of a table"
                )
                raise ParameterError("of", name, expected)
            if name not in differentiable:
                raise UnknownNameError("column", name, differentiable)
        self._of_state = np.array([name in state for name in names])
        self._of_rates = np.array([name in rates for name in names])
        self._of_tables = [
            (table, columns, [columns.index(n) if n in columns else -1 for n in names])
            for table, columns in zip(self._tables, of_tables, strict=True)
            if set(names) & set(columns)
        ]

    def unit(self, name: str) -> str | None:
        """SI unit of a column; None if it is unknown, as for an integral of an expression."""
        for table, columns, _ in self._of_tables:
            if name in columns:
                return _unit_of(table, name)
        return unit(name)

    @property
    def tables(self) -> list[Series]:
        """Tables that contain some of the columns."""
        return [table for table, *_ in self._of_tables]

    def of(self, simulation: Simulation) -> Columns:
        """The columns of another run with equal mesh and model."""
        columns = Columns(simulation, self.names, self.tables)
        columns.has_ends, columns.has_means = self.has_ends, self.has_means
        return columns

    @property
    def is_of_stages(self) -> np.ndarray:
        """Whether each column is a mean over a step's stages, as rates and forces are, (columns,)."""
        mask = self._of_rates.copy()
        for table, _, places in self._of_tables:
            if isinstance(table, WallForces):
                mask |= np.array(places) >= 0
        return mask

    def begin(self) -> None:
        """Begin a step."""
        for table, *_ in self._of_tables:
            if isinstance(table, WallForces):
                table.begin()

    def stage(self, share: float) -> np.ndarray:
        """Contribution of a stage, the present state, to the columns' means over stages, (columns,).

        The contribution is ``share`` times the column's value.
        """
        values = self._values(self._of_state, self._of_rates)
        for table, _, places in self._of_tables:
            if isinstance(table, WallForces):
                table.begin()
                table.stage(np.zeros(0), 1.0)
            self._put(values, table, places)
        return share * values

    def impulse(self, rows: np.ndarray, v: np.ndarray | None) -> np.ndarray:
        """Contributions to the columns by the walls' impulse over a step's length, ``rows`` of v, N.

        With ``v``, the velocity of the last stage, they include the impulse's power.
        """
        values = np.zeros(len(self.names))
        for name, (_, mask) in self.simulation.rothe_step.moving_walls.moving.items():
            column = f"power_wall_{name}"
            if v is not None and column in self.names:
                values[self.names.index(column)] = rows[mask] @ v[mask]
        for table, _, places in self._of_tables:
            if isinstance(table, WallForces):
                table.begin()
                self.simulation.integrator.impulse = rows
                table.end(np.zeros(0))
                self._put(values, table, places)
        return values

    def state(self) -> np.ndarray:
        """Values of the columns at a step's end, the present state, (columns,); zero for means over
        stages."""
        values = self._values(self._of_state, np.zeros_like(self._of_rates))
        for table, _, places in self._of_tables:
            if not isinstance(table, WallForces):
                self._put(values, table, places)
        return values

    def _values(self, of_state: np.ndarray, of_rates: np.ndarray) -> np.ndarray:
        values, ledger = np.zeros(len(self.names)), self.simulation.ledger
        for where, row in (
            (of_state, ledger.state() if of_state.any() else {}),
            (of_rates, ledger.rates() if of_rates.any() else {}),
        ):
            for i in np.flatnonzero(where):
                values[i] = row[self.names[i]]
        return values

    def _put(self, values: np.ndarray, table: Series, places: Sequence[int]) -> None:
        row = np.ravel(table.sample(self.simulation))
        for i, place in enumerate(places):
            if place >= 0:
                values[i] = row[place]


def _unit_of(table: Series, name: str) -> str | None:
    if isinstance(table, Bodies):
        return table.unit(name)
    if isinstance(table, WallForces):
        return "N m" if "torque" in name.rpartition(".")[2] else "N"
    return field_unit(name.rpartition(".")[2]) or "1" if isinstance(table, Probes) else None

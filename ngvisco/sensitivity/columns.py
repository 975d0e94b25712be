"""Columns of a run over time, by name, from the ledger and from observers' tables."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError, require_known
from ngvisco.forms.distance import NUMERICAL
from ngvisco.run.body_tables import Bodies
from ngvisco.run.extrema import Extrema
from ngvisco.run.fields import field_unit
from ngvisco.run.ledger import unit
from ngvisco.run.momentum import RELATIVE, SIZE
from ngvisco.run.probes import Integrals, Probes, WallForces
from ngvisco.run.series import Series
from ngvisco.run.simulation import Simulation

_TABLES = (Probes, Integrals, WallForces, Bodies)
_RATES = ("dissipation", "power", "production", "flux")
_COUNT, _ROUNDING = "this column is a count", "this column measures rounding"
_FROZEN = "derivatives treat the limiter's changes as constant"
_OF_MULTIPLIERS = "the end impulse of oblique and curved walls has none; take backward-euler or sdirk2"
_OF_LENGTH = "derivatives treat the lengths of steps as constant"
_REFUSED = {
    **dict.fromkeys(("newton_iterations", "rejections", "limited_cells", "passive_unsolved"), _COUNT),
    **dict.fromkeys(("closure", "closure_relative", "mass_drift"), _ROUNDING),
    SIZE: "this column has kinks where matter comes to rest",
    RELATIVE: "this column is relative to the largest values of all steps and directions",
}
"""Reasons why columns of the ledger have no derivative. Other columns without a derivative have the reason
``_FROZEN`` if they are entries of the balance, else ``_OF_LENGTH``."""
NORMS = ("J_defect", "defect_rms")
"""Columns of norms of defects; they have no derivative where they are zero."""


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
    """Class of a table, and the arguments that determine its columns, by name."""
    names = sorted(set(inspect.signature(type(table)).parameters) - {"path", "every"})
    return {"kind": type(table).__name__, **{name: getattr(table, name) for name in names}}


class Columns:
    """Values of columns at the present state of a simulation.

    Raises UnknownNameError for an unknown column, ParameterError for a column without a derivative.
    """

    has_ends = has_means = True
    """Whether a column needs values at the ends of steps, and whether it needs means over stages."""

    def __init__(self, simulation: Simulation, names: Sequence[str], tables: Sequence[Series]) -> None:
        self.simulation, self.names = simulation, list(names)
        ledger = simulation.ledger
        self._tables = [copy.copy(table) for table in tables]
        of_tables = [table.prepare(simulation) for table in self._tables]
        rates = {entry.name for entry in ledger.entries if entry.kind in _RATES}
        state = {"kinetic", "stored", "mass"} | {e.name for e in ledger.entries if e.kind == "monitor"}
        state |= set(ledger.momentum.densities()) - {SIZE}
        forces = set(ledger.momentum.of_steps)
        at_points, norms = ledger.extrema, set(NORMS)
        self.extrema = Extrema(ledger.sampler, at_points, self.names)
        of_ledger = rates | state | forces | {*at_points} | norms | {*NUMERICAL}
        differentiable = of_ledger | {name for columns in of_tables for name in columns}
        refused = {name: _REFUSED.get(name, _OF_LENGTH) for name in ledger.columns if name not in of_ledger}
        refused |= dict.fromkeys((e.name for e in ledger.entries if e.name in refused), _FROZEN)
        refused |= dict.fromkeys(
            ledger.momentum.balances, "this column is the change of the momentum minus the impulses"
        )
        if not simulation.integrator.scheme.ends_at_last_stage:
            beside = simulation.integrator.velocity.multiplied(simulation.rothe_step.moving_walls.moving)
            refused |= {f"power_wall_{name}": _OF_MULTIPLIERS for name in beside}
        for table in self._tables:
            refused |= table.jumping if isinstance(table, Bodies) else {}
        for name in self.names:
            if name in refused:
                raise ParameterError("of", name, f"a column that has a derivative, but {refused[name]}")
            require_known("column", [name], differentiable, "of")
            if (count := [*ledger.columns, *chain.from_iterable(of_tables)].count(name)) > 1:
                expected = f"the name of one column, but {count} columns have it; rename a table's column"
                raise ParameterError("of", name, expected)

        def mask(kind: Collection[str]) -> np.ndarray:
            return np.array([name in kind for name in names], dtype=bool)

        self._of_state, self._of_rates, self._of_forces = mask(state), mask(rates), mask(forces)
        self._of_extrema, self._of_norms = mask(self.extrema.names), mask(norms)
        self.is_of_steps = mask({*forces, *NUMERICAL})
        """Whether each column is an exchange in a step, (columns,).  Such a column is the step's length times
        a mean over stages."""
        self.has_distances = bool(mask(NUMERICAL).any())
        """Whether some columns are parts of the scheme's dissipation."""
        self._of_tables = [
            (table, columns, [columns.index(n) if n in columns else -1 for n in names])
            for table, columns in zip(self._tables, of_tables, strict=True)
            if set(names) & set(columns)
        ]

    def unit(self, name: str) -> str | None:
        """SI unit of a column; None if the unit is unknown, as for an integral of an expression."""
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
        """Whether each column is a mean over a step's stages, such as rates and forces, (columns,)."""
        mask = self._of_rates | self.is_of_steps
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
        ledger, values = self.simulation.ledger, self._of_fields()
        values += self._values(self._of_rates, ledger.powers)
        values += self._values(self._of_forces, ledger.momentum.forces)
        for table, _, places in self._of_tables:
            if isinstance(table, WallForces):
                table.begin()
                table.stage(np.zeros(0), 1.0)
            self._put(values, table, places)
        return share * values

    def impulse(self, rows: np.ndarray, v: np.ndarray | None) -> np.ndarray:
        """Contributions of the walls' impulse to the columns, (columns,).

        ``rows`` is the impulse divided by the step's length, N, in the rows of v.

        With ``v``, the velocity of the last stage, the contributions include the impulse's power.
        """
        values, momentum = np.zeros(len(self.names)), self.simulation.ledger.momentum
        if any(name in self.names for name in momentum.held):
            of_motions = momentum.impulses.of_rows(rows)
            for name, motion in momentum.held.items():
                if name in self.names:
                    values[self.names.index(name)] = of_motions[motion]
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

    def at_end(self, means: np.ndarray, of_state: np.ndarray, tau: float) -> np.ndarray:
        """Values of the columns at the end of a step of length ``tau``, (columns,).

        ``means`` are the means over stages, and ``of_state`` is the result of ``state``.  With derivatives of
        both, the result is the derivative of the values.
        """
        return np.where(self.is_of_stages, np.where(self.is_of_steps, tau * means, means), of_state)

    def state(self) -> np.ndarray:
        """Values of the columns at the present state, which ends a step, (columns,).

        Columns that are means over stages have the value zero.
        """
        values = self._of_fields()
        for table, _, places in self._of_tables:
            if not isinstance(table, WallForces):
                self._put(values, table, places)
        return values

    def _of_fields(self) -> np.ndarray:
        """Values of those ledger columns that the present state determines; zero for other columns."""
        return (
            self._values(self._of_state, self.simulation.ledger.state)
            + self._values(self._of_extrema, self.extrema.values)
            + self._values(self._of_norms, self._norms)
        )

    def _norms(self) -> dict[str, float]:
        gap, of_pairs = self.simulation.ledger.defect_norms()
        return dict(zip(NORMS, (gap, of_pairs.max(initial=0.0)), strict=True))

    def _values(self, mask: np.ndarray, read: Callable[[], Mapping[str, float]]) -> np.ndarray:
        """Values of the columns in ``mask``; zero for other columns."""
        row = read() if mask.any() else {}
        return np.array(
            [row[name] if is_read else 0.0 for name, is_read in zip(self.names, mask, strict=True)]
        )

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

"""The energy ledger: one row a step, closing to rounding.

    E - E_old + tau (sum of dissipations - sum of powers) + inertial + bregman = closure

is zero for the exact solution of a step (paper: Euler-ED-basic-energy-balance-disc and
Euler-large-energy-balance-disc, with their inequalities' remainders written out).  ``inertial`` =
1/2 int rho_old |v - v_old|^2 and ``bregman`` = int phi(z_old) - phi(z) - phi'(z):(z_old - z) are what
the implicit step dissipates numerically; bregman >= 0 where the energy is convex.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, sqrt

from ngvisco.errors import UnknownNameError
from ngvisco.forms.context import Entry, Integrand, Kind
from ngvisco.forms.sampling import Sampler
from ngvisco.forms.system import Step
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian, ReciprocalJacobian
from ngvisco.run.notebook import data_frame, ledger_html

UNITS = {
    "step": "1",
    "time": "s",
    "dt": "s",
    "closure_relative": "1",
    "mass": "kg",
    "mass_drift": "1",
    "rho_min": "kg/m^3",
    "rho_max": "kg/m^3",
    "J_min": "1",
    "J_defect": "m^(d/2)",
    "v_max": "m/s",
    "newton_iterations": "1",
    "rejections": "1",
    "cfl": "1",
    "density_diffusion": "kg^2/m^3/s",
    "cutoff_volume": "m^3",
}
"""Units of the columns that are neither energies (J) nor powers (W)."""


TRANSFER = "transfer"
"""Energy lost where a state was carried over to another mesh or other parameters, J."""


def unit(column: str) -> str:
    """The SI unit of a ledger column (per metre of thickness in plane strain)."""
    if column.startswith(("dissipation_", "power_")):
        return "W"
    return UNITS.get(column, "J")


@dataclass(frozen=True)
class Balance:
    """The part of a ledger that a restart needs, to go on without a seam."""

    energy: float
    mass: float
    initial_mass: float


class Ledger:
    """Evaluates a row after every step.

    Attributes
    ----------
    columns : list of str
    rows : list of dict
        One for every step so far, and row 0 for the initial state.
    """

    def __init__(self, step: Step, sampler: Sampler) -> None:
        self.step, self.sampler = step, sampler
        self.entries = step.entries()
        _check_names(self.entries)
        self._cells, self._cell_names = self._cell_integrands()
        self._facets = [
            (e.name, e.integrand.facets.Compile()) for e in self.entries if e.integrand.facets is not None
        ]
        self._monitors = self._monitor_functions()
        self.rows: list[dict[str, float]] = []
        self.balance: Balance | None = None

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in the order of the CSV file."""
        return [
            *("step", "time", "dt", "kinetic", "stored"),
            *(entry.name for entry in self.entries),
            *("closure", "closure_relative", "mass", "mass_drift"),
            *("rho_min", "rho_max", "J_min", "J_defect", "v_max", "newton_iterations", "rejections"),
            "cfl",
        ]

    def column(self, name: str) -> np.ndarray:
        """A column over all rows so far."""
        if name not in self.columns:
            raise UnknownNameError("ledger column", name, self.columns)
        return np.array([row[name] for row in self.rows])

    def frame(self) -> Any:
        """All rows as a pandas frame, with the step as index; NotebookError where pandas is missing."""
        return data_frame({name: self.column(name) for name in self.columns})

    def _repr_html_(self) -> str:
        return ledger_html(self.rows)

    def start(self, time: float) -> dict[str, float]:
        """Row 0: the initial state, with no exchange."""
        values = self._integrals()
        energy = values["kinetic"] + values["stored"]
        self.balance = Balance(energy, values["mass"], values["mass"])
        idle = dict.fromkeys((entry.name for entry in self.entries), 0.0)
        row = {"step": 0, "time": time, "dt": 0.0, **values, **idle, "closure": 0.0}
        return self._append(row | {"closure_relative": 0.0, "mass_drift": 0.0}, 0, 0, 0.0)

    def resume(self, balance: Balance, rows: list[dict[str, float]]) -> None:
        """Go on from a checkpoint's balance and the rows up to its step."""
        self.balance, self.rows = balance, rows

    def energy(self) -> float:
        """Kinetic plus stored energy at the present state, J."""
        values = self._integrals()
        return values["kinetic"] + values["stored"]

    def keep(self, row: Mapping[str, float]) -> None:
        """Have entries of value 0 for what an earlier part of the run exchanged and this one does not."""
        for name in row:
            if name not in self.columns and name.startswith(("dissipation_", "power_", TRANSFER)):
                kind: Kind = "numerical" if name == TRANSFER else "dissipation"
                kind = "power" if name.startswith("power_") else kind
                self.entries.append(Entry(name, kind, Integrand(), lambda: 0.0))

    def record(
        self, number: int, time: float, tau: float, iterations: int, rejections: int = 0
    ) -> dict[str, float]:
        """The row of the step that has just been solved, from ``time - tau`` to ``time``."""
        assert self.balance is not None
        values = self._integrals()
        energy = values["kinetic"] + values["stored"]
        dissipated, worked = self._sum(values, "dissipation"), self._sum(values, "power")
        remainder = self._sum(values, "numerical")
        closure = energy - self.balance.energy + tau * (dissipated - worked) + remainder
        physical = [e.name for e in self.entries if e.kind in ("dissipation", "power")]
        exchanged = tau * sum(abs(values[name]) for name in physical)
        scale = max(abs(energy), abs(self.balance.energy), exchanged)
        drift = (values["mass"] - self.balance.initial_mass) / self.balance.initial_mass
        self.balance = Balance(energy, values["mass"], self.balance.initial_mass)
        row = {
            **{"step": number, "time": time, "dt": tau, **values},
            **{"closure": closure, "closure_relative": closure / scale if scale else closure},
            "mass_drift": drift,
        }
        return self._append(row, iterations, rejections, tau)

    def _sum(self, values: dict[str, float], kind: str) -> float:
        return sum(values[entry.name] for entry in self.entries if entry.kind == kind)

    def _append(
        self, row: dict[str, float], iterations: int, rejections: int, tau: float
    ) -> dict[str, float]:
        row = row | self._extrema(tau) | {"newton_iterations": iterations, "rejections": rejections}
        self.rows.append({name: row[name] for name in self.columns})
        return self.rows[-1]

    def _cell_integrands(self) -> tuple[CoefficientFunction, list[str]]:
        u = self.step.now
        named = {
            "kinetic": 0.5 * u.rho * square(u.v),
            "stored": self.step.energy.density(u),
            "mass": u.rho,
        }
        for entry in self.entries:
            if entry.integrand.cells is not None:
                named[entry.name] = entry.integrand.cells
        return CF(tuple(named.values())).Compile(), list(named)

    def _integrals(self) -> dict[str, float]:
        quadrature = self.step.quadrature
        self.step.energy.require()
        totals = quadrature.integrate_cells(self._cells)
        values = {name: float(t) for name, t in zip(self._cell_names, totals, strict=True)}
        for name, integrand in self._facets:
            values[name] = values.get(name, 0.0) + quadrature.integrate_facets(integrand)
        for entry in self.entries:
            if entry.evaluate is not None:
                values[entry.name] = entry.evaluate()
        return values

    def _monitor_functions(self) -> CoefficientFunction:
        """rho, J (NaN where the material has none), (J - det F)^2, |v|, |v|/h."""
        u, nan = self.step.now, CF(math.nan)
        z = u.z_tensors
        J, F = nan, None
        for variable in self.step.model.material.variables:
            value = z[variable.name]
            if isinstance(variable, Jacobian):
                J = value
            elif isinstance(variable, ReciprocalJacobian) and J is nan:
                J = 1 / value
            elif isinstance(variable, Distortion) and variable.exponent == 0:
                F = value
        has_both = F is not None and J is not nan
        self._defect = ((J - Det(F)) * (J - Det(F))).Compile() if has_both else None
        if F is not None and J is nan:
            J = Det(F)
        speed = sqrt(square(u.v))
        return CF((u.rho, J, speed, speed / self.step.context.h))

    def _extrema(self, tau: float) -> dict[str, float]:
        values = self.sampler.values(self._monitors)
        defect = math.nan
        if self._defect is not None:
            defect = math.sqrt(self.step.quadrature.integrate_cells(self._defect))
        return {
            "rho_min": float(values[:, 0].min()),
            "rho_max": float(values[:, 0].max()),
            "J_min": float(values[:, 1].min()),
            "J_defect": defect,
            "v_max": float(values[:, 2].max()),
            "cfl": tau * float(values[:, 3].max()),
        }


def _check_names(entries: list[Entry]) -> None:
    names = [entry.name for entry in entries]
    assert len(set(names)) == len(names), f"two ledger entries share a name: {names}"

"""The energy ledger: one row a step, closing to rounding.

    E - E_old + tau (sum of dissipations - sum of powers) + inertial + bregman = closure

is zero for the exact solution of a step (paper: Euler-ED-basic-energy-balance-disc and
Euler-large-energy-balance-disc, with their inequalities' remainders written out).  Dissipations and powers
are weighted as the time scheme does.  ``inertial`` and ``bregman`` are the kinetic and the stored part of
what it dissipates numerically, sums of Bregman distances (``ngvisco.timestepping.scheme``): for the
implicit Euler step 1/2 int rho_old |v - v_old|^2 and int phi(z_old) - phi(z) - phi'(z):(z_old - z), the
latter >= 0 where the energy is convex; of either sign for schemes of second order.  ``limiter`` is what
limiting the step's end takes (``ngvisco.forms.bounds``), ``limiter_walls`` that of it through moved walls.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, sqrt

from ngvisco.errors import NgviscoWarning, ParameterError, UnknownNameError
from ngvisco.forms.distance import ENERGIES, NUMERICAL, energies
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import EntryIntegrals, Step
from ngvisco.forms.term import PRODUCTION, Entry, Integrand, Kind
from ngvisco.physics.defects import relative_defects
from ngvisco.physics.materials.hyperelastic import IsotropicElastic
from ngvisco.physics.materials.thermal import entropy_in, temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import square
from ngvisco.physics.variables import Distortion, Jacobian, ReciprocalJacobian
from ngvisco.run.closure import CLOSED
from ngvisco.run.notebook import data_frame, ledger_html
from ngvisco.timestepping.integrator import LIMITER, LIMITER_WALLS, StepTaken

_STRETCH, _OPERATIONS = 1e-4, 30
"""Relative change of the variables whose second difference gives the size of an energy density's terms, and
the roundings of one, in units of that size."""

RATES = ("dissipation", "power", "production", "flux")
"""Kinds of entries that are rates, of the scheme's stages."""

_UNITS = {
    "1": (
        *("step", "closure_relative", "mass_drift", "defect_rms", "defect_max", "newton_iterations"),
        *("rejections", "limited_cells", "cfl", "error_estimate", "J_min"),
    ),
    "s": ("time", "dt"),
    "kg": ("mass",),
    "kg/m^3": ("rho_min", "rho_max"),
    "m/s": ("v_max",),
    "K": ("temperature_min", "temperature_max"),
    "J/K": ("entropy",),
    "W/m^3": ("creep_power_min",),
    "m^3": ("cutoff_volume",),
    "m^(d/2)": ("J_defect",),
    "kg^2/m^3/s": ("density_diffusion",),
}
"""Columns that are neither energies (J) nor powers (W), by units."""

TRANSFER = "transfer"
"""Energy lost where a state was carried over to another mesh or other parameters, J."""


def unit(column: str) -> str:
    """The SI unit of a ledger column (per metre of thickness in plane strain)."""
    if column.startswith(("dissipation_", "power_")):
        return "W"
    if column.startswith("entropy_"):
        return "W/K"
    if column.startswith("inflow_"):
        return "kg/s"
    return next((unit for unit, columns in _UNITS.items() if column in columns), "J")


@dataclass(frozen=True)
class Balance:
    """The part of a ledger that a restart needs, to go on without a seam."""

    energy: float
    mass: float
    initial_mass: float
    """With what has come in through walls since."""


_NEGATIVE = 1e-9
"""Share of all entropy that is produced that may be missing of a mechanism: what an iteration leaves."""

CREEP_POWER = "creep_power_min"
"""The column of the least M : Pi at a point."""
_ROUNDING = 1e-12
"""Share of the largest power at a point that rounding may leave of one that is zero."""

WARNING_DEFECT = 0.01
"""Relative root mean square of a defect from which on a run warns."""


class DefectWarning(NgviscoWarning):
    """Variables that stand for one thing have parted: the solution is wrong though the ledger closes."""


class CreepPowerWarning(NgviscoWarning):
    """Creep gives energy at a point: the flow rule has a rate of the wrong sign there."""


class EntropyWarning(NgviscoWarning):
    """A mechanism takes entropy away: the mesh does not resolve the temperature, or a law is none."""


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
        own = (Entry(name, "numerical", Integrand()) for name in (*NUMERICAL, LIMITER, LIMITER_WALLS))
        of_damage = () if step.damage is None else step.damage.entries
        self.entries = [*step.entries(), *own, *of_damage]
        _check_names(self.entries)
        self._state = EntryIntegrals(step, self._state_integrands())
        self._rates = EntryIntegrals(step, {e.name: e for e in self.entries if e.kind in RATES})
        theta = temperature(step.model.material, step.now.zeta_tensors)
        power = step.context.rates.dissipation(step.now)
        watched = {"temperature_min": theta, "temperature_max": theta, CREEP_POWER: power}
        self._watched = {name: value for name, value in watched.items() if value is not None}
        self._monitors = self._monitor_functions()
        self._warned: set[type[NgviscoWarning]] = set()
        self._absent: dict[str, float] = {}
        self._pending: dict[str, float] = {}
        self.rows: list[dict[str, float]] = []
        self.balance: Balance | None = None

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in the order of the CSV file."""
        return [
            *("step", "time", "dt", *ENERGIES),
            *(entry.name for entry in self.entries),
            *("closure", "closure_relative", "mass", "mass_drift"),
            *("rho_min", "rho_max", "J_min", *self._watched, "J_defect", "defect_rms", "defect_max"),
            *("v_max", "newton_iterations", "rejections", "limited_cells"),
            *("cfl", "error_estimate"),
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
        self.step.energy.require()
        values = self._state()
        energy = energy_of(values)
        self.balance = Balance(energy, values["mass"], values["mass"])
        idle = dict.fromkeys((entry.name for entry in self.entries), 0.0)
        row = {"step": 0, "time": time, "dt": 0.0, **idle, **values, "closure": 0.0}
        row |= {"closure_relative": 0.0, "mass_drift": 0.0, "error_estimate": math.nan, "limited_cells": 0}
        return self._append(row, 0, 0, 0.0)

    def resume(self, balance: Balance, rows: list[dict[str, float]]) -> None:
        """Go on from a checkpoint's balance and the rows up to its step."""
        self.balance, self.rows = balance, rows

    def rates(self) -> dict[str, float]:
        """Dissipations and powers at the present state, W, by columns."""
        self.step.energy.require()
        return self._rates()

    def energy(self) -> float:
        """Kinetic plus stored energy at the present state, J."""
        self.step.energy.require()
        return energy_of(self._state())

    def foreign(self, names: Iterable[str]) -> list[str]:
        """Of an earlier part's columns those of the energy balance that this one does not have."""
        return [
            name
            for name in names
            if name not in self.columns and name.startswith(("dissipation_", "power_", TRANSFER))
        ]

    def keep(self, names: Iterable[str]) -> None:
        """Have entries of value 0 for what an earlier part of the run exchanged and this one does not."""
        for name in self.foreign(names):
            kind: Kind = "numerical" if name == TRANSFER else "dissipation"
            kind = "power" if name.startswith("power_") else kind
            self.entries.append(Entry(name, kind, Integrand()))
            self._absent[name] = 0.0

    def add_once(self, name: str, value: float) -> None:
        """Add ``value``, J, to the column ``name`` of the next row, a transfer between states."""
        self.keep([name])
        self._pending[name] = value

    def record(
        self, number: int, time: float, taken: StepTaken, rejections: int = 0, error: float | None = None
    ) -> dict[str, float]:
        """The row of the step ``taken`` to the present state, which is that of ``time``, s.

        ``error`` is the estimate of the step's relative error, None where there is none.
        """
        assert self.balance is not None
        tau, iterations = taken.tau, taken.iterations
        self.step.energy.require()
        values = {LIMITER: 0.0, LIMITER_WALLS: 0.0} | self._absent | self._pending
        values |= self._state() | taken.rates | taken.numerical
        energy = energy_of(values)
        dissipated, worked = self._sum(values, "dissipation"), self._sum(values, "power")
        remainder = self._sum(values, "numerical")
        closure = energy - self.balance.energy + tau * (dissipated - worked) + remainder
        physical = (e.name for e in self.entries if e.kind in ("dissipation", "power"))
        exchanged = tau * sum(abs(values[name]) for name in physical)
        scale = max(abs(energy), abs(self.balance.energy), exchanged)
        if not abs(closure) <= CLOSED * scale:
            scale = max(scale, self.rounding() / CLOSED, self.heat())
        expected = self.balance.initial_mass + tau * self._sum(values, "flux")
        drift = (values["mass"] - expected) / expected
        row = {
            **{"step": number, "time": time, "dt": tau, **values},
            **{"closure": closure, "closure_relative": closure / scale if scale else closure},
            **{"mass_drift": drift, "error_estimate": math.nan if error is None else error},
            "limited_cells": taken.limited,
        }
        row = self._append(row, iterations, rejections, tau)
        self._check_entropy(row)
        self._pending = {}
        self.balance = Balance(energy, values["mass"], expected)
        return row

    def _check_entropy(self, row: Mapping[str, float]) -> None:
        """Warn once of a mechanism that takes entropy away."""
        made = {name: row[name] for name in self.columns if name.startswith(PRODUCTION)}
        least = min(made, key=lambda name: made[name], default="")
        if made and made[least] < -_NEGATIVE * sum(map(abs, made.values())):
            message = (
                f"at t = {row['time']:.4g} s {least} is {made[least]:.3g} W/K: where that is conduction, "
                "the cells are too large for the slopes of the temperature; else a law gives energy"
            )
            self._warn_once(message, EntropyWarning)

    def _check_power(self, power: np.ndarray, time: float) -> None:
        """Warn once of creep that gives energy somewhere."""
        ranks = self.sampler.ranks
        least, largest = ranks.least(power), ranks.most(abs(power))
        if least < -_ROUNDING * largest and CreepPowerWarning not in self._warned:
            message = (
                f"at t = {time:.4g} s creep gives energy, M : Pi = {least:.3g} W/m^3, most "
                f"{self._place_of_largest(-power)}: its flow rule is none, though the ledger closes"
            )
            self._warn_once(message, CreepPowerWarning)

    def _warn_once(self, message: str, kind: type[NgviscoWarning]) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            self.sampler.ranks.warn(message, kind, stacklevel=3)

    def rounding(self) -> float:
        """What rounding may leave of the stored energy at the present state, J.

        An energy that is zero at rest, such as tr B - ln det B - 3, is a difference of terms that are not.
        Their size is int |phi''(z)[z, z]|, and that of the heat above theta_R is int c theta.
        """
        z = self.step.now.z_tensors
        factors = (1 - _STRETCH, 1.0, 1 + _STRETCH)
        stretched = ({name: factor * value for name, value in z.items()} for factor in factors)
        less, here, more = (self.step.energy.samples(state, self.sampler) for state in stretched)
        scale = np.nan_to_num(abs(less - 2 * here + more), posinf=0.0) / _STRETCH**2
        return _OPERATIONS * np.finfo(float).eps * (self.sampler.integral(scale) + self.heat(1.0))

    def heat(self, s: float | None = None) -> float:
        """int theta |s|, the size of the heat beside that of the reference temperature, J; 0 without heat.

        Warm and cold places cancel in the energy, and do not in what an iteration leaves.  ``s`` in units of
        the entropy, else the present one.
        """
        entropy = entropy_in(self.step.model.material)
        if entropy is None:
            return 0.0
        u = self.step.now
        heat = u.zeta_tensors[entropy.name] * (u.z_tensors[entropy.name] if s is None else s)
        return float(self.step.quadrature.integrate_cells(sqrt(heat * heat)))

    def _sum(self, values: dict[str, float], kind: str) -> float:
        return sum(values[entry.name] for entry in self.entries if entry.kind == kind)

    def _append(
        self, row: dict[str, float], iterations: int, rejections: int, tau: float
    ) -> dict[str, float]:
        row = row | self._extrema(tau, row["time"])
        row |= {"newton_iterations": iterations, "rejections": rejections}
        self.rows.append({name: row[name] for name in self.columns})
        return self.rows[-1]

    def _state_integrands(self) -> dict[str, Entry]:
        """What is integrated of a state: energies, mass, and what is for information."""
        u = self.step.now
        named = {**energies(self.step, u), "mass": Integrand(u.rho)}
        entries = {name: Entry(name, "monitor", value) for name, value in named.items()}
        return entries | {e.name: e for e in self.entries if e.kind == "monitor"}

    def _monitor_functions(self) -> CoefficientFunction:
        """rho, J (NaN where the material has none), |v|, |v|/h, and what is watched."""
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
        material = self.step.model.material
        if isinstance(material, Mixture):
            J = 1 / material.fractions.total(z)
        has_both = F is not None and J is not nan
        self._defect = ((J - Det(F)) * (J - Det(F))).Compile() if has_both else None
        defects = relative_defects(material, z, self.step.model.creep)
        self._defects = CF(tuple(defects.values())).Compile() if defects else None
        self._defect_squares = CF((1.0, *(d * d for d in defects.values()))).Compile()
        self._defect_names = list(defects)
        if F is not None and J is nan:
            J = Det(F)
        speed = sqrt(square(u.v))
        return CF((u.rho, J, speed, speed / self.step.context.h, *self._watched.values())).Compile()

    def _extrema(self, tau: float, time: float) -> dict[str, float]:
        values, ranks = self.sampler.values(self._monitors), self.sampler.ranks
        if CREEP_POWER in self._watched:
            self._check_power(values[:, 4 + list(self._watched).index(CREEP_POWER)], time)
        defect = math.nan
        if self._defect is not None:
            defect = math.sqrt(self.step.quadrature.integrate_cells(self._defect))
        rms, largest = self._relative_defects(time)
        return {
            "rho_min": ranks.least(values[:, 0]),
            "rho_max": ranks.most(values[:, 0]),
            "J_min": ranks.least(values[:, 1]),
            "J_defect": defect,
            "defect_rms": rms,
            "defect_max": largest,
            "v_max": ranks.most(values[:, 2]),
            "cfl": tau * ranks.most(values[:, 3]),
            **{
                name: (ranks.most if name.endswith("_max") else ranks.least)(values[:, 4 + i])
                for i, name in enumerate(self._watched)
            },
        }

    def _relative_defects(self, time: float) -> tuple[float, float]:
        """Largest root mean square and largest value of the relative defects; warns once from 1 % on."""
        if self._defects is None:
            return math.nan, math.nan
        values = self.sampler.values(self._defects)
        sizes = np.abs(values.reshape(len(values), len(self._defect_names)))
        largest = np.array([self.sampler.ranks.most(column) for column in sizes.T])
        volume, *squares = self.step.quadrature.integrate_cells(self._defect_squares)
        rms = np.sqrt(np.array(squares) / volume)
        worst = int(np.argmax(rms))
        if rms[worst] >= WARNING_DEFECT and DefectWarning not in self._warned:
            where = self._place_of_largest(sizes[:, worst])
            message = _winding_message(self._defect_names[worst], rms[worst], largest[worst], self.step)
            self._warn_once(f"at t = {time:.4g} s, most {where}: {message}", DefectWarning)
        return float(rms.max()), float(largest.max())

    def _place_of_largest(self, sizes: np.ndarray) -> str:
        """Where a number at this rank's points is largest over all ranks, and in which body, in words."""
        material, mine = self.step.model.material, None
        bodies: list[str] = []
        if isinstance(material, Mixture):
            shares = material.fractions.at(self.step.now.z_tensors)
            theta = self.sampler.rows(CF(tuple(shares.values())))
            bodies = [list(shares)[number] for number in theta.argmax(axis=1)]
        if len(sizes):
            at = int(np.argmax(sizes))
            place = ", ".join(f"{c:.4g}" for c in self.sampler.coordinates(np.array([at]))[0])
            mine = (float(sizes[at]), f"at ({place}) m" + (f" in body {bodies[at]!r}" if bodies else ""))
        return max(one for one in self.sampler.ranks.gathered(mine) if one is not None)[1]


def energy_of(values: Mapping[str, float]) -> float:
    """Kinetic plus stored energy of a row, J."""
    return sum(values[name] for name in ENERGIES)


def _winding_message(pair: str, rms: float, largest: float, step: Step) -> str:
    material = step.model.material
    winds = any(v.frame == "relaxed" for v in material.variables)
    remedy = "shorter steps and a finer mesh"
    if winds and isinstance(material, IsotropicElastic):
        remedy = f'elastic_state="B" where the body flows, in which nothing winds up, or {remedy}'
    elif winds:
        remedy = f"variables by B = F F^T where the body flows and the energy is isotropic, or {remedy}"
    return (
        f"{pair} differ by {rms:.1%} in the mean square, {largest:.1%} at most: the variables no longer "
        "belong to one distortion, and the stress is wrong by as much, though the ledger closes; the remedy "
        f"is {remedy}"
    )


def _check_names(entries: list[Entry]) -> None:
    names = [entry.name for entry in entries]
    for name in names:
        if names.count(name) > 1:
            raise ParameterError("Entry.name", name, "names that no other term's columns have")

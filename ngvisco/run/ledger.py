"""The energy ledger: one row a step, closing to rounding.

    E - E_old + tau (sum of dissipations - sum of powers) + inertial + bregman = closure

is zero for the exact solution of a step (paper: Euler-ED-basic-energy-balance-disc and
Euler-large-energy-balance-disc, with their inequalities' remainders written out).  Dissipations and powers
have the time scheme's weights.  ``inertial`` and ``bregman`` are the kinetic and the stored part of the
scheme's numerical dissipation, sums of Bregman distances (``ngvisco.timestepping.scheme``).  For the implicit
Euler step these parts are 1/2 int rho_old |v - v_old|^2 and int phi(z_old) - phi(z) - phi'(z):(z_old - z);
the second one is >= 0 where the energy is convex.  In schemes of second order the two parts have either sign.
``limiter`` is the energy that the limiter, and restored determinants of sharp bodies, take from the state at
the step's end (``ngvisco.forms.bounds``, ``ngvisco.forms.cut_strains``); ``limiter_walls`` is the share of
this energy that passes through held or moving walls.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from ngsolve import CF, sqrt

from ngvisco.errors import InitialDataError, NgviscoWarning, ParameterError, StepError, require_known
from ngvisco.forms.distance import ENERGIES, NUMERICAL, energies
from ngvisco.forms.entry_integrals import EntryIntegrals
from ngvisco.forms.mesh.quadrature import Sampler
from ngvisco.forms.system import Step
from ngvisco.forms.term import Entry, Integrand, Kind
from ngvisco.physics.defects import parted
from ngvisco.physics.materials.thermal import temperature
from ngvisco.physics.mixture import Mixture
from ngvisco.physics.tensors import least_eigenvalues, square
from ngvisco.run.adaptive import CRACKED, GROWTH, DamageWarning, growth_message
from ngvisco.run.extrema import defects_of, extrema, volume
from ngvisco.run.inlets import InflowWarning, Inlets
from ngvisco.run.momentum import Momentum
from ngvisco.run.momentum import unit as unit_of_momentum
from ngvisco.run.notebook import data_frame, ledger_html
from ngvisco.run.rounding import heat, rounding
from ngvisco.run.signs import CREEP_POWER, Signs, cause_of_negative_power
from ngvisco.timestepping.integrator import LIMITER, LIMITER_WALLS, StepTaken

EIGENVALUE = "eigenvalue_min_"
"""Beginning of the columns of each tensor B's least eigenvalue, which has to be positive."""
_RATES = ("dissipation", "power", "production", "flux")
"""Kinds of entries that are rates at the scheme's stages."""
_COUNTS = ("newton_iterations", "rejections", "limited_cells", "passive_unsolved")
_UNITS = {
    **{"time": "s", "dt": "s", "mass": "kg", "rho_min": "kg/m^3", "rho_max": "kg/m^3", "v_max": "m/s"},
    **{"temperature_min": "K", "temperature_max": "K", "entropy": "J/K", "creep_power_min": "W/m^3"},
    **{"cutoff_volume": "m^3", "J_defect": "m^(d/2)", "density_diffusion": "kg^2/m^3/s", CRACKED: "m^(d-1)"},
    **dict.fromkeys(("step", "closure_relative", "mass_drift", "defect_rms", "defect_max", "J_min"), "1"),
    **dict.fromkeys((*_COUNTS, "cfl", "error_estimate", GROWTH), "1"),
}
"""Units of columns that are not J, by name; ``_UNITS_OF_KINDS`` has units by the beginning of the name."""
_UNITS_OF_KINDS = {"dissipation_": "W", "power_": "W", "entropy_": "W/K", "inflow_": "kg/s", EIGENVALUE: "1"}

TRANSFER = "transfer"
"""Column of the energy lost when a state is carried over to another mesh or other parameters, J."""


def unit(column: str) -> str:
    """The SI unit of a ledger column (per metre of thickness in plane strain)."""
    for prefix, unit in _UNITS_OF_KINDS.items():
        if column.startswith(prefix):
            return unit
    return unit_of_momentum(column) or _UNITS.get(column, "J")


@dataclass(frozen=True)
class Balance:
    """Totals of a ledger from which a restart continues as the uninterrupted run."""

    energy: float
    mass: float
    initial_mass: float
    """Mass at the start plus the mass that has come in through walls since."""


_DEFECT = 0.01
"""Relative root mean square of a defect, above which a run warns."""
CLOSED = 1e-8
"""|closure_relative| up to which a ledger counts as closed for every tolerance of the solver."""
_PER_TOLERANCE = 100.0


def closure_limit(tolerance: float) -> float:
    """Largest |closure_relative| of a ledger that closes, for a solver's tolerance."""
    return max(CLOSED, _PER_TOLERANCE * tolerance)


class ClosureWarning(NgviscoWarning):
    """The energy ledger of a step does not close: the state does not solve the step's equations."""


class DefectWarning(NgviscoWarning):
    """Variables for one quantity have parted: the solution is wrong though the ledger closes."""


class Ledger:
    """Evaluates a row after every step; a step with |closure_relative| above ``closed`` does not close.

    Each row is judged by the limit of its own part of the run, since the parts' tolerances may differ.

    Attributes
    ----------
    columns : list of str
    rows : list of dict
        One for every step so far, and row 0 for the initial state.
    """

    def __init__(
        self,
        step: Step,
        sampler: Sampler,
        closed: float = CLOSED,
        velocity: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """``velocity`` gives the run's velocity scale, m/s, which momenta are compared with."""
        self.step, self.sampler, self.closed = step, sampler, closed
        self.momentum = Momentum(step, sampler, velocity)
        of_scheme = (Entry(name, "numerical", Integrand()) for name in (*NUMERICAL, LIMITER, LIMITER_WALLS))
        of_damage = () if step.damage is None else step.damage.entries
        self.entries = [*step.entries(), *of_scheme, *of_damage]
        names = [entry.name for entry in self.entries]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ParameterError("Entry.name", twice[0], "a name that no other term's column has")
        integrands = {**energies(step, step.now), "mass": Integrand(step.now.rho)} | self.momentum.densities()
        of_state = {name: Entry(name, "monitor", value) for name, value in integrands.items()}
        of_state |= {e.name: e for e in self.entries if e.kind == "monitor"}
        self.state = EntryIntegrals(step.quadrature, of_state)
        """Energies, mass and monitors at the present state, by columns."""
        self.exchange = EntryIntegrals(step.quadrature, {e.name: e for e in self.entries if e.kind in _RATES})
        theta = temperature(step.model.material, step.now.zeta_tensors)
        self._warned: set[type[NgviscoWarning]] = set()
        cause = partial(cause_of_negative_power, step, sampler)
        self._signs = Signs(step, sampler, self.entries, self._warn_once, cause)
        power = self._signs.at_points.get(CREEP_POWER)
        watched = {"temperature_min": theta, "temperature_max": theta, CREEP_POWER: power}
        self._watched = {name: value for name, value in watched.items() if value is not None}
        definite = (v.name for v in step.model.material.variables if v.is_positive_definite)
        self._definite = {EIGENVALUE + name: step.now.z_tensors[name] for name in definite}
        self._prepare_monitors()
        self._inlets = Inlets(step)
        self._pending: dict[str, float] = {}
        self.rows: list[dict[str, float]] = []
        self.balance: Balance | None = None
        self._earlier: list[tuple[int, float]] = []
        self._first = 0

    @property
    def limits(self) -> list[tuple[int, float]]:
        """First row of each part of the run, and |closure_relative| up to which the part closes."""
        return [*self._earlier, (self._first, self.closed)]

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in the order of the CSV file."""
        return [
            *("step", "time", "dt", *ENERGIES),
            *(entry.name for entry in self.entries),
            *("closure", "closure_relative", "mass", "mass_drift", *self.momentum.columns),
            *("rho_min", "rho_max", "J_min", *self._watched, *self._definite),
            *("J_defect", "defect_rms", "defect_max"),
            *("v_max", *_COUNTS, "cfl", "error_estimate"),
        ]

    def column(self, name: str) -> np.ndarray:
        """Values of a column in all rows so far."""
        require_known("ledger column", [name], self.columns)
        return np.array([row[name] for row in self.rows])

    def exchanged(self, *names: str) -> np.ndarray:
        """Sum of the named dissipations, powers and numerical entries since the start, J, (rows,)."""
        lengths, total = self.column("dt"), np.zeros(len(self.rows))
        numerical = {entry.name for entry in self.entries if entry.kind == "numerical"}
        for name in names:
            total += self.column(name) * (1.0 if name in numerical else lengths)
        return np.cumsum(total)

    @property
    def unclosed(self) -> str:
        """The message about a ledger that does not close; empty if it closes."""
        if not self.rows or self.step.sources is not None:  # the power of manufactured sources has no entry
            return ""
        first, limits = map(np.array, zip(*self.limits, strict=True))
        limit = limits[np.searchsorted(first, np.arange(len(self.rows)), side="right") - 1]
        closure = np.nan_to_num(np.abs(self.column("closure_relative")), nan=math.inf, posinf=math.inf)
        closure[closure <= limit] = 0.0
        count, at = int(np.count_nonzero(closure)), int(closure.argmax())
        if not count:
            return ""
        worst = self.rows[at]
        return (
            f"THE LEDGER DOES NOT CLOSE in {count} step{'s' * (count > 1)}: |closure_relative| is "
            f"{closure[at]:.1e} in step {worst['step']} (t = {worst['time']:.4g} s), above the limit "
            f"{limit[at]:.0e}. Energy is gained or lost for which no term accounts, so that the results "
            "cannot be trusted"
        )

    def frame(self) -> Any:
        """All rows as a pandas frame with the step as index; raises NotebookError if pandas is missing."""
        return data_frame(self._columns())

    def _repr_html_(self) -> str:
        return ledger_html(self._columns())

    def _columns(self) -> dict[str, np.ndarray]:
        return {name: self.column(name) for name in self.columns}

    def start(self, time: float) -> dict[str, float]:
        """Row 0, of the initial state, without exchange."""
        self.step.energy.require()
        values = self.state()
        if bad := [name for name, value in values.items() if not math.isfinite(value)]:
            raise InitialDataError(bad[0], f"the value is {values[bad[0]]}", "a finite value")
        self.balance = Balance(energy_of(values), values["mass"], values["mass"])
        row = self._idle() | values | dict.fromkeys(("dt", "closure", "closure_relative", "mass_drift"), 0.0)
        row |= self.momentum.start(values)
        row |= {"time": time, "error_estimate": math.nan, **dict.fromkeys(("step", *_COUNTS), 0)}
        return self._append(row | self._measured(0.0, time))

    def _idle(self) -> dict[str, float]:
        """Entries of a step without exchange: zeros."""
        return dict.fromkeys((entry.name for entry in self.entries), 0.0)

    def resume(
        self, balance: Balance, rows: list[dict[str, float]], limits: Iterable[tuple[int, float]]
    ) -> None:
        """Go on from a checkpoint's balance, the rows up to its step, and their ``limits``."""
        self.balance, self.rows = balance, rows
        self.momentum.resume(rows)
        self._inlets.resume(rows)
        self._earlier = [(first, limit) for first, limit in limits if first < len(rows)]
        self._first = len(rows) if self._earlier else 0

    def rates(self) -> dict[str, float]:
        """Dissipations and powers, W, and forces, N, at the present state, by columns.

        Raises StepError, with the place, for a value that is no number.
        """
        return self.powers() | self.momentum.forces()

    def powers(self) -> dict[str, float]:
        """Dissipations, powers, productions and fluxes at the present state, by columns; raises as
        ``rates``."""
        self.step.local_unknowns.update_energy()
        self.step.energy.require()
        return self._numbers(self.exchange)

    def _numbers(self, integrals: EntryIntegrals) -> dict[str, float]:
        """Integrals at the present state; raises StepError for the first one that is no number."""
        values = integrals()
        for name, value in values.items():
            if not math.isfinite(value):
                place = self.sampler.place_of_cells(integrals.cells_without(name))
                raise StepError(f"{name} is {value}, {place}; take a smaller step or a finer mesh")
        return values

    def energy(self) -> float:
        """Kinetic plus stored energy at the present state, J."""
        self.step.energy.require()
        return energy_of(self.state())

    def foreign(self, names: Iterable[str]) -> list[str]:
        """Columns of exchange in an earlier part of the run that this ledger does not have."""
        return [*self._foreign_energies(names), *self.momentum.foreign(names)]

    def _foreign_energies(self, names: Iterable[str]) -> list[str]:
        prefixes, columns = ("dissipation_", "power_", TRANSFER), self.columns
        return [name for name in names if name not in columns and name.startswith(prefixes)]

    def keep(self, names: Iterable[str]) -> None:
        """Add an entry of value 0 for each column in ``names`` that an earlier part of the run had and this
        part does not have."""
        self.momentum.keep(names := list(names))
        for name in self._foreign_energies(names):
            kind: Kind = "numerical" if name == TRANSFER else "dissipation"
            self.entries.append(Entry(name, "power" if name.startswith("power_") else kind, Integrand()))

    def add_once(self, name: str, value: float) -> None:
        """Add the energy of a transfer, ``value``, J, to the column ``name`` of the next row."""
        self.keep([name])
        self._pending[name] = value

    def record(
        self, number: int, time: float, step: StepTaken, rejections: int = 0, error: float | None = None
    ) -> dict[str, float]:
        """Append and return the row of ``step``, which ends in the present state at ``time``, s.

        ``error`` is the estimate of the step's relative error, None without an estimate.  Raises StepError,
        without appending the row, for a column that has to be a number and is NaN or infinite.
        """
        assert self.balance is not None
        tau = step.tau
        self.step.energy.require()
        values = self._idle() | self._pending | self._numbers(self.state) | step.rates | step.numerical
        energy = energy_of(values)
        dissipated, worked, remainder, inflow = (
            sum(values[entry.name] for entry in self.entries if entry.kind == kind)
            for kind in ("dissipation", "power", "numerical", "flux")
        )
        closure = energy - self.balance.energy + tau * (dissipated - worked) + remainder
        physical = (e.name for e in self.entries if e.kind in ("dissipation", "power"))
        scale = max(abs(energy), abs(self.balance.energy), tau * sum(abs(values[name]) for name in physical))
        if not abs(closure) <= CLOSED * scale:
            scale = max(scale, rounding(self.step, self.sampler, tau) / CLOSED, heat(self.step))
        expected = self.balance.initial_mass + tau * inflow
        row = values | {
            **{"step": number, "time": time, "dt": tau, "closure": closure},
            **{"closure_relative": closure / scale if scale else closure},
            **{"mass_drift": (values["mass"] - expected) / expected},
            **dict(zip(_COUNTS, (step.iterations, rejections, step.limited, step.unsolved), strict=True)),
            "error_estimate": math.nan if error is None else error,
            **self.momentum.row(values, tau, step.impulse),
            **self._measured(tau, time),
        }
        for name in self.columns:
            if name not in self._optional and not math.isfinite(row[name]):
                raise StepError(f"the ledger's column {name} is {row[name]} at t = {time:g} s")
        self._signs.check(row)
        if message := growth_message(self.step, row):
            self._warn_once(message, DamageWarning)
        if InflowWarning not in self._warned and (message := self._inlets.message(row)):
            self._warn_once(message, InflowWarning)
        self._pending = {}
        self.balance = Balance(energy, values["mass"], expected)
        return self._append(row)

    def check_closure(self) -> None:
        """Warn if the last row does not close, in energy or in momentum, and all earlier rows do."""
        self.momentum.check(self.rows[-1])
        if not abs(self.rows[-1]["closure_relative"]) <= self.closed and (message := self.unclosed):
            self._warn_once(message, ClosureWarning)

    def _warn_once(self, message: str, kind: type[NgviscoWarning]) -> None:
        if kind not in self._warned:
            self._warned.add(kind)
            self.sampler.ranks.warn(message, kind, stacklevel=3)

    def _append(self, row: dict[str, float]) -> dict[str, float]:
        self.rows.append({name: row[name] for name in self.columns})
        self.momentum.count(row)
        return self.rows[-1]

    def defect_norms(self) -> tuple[float, np.ndarray]:
        """The norm of J - det F in L2, NaN if J or F is missing, and the root mean squares of the relative
        defects."""
        size, gap, *squares = self.step.quadrature.integrate_cells(self._squares)
        return math.sqrt(gap) if self._has_both else math.nan, np.sqrt(np.array(squares) / size)

    def _prepare_monitors(self) -> None:
        """Compile the quantities that are monitored besides entries: point values and squares of defects."""
        u, material = self.step.now, self.step.model.material
        self._shares = (
            material.fractions.at(u.z_tensors) if isinstance(material, Mixture) else dict[str, Any]()
        )
        J, _ = volume(material, u)
        gap, self._defects = defects_of(self.step.model, u)
        self.extrema = extrema(u, J, self._watched, self._definite, self._defects)
        """Extrema over the sampler's points, by their columns."""
        self._has_both = gap is not None
        self._optional = {"error_estimate"} | ({"J_defect"} if gap is None else set())
        """Columns that may be NaN, since the run has no such quantity."""
        if J is None:
            self._optional.add("J_min")
            J = CF(math.nan)
        if not self._defects:
            self._optional |= {"defect_rms", "defect_max"}
        gap, defects = CF(0.0) if gap is None else gap, self._defects.values()
        self._squares = CF((1.0, gap * gap, *(defect * defect for defect in defects))).Compile()
        speed = sqrt(square(u.v))
        at_points = (u.rho, J, speed, speed / self.step.context.h, *self._watched.values(), *defects)
        at_points = (*self._definite.values(), *at_points, *self._signs.at_points.values())
        self._at_points = CF(at_points).Compile()

    def _measured(self, tau: float, time: float) -> dict[str, float]:
        ranks, values = self.sampler.ranks, self.sampler.rows(self._at_points).T
        least, most = ranks.least, ranks.most
        tensors, values = np.split(values, [9 * len(self._definite)])
        tensors = tensors.T.reshape(values.shape[1], len(self._definite), 3, 3)
        eigenvalues = {name: least_eigenvalues(tensors[:, i]) for i, name in enumerate(self._definite)}
        (rho, J, speed, rate), values = values[:4], values[4:]
        watched, values = dict(zip(self._watched, values, strict=False)), values[len(self._watched) :]
        defects, powers = values[: len(self._defects)], values[len(self._defects) :]
        self._signs.check_points(dict(zip(self._signs.at_points, powers, strict=True)), self._shares, time)
        J_defect, norms = self.defect_norms()
        rms, largest = self._relative_defects(defects, norms, time)
        return {
            **{"rho_min": least(rho), "rho_max": most(rho), "J_min": least(J)},
            **{name: (most if name.endswith("_max") else least)(v) for name, v in watched.items()},
            **{name: least(lowest) for name, lowest in eigenvalues.items()},
            **{"v_max": most(speed), "cfl": tau * most(rate)},
            "J_defect": J_defect,
            **{"defect_rms": rms, "defect_max": largest},
        }

    def _relative_defects(self, values: np.ndarray, rms: np.ndarray, time: float) -> tuple[float, float]:
        """Largest root mean square and largest value of the relative defects; warns once of 1 % or more.

        ``values`` are the defects at points, (defects, points), ``rms`` their root mean squares.
        """
        if not self._defects:
            return math.nan, math.nan
        largest = np.array([self.sampler.ranks.most(abs(row)) for row in values])
        worst = int(np.argmax(rms))
        if rms[worst] >= _DEFECT and DefectWarning not in self._warned:
            where = self.sampler.largest_in_words(abs(values[worst]), self._shares)
            pair = list(self._defects)[worst]
            message = parted(self.step.model.material, pair, rms[worst], largest[worst], where)
            self._warn_once(f"at t = {time:.4g} s {message}", DefectWarning)
        return float(rms.max()), float(largest.max())


def energy_of(values: Mapping[str, float]) -> float:
    """Kinetic plus stored energy of a row, J."""
    return sum(values[name] for name in ENERGIES)

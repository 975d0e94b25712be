"""Fits of parameters to data by bounded least squares with exact derivatives of the runs."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ngvisco.errors import (
    Declared,
    ParameterError,
    StepError,
    StopRequested,
    as_number,
    require_collection,
    require_type,
)
from ngvisco.run.files import AnyPath
from ngvisco.run.pictures import LABELS, PAGE, figure, save
from ngvisco.run.simulation import Simulation
from ngvisco.run.stepping import FixedStepper
from ngvisco.sensitivity.columns import Columns, tables_of
from ngvisco.sensitivity.data import INTEGRAL, TIME, Data, DataError, converted
from ngvisco.sensitivity.gradient import Gradient, gradient
from ngvisco.sensitivity.parameters import Named, varied
from ngvisco.sensitivity.restart import Restart
from ngvisco.words import words_of

_RANGE = 1e3
"""Factor from the start value to the default bounds of a parameter, downwards and upwards."""
_UNDETERMINED = 1e-10
"""Ratio of singular values of the scaled Jacobian below which the data do not determine a combination of
parameters."""


@dataclass(frozen=True)
class Fit:
    """Parameters fitted to data.

    Attributes
    ----------
    by : tuple of str
        The parameters' names.
    start, values, deviations : arrays, (parameters,)
        Start values, fitted values and their standard deviations, which are infinite if the data do not
        determine the parameter.
    bounds : array, (parameters, 2)
    covariance, correlation : arrays, (parameters, parameters)
    columns : tuple of str
        The data's columns.
    times, data, found, sigma : mappings of columns to arrays
        Time (s) of each datum, its measured value, its value in the run with the fitted parameters, and
        its standard deviation.
    misfit : float
        Half the sum of squares of the residuals divided by their standard deviations.
    reduced : float
        Twice the misfit, divided by the number of data minus the number of parameters: near one if the model
        and the standard deviations are right; one by definition if standard deviations were estimated.
    runs : int
        Number of runs, each with its derivatives.
    cost : float
        Ratio of the time of the whole fit to the time of the last run alone.
    message : str
        Reason for the end of the search.
    """

    by: tuple[str, ...]
    start: np.ndarray
    values: np.ndarray
    deviations: np.ndarray
    bounds: np.ndarray
    covariance: np.ndarray
    correlation: np.ndarray
    columns: tuple[str, ...]
    times: dict[str, np.ndarray]
    data: dict[str, np.ndarray]
    found: dict[str, np.ndarray]
    sigma: dict[str, np.ndarray]
    misfit: float
    reduced: float
    runs: int
    cost: float
    message: str

    def __getitem__(self, name: str) -> float:
        """Fitted value of a parameter."""
        return float(self.values[self.by.index(name)])

    def __str__(self) -> str:
        """Report of a few lines."""
        lines = []
        for i, name in enumerate(self.by):
            at_bound = np.isclose(self.values[i], self.bounds[i], rtol=1e-6, atol=0).any()
            low, high = self.bounds[i]
            lines.append(
                f"{name} = {self.values[i]:.6g} +- {self.deviations[i]:.2g}, from {self.start[i]:.6g}, "
                f"within {low:.3g} and {high:.3g}{': AT ITS BOUND' if at_bound else ''}"
            )
        for i, first in enumerate(self.by):
            for j in range(i):
                lines.append(f"correlation of {self.by[j]} and {first}: {self.correlation[i, j]:+.3f}")
        count = sum(len(values) for values in self.data.values())
        lines.append(f"{count} data, half the sum of squares {self.misfit:.5g}, reduced {self.reduced:.3g}")
        for name in self.columns:
            off = self.found[name] - self.data[name]
            lines.append(f"{name}: root mean square of the residuals {np.sqrt(np.mean(off**2)):.3g}")
        lines.append(
            f"{self.runs} runs with derivatives, of the cost of {self.cost:.1f} runs; {self.message}"
        )
        return "\n".join(lines)

    def plot(self, path: AnyPath) -> None:
        """Plot data, fit and residuals of every column over time, as PNG, PDF or SVG; raises PlotError."""
        fig, axes = figure(2, len(self.columns), (max(PAGE, 4.5 * len(self.columns)), 6.0))
        for i, name in enumerate(self.columns):
            order = np.argsort(self.times[name], kind="stable")
            t, above, below = self.times[name][order], axes[0][i], axes[1][i]
            above.errorbar(t, self.data[name][order], self.sigma[name][order], fmt="k.", label="data")
            above.plot(t, self.found[name][order], "C1-", label="fit")
            above.set(title=name)
            above.legend(fontsize=LABELS)
            below.plot(t, ((self.found[name] - self.data[name]) / self.sigma[name])[order], "C1.")
            below.axhline(0.0, color="k", linewidth=0.5)
            below.set(xlabel="time, s", ylabel="residual over its standard deviation")
        save(fig, path)


def fit(
    simulation: Simulation,
    data: AnyPath | Mapping[str, Sequence[float]],
    *,
    by: Sequence[str],
    sigma: float | Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    until: float | None = None,
    tolerance: float = 1e-3,
    factor: Callable[[str, str], float] | None = None,
    progress: Callable[[str], None] | None = None,
    restart: AnyPath | None = None,
) -> Fit:
    """Fit parameters of a run to measured data by least squares.

    The search is SciPy's ``least_squares`` within bounds, with the derivatives of ``gradient``.  For a
    parameter whose bounds have one sign the search varies the logarithm of the absolute value.  A run without
    a solution counts as a bad trial.

    Raises DataError for invalid data, or for times, columns or units that the run does not have;
    ParameterError or UnknownNameError for an unknown parameter or invalid bounds; StepError if the run from
    the start values has no solution; StopRequested after ``simulation.request_stop()``, within a step.

    Parameters
    ----------
    simulation : Simulation
        Simulation at its start; copies of it run, and it stays unchanged.
    data : path of a CSV file, or mapping of names to sequences
        Columns of the ledger or of tables among the simulation's observers (``Probes``, ``Integrals``,
        ``WallForces``, ``Bodies``) over ``"time"``, in SI units (see ``Data``).  ``"integral of COLUMN"`` is
        the integral over time from the start, such as a displacement.
    by : sequence of str
        Names of parameters as in ``gradient``; the search begins at their values in the simulation.
    sigma : float, or mapping of columns to floats, optional
        Standard deviation of the data.  By default each column is scaled by its root mean square, and the
        standard deviation is estimated from the residuals.
    bounds : mapping of parameters to pairs, optional
        Bounds of the search; by default a thousandth and a thousand times the start value.
    until : float, optional
        End of the run, s, not before the last datum; by default the end of the last datum's step.
    tolerance : float
        Relative size > 0 of a step, or of a change of the sum of squares, at which the search ends.
    factor : callable, optional
        ``factor(unit, wanted)`` returns the size of a unit in wanted units; without it units have to be SI.
    progress : callable, optional
        Function that is called with a line of text for every run.
    restart : path of a folder, optional
        Folder in which the results and derivatives of finished runs are kept, so that the same call does not
        repeat them; a run that was interrupted begins anew.  Raises CheckpointError as ``gradient``.
    """
    require_type("fit.simulation", simulation, Simulation)
    if simulation.number != 0:
        raise ParameterError("fit.simulation", f"a run at step {simulation.number}", "a run at its start")
    names = require_collection("by", by, 'names of parameters, e.g. ["material.G_e"]')
    if not names or len(set(names)) < len(names):
        raise ParameterError("by", by, "at least one parameter, and no parameter twice")
    parameters = [Named.of(name, simulation) for name in names]
    measured = _measured(simulation, Data.of(data), factor)
    end = _end(simulation, measured, until)
    ends = Declared("> 0", (float,)).taken("fit.tolerance", tolerance)
    search = _Search(simulation, parameters, measured, sigma, bounds or {}, end, progress)
    simulation.stop_requested = False
    if restart is not None:
        parts = {"by": names, "data": measured.columns, "times": measured.times}
        options = {"sigma": sigma, "bounds": bounds, "until": end, "tolerance": ends}
        search.take_up(Restart.at(restart, simulation, parts | options))
    return search.run(ends)


def _measured(simulation: Simulation, data: Data, factor: Callable[[str, str], float] | None) -> Data:
    """The data in SI units, checked against the run's columns."""
    names = [name.removeprefix(INTEGRAL) for name in data.columns]
    columns = Columns(simulation, list(dict.fromkeys(names)), tables_of(simulation))
    units = {}
    for name, quantity in zip(data.columns, names, strict=True):
        unit = columns.unit(quantity)
        units[name] = f"{unit} s" if unit is not None and name.startswith(INTEGRAL) else unit
    return converted(data, units, factor)


def _end(simulation: Simulation, data: Data, until: float | None) -> float:
    last, dt = float(data.times.max()), simulation.dt
    if until is None:
        steps = np.ceil(last / dt - 1e-9) if isinstance(simulation.stepper, FixedStepper) else last / dt
        return max(float(steps) * dt, dt)
    end = as_number(until)
    if end is None or last > end * (1 + 1e-9):
        raise DataError(f"the data go to {TIME} = {last:g} s, but the run ends at {until} s")
    return end


class _StopWith:
    """Observer that stops a copy of a simulation after a step if the simulation is asked to stop."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def start(self, copied: Simulation) -> None:
        if self._simulation.stop_requested:
            copied.request_stop()

    def step(self, copied: Simulation, row: dict[str, float]) -> None:
        self.start(copied)

    def finish(self, copied: Simulation) -> None:
        """Do nothing at the end of a run."""


class _Search:
    """The least-squares problem. One run determines the residuals and the Jacobian, which are stored."""

    def __init__(
        self,
        simulation: Simulation,
        parameters: Sequence[Named],
        data: Data,
        sigma: float | Mapping[str, float] | None,
        bounds: Mapping[str, tuple[float, float]],
        until: float,
        progress: Callable[[str], None] | None,
    ) -> None:
        self.simulation, self.parameters, self.until, self.progress = simulation, parameters, until, progress
        self.where = {name: ~np.isnan(values) for name, values in data.columns.items()}
        self.times = {name: data.times[there] for name, there in self.where.items()}
        self.data = {name: values[self.where[name]] for name, values in data.columns.items()}
        self.is_estimated = sigma is None
        self.sigma = {name: np.full(len(v), _deviation(sigma, name, v)) for name, v in self.data.items()}
        self.of: dict[str, str] = {}
        for name, times in self.times.items():
            kind = "until" if name.startswith(INTEGRAL) else "at"
            column = name.removeprefix(INTEGRAL)
            self.of |= {f"{name} {i}": f"{column} {kind} {t!r}" for i, t in enumerate(times.tolist())}
        count = len(self.of)
        if count < len(parameters) + self.is_estimated:
            names, least = ", ".join(p.name for p in parameters), len(parameters) + self.is_estimated
            raise DataError(f"the number of values is {count}; expected at least {least} to fit {names}")
        for name in bounds:
            if name not in [p.name for p in parameters]:
                raise ParameterError("bounds", name, f"one of {', '.join(p.name for p in parameters)}")
        self.bounds = np.array([_bounds(p, bounds.get(p.name)) for p in parameters])
        self.signs = np.where(self.bounds[:, 0] > 0, 1.0, np.where(self.bounds[:, 1] < 0, -1.0, 0.0))
        self.scales = np.where(np.isfinite(np.ptp(self.bounds, axis=1)), np.ptp(self.bounds, axis=1), 1.0)
        self.kept: dict[bytes, Gradient | None] = {}
        self.runs, self.spent, self.alone = 0, 0.0, 0.0
        self._restart: Restart | None = None

    def take_up(self, restart: Restart) -> None:
        """Keep finished runs in a folder, and continue after the runs that the folder has."""
        self._restart = restart
        while (part := restart.read(_name(self.runs + 1))) is not None:
            numbers, arrays = part
            result = None
            if numbers["is_solved"]:
                self.alone = numbers["alone"]
                by = tuple(parameter.name for parameter in self.parameters)
                values, jacobian, at = (arrays[name] for name in ("values", "jacobian", "at"))
                result = Gradient(
                    tuple(self.of), by, values, jacobian, at, int(numbers["limited"]), self.alone
                )
            self.kept[arrays["unknowns"].tobytes()] = result
            self.runs, self.spent = self.runs + 1, numbers["spent"]

    def _keep(self, q: np.ndarray, result: Gradient | None) -> None:
        """Keep the last run's result, or None without a solution, under the search's unknowns ``q``."""
        self.kept[q.tobytes()] = result
        if self._restart is None:
            return
        numbers = {"is_solved": float(result is not None), "spent": self.spent, "alone": self.alone}
        arrays = {"unknowns": q}
        if result is not None:
            numbers["limited"] = result.limited
            arrays |= {"values": result.values, "jacobian": result.jacobian, "at": result.at}
        self._restart.keep(_name(self.runs), numbers, arrays)

    def _inner(self, p: np.ndarray) -> np.ndarray:
        """Unknowns of the search: logarithms of |p| if the bounds have one sign, otherwise scaled ``p``."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.signs != 0, np.log(self.signs * p), p / self.scales)

    def _outer(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Parameters for unknowns ``q`` of the search, and the parameters' derivatives by ``q``."""
        p = np.where(self.signs != 0, self.signs * np.exp(np.where(self.signs != 0, q, 0.0)), q * self.scales)
        return p, np.where(self.signs != 0, p, self.scales)

    def _at(self, q: np.ndarray) -> Gradient | None:
        """The run for unknowns ``q``, with derivatives by the parameters; None if the run has no solution."""
        if q.tobytes() in self.kept:
            return self.kept[q.tobytes()]
        p, _ = self._outer(q)
        begin, result = clock.process_time(), None
        values = dict(zip(self.parameters, (float(number) for number in p), strict=True))
        try:
            stop = _StopWith(self.simulation)
            run = varied(self.simulation, values, [*tables_of(self.simulation), stop])
            by = [parameter.name for parameter in self.parameters]
            result = gradient(
                run, self.until, of=self.of, by=by, order=2, progress=lambda *_: stop.start(run)
            )
            self.alone = result.seconds
        except (StepError, ParameterError) as error:
            if not self.kept:
                raise
            if isinstance(error, ParameterError):
                expected = ("bounds whose values the run admits (", words_of(error), ")")
                raise ParameterError("fit.bounds", self.bounds.tolist(), *expected) from error
        except StopRequested as error:
            after = "" if self._restart is None else f"; a repeated call goes on from {self._restart.folder}"
            raise StopRequested(f"the fit was stopped in run {self.runs + 1}, as requested{after}") from error
        self.runs, self.spent = self.runs + 1, self.spent + clock.process_time() - begin
        self._keep(q, result)
        if self.progress is not None:
            text = ", ".join(f"{parameter.name} = {value:.6g}" for parameter, value in values.items())
            half = "not solved" if result is None else f"{0.5 * np.sum(self._residuals(result) ** 2):.6g}"
            self.progress(f"run {self.runs}: {text}: half the sum of squares {half}")
        return result

    def _residuals(self, outcome: Gradient) -> np.ndarray:
        data, sigma = (np.concatenate(list(columns.values())) for columns in (self.data, self.sigma))
        return (outcome.values - data) / sigma

    def residuals(self, q: np.ndarray) -> np.ndarray:
        """Residuals divided by standard deviations; infinite if the run has no solution."""
        result = self._at(q)
        return np.full(len(self.of), np.inf) if result is None else self._residuals(result)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Jacobian of the residuals by the unknowns of the search."""
        outcome = self._at(q)
        assert outcome is not None  # the search has accepted this point
        _, slopes = self._outer(q)
        return outcome.jacobian / np.concatenate(list(self.sigma.values()))[:, None] * slopes

    def run(self, tolerance: float) -> Fit:
        """Search for the least sum of squares."""
        from scipy.optimize import least_squares  # a tenth of the package's import time

        start = np.array([parameter.value for parameter in self.parameters])
        low, high = (self._inner(self.bounds[:, i]) for i in range(2))
        low, high = np.minimum(low, high), np.maximum(low, high)
        first, bounds = np.clip(self._inner(start), low, high), (low, high)
        solved = least_squares(
            self.residuals, first, self.jacobian, bounds, method="trf", xtol=tolerance, ftol=tolerance
        )
        tried = [result for result in self.kept.values() if result is not None]
        best = min(tried, key=lambda result: float(np.sum(self._residuals(result) ** 2)))
        p, cost = best.at, 0.5 * float(np.sum(self._residuals(best) ** 2))
        J = best.jacobian / np.concatenate(list(self.sigma.values()))[:, None]
        reduced = 2 * cost / max(len(self.of) - len(p), 1)
        scale = (reduced or 1.0) if self.is_estimated else 1.0
        if self.is_estimated:  # scales by the estimated deviation
            self.sigma = {name: values * np.sqrt(reduced) for name, values in self.sigma.items()}
        covariance = _covariance(J / np.sqrt(scale))
        deviations = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore"):
            correlation = covariance / np.outer(deviations, deviations)
        sizes = np.cumsum([len(values) for values in self.data.values()])[:-1]
        of_columns = dict(zip(self.data, np.split(best.values, sizes), strict=True))
        return Fit(
            by=best.by,
            start=start,
            values=p,
            deviations=deviations,
            bounds=self.bounds,
            covariance=covariance,
            correlation=correlation,
            columns=tuple(self.data),
            times=self.times,
            data=self.data,
            found=of_columns,
            sigma=self.sigma,
            misfit=cost / scale,
            reduced=reduced / scale,
            runs=self.runs,
            cost=self.spent / self.alone,
            message=str(solved.message).replace("`", ""),
        )


def _name(run: int) -> str:
    """Name of the part of the restart folder that holds run number ``run``."""
    return f"run-{run:04d}"


def _covariance(J: np.ndarray) -> np.ndarray:
    """Covariance (J^T J)^-1, infinite if the data do not determine all parameters."""
    lengths = np.linalg.norm(J, axis=0)
    _, sizes, V = np.linalg.svd(J / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    if len(sizes) < len(lengths) or sizes[-1] <= _UNDETERMINED * sizes[0]:
        return np.full((J.shape[1], J.shape[1]), np.inf)
    return (V.T / sizes**2) @ V / np.outer(lengths, lengths)


def _deviation(sigma: float | Mapping[str, float] | None, name: str, values: np.ndarray) -> float:
    if sigma is None:
        return float(np.sqrt(np.mean(values**2))) or 1.0
    given = sigma.get(name) if isinstance(sigma, Mapping) else sigma
    number = as_number(given)
    if number is None or number <= 0:
        raise ParameterError("fit.sigma", given, f"a standard deviation > 0 of the column {name}")
    return number


def _bounds(parameter: Named, given: tuple[float, float] | None) -> tuple[float, float]:
    value = parameter.value
    if given is None:
        if value == 0:
            raise ParameterError("fit.bounds", None, f"bounds of {parameter.name}, since the start is 0")
        low, high = sorted((value / _RANGE, value * _RANGE))
        return low, high
    try:
        low, high = (float(bound) for bound in given)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not low < high or not low <= value <= high:
        expected = f"two numbers LOW, HIGH with the start value {value:g} between them"
        raise ParameterError(f"fit.bounds[{parameter.name!r}]", given, expected)
    return low, high

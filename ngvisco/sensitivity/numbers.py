"""Numbers of a run: values of columns at given times, integrals of columns, and misfits against data."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ngvisco.errors import Declared, ParameterError, as_number, as_numbers, require_collection

if TYPE_CHECKING:
    from ngvisco.sensitivity.columns import Columns

Balanced = tuple[str, list[str]]
"""A column of the state, and the columns of impulses in a step.  The defect of the balance is the change of
the first column in a step less the sum of the impulses."""
_TEXT = re.compile(r"(?P<column>\S+)\s+(?P<kind>at|until)\s+(?P<time>\S+)")


@dataclass(frozen=True)
class History:
    """Columns at the ends of steps, and their integrals up to these times, (steps + 1, columns, ...).

    Columns that are means over a step's stages, such as rates, are zero in the row of the start.  If a
    column has exchanges in a step, such as impulses, its integral is the sum of the exchanges over the
    steps.
    """

    times: np.ndarray
    ends: np.ndarray
    integrals: np.ndarray


@dataclass(frozen=True)
class Wanted:
    """The value of a column at a time, or its integral up to this time.

    Attributes
    ----------
    column : str
        Column of the ledger or of a table of the run's observers (``Probes``, ``Integrals``, ``WallForces``,
        ``Bodies``), e.g. ``"kinetic"``, ``"tip.velocity_1"``, ``"top.force_2"``.
    time : float
        Time, s; values between the ends of two steps are interpolated linearly.
    is_integral : bool
    """

    column: str
    time: float
    is_integral: bool = False

    @classmethod
    def of(cls, text: str) -> Wanted:
        """Read a text ``"COLUMN at TIME"`` or ``"COLUMN until TIME"``, the time in s.

        Raises ParameterError for any other text.
        """
        match = _TEXT.fullmatch(text.strip()) if isinstance(text, str) else None
        number = None
        if match is not None:
            try:
                number = as_number(float(match["time"]))
            except ValueError:
                number = None
        if match is None or number is None:
            expected = '"COLUMN at TIME", or "COLUMN until TIME" for the integral over time, with TIME in s'
            raise ParameterError("of", text, expected)
        return cls(match["column"], number, match["kind"] == "until")

    def weights(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the column's values at the ends of steps, ``times``, and of its integrals up to these
        times."""
        upper = int(np.clip(np.searchsorted(times, self.time * (1 - 1e-12)), 1, len(times) - 1))
        share = (self.time - times[upper - 1]) / (times[upper] - times[upper - 1])
        share = float(np.clip(share, 0.0, 1.0))
        chosen = np.zeros(len(times))
        chosen[upper - 1], chosen[upper] = 1 - share, share
        nothing = np.zeros(len(times))
        return (nothing, chosen) if self.is_integral else (chosen, nothing)


@dataclass(frozen=True)
class Misfit:
    """Half the sum of squares of the differences from data, each in units of its standard deviation.

    Raises ParameterError for invalid data.

    Parameters
    ----------
    data : mapping of texts to numbers
        Measured values, in SI units, by ``"COLUMN at TIME"`` or ``"COLUMN until TIME"``.
    sigma : float or sequence of float
        Standard deviation, > 0, of all data or of each datum.
    """

    data: Mapping[str, float]
    sigma: float | Sequence[float] = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.data, Mapping) or not self.data:
            raise ParameterError("Misfit.data", self.data, 'a mapping such as {"tip.velocity_1 at 0.5": 0.1}')
        for name, value in self.data.items():
            Declared("", (float,)).taken(f"Misfit.data[{name!r}]", value)
        expected = "one number > 0, or as many as there are data"
        one = as_number(self.sigma)
        deviations = [one] * len(self.data) if one else as_numbers("Misfit.sigma", self.sigma, expected)
        if len(deviations) != len(self.data) or min(deviations) <= 0:
            raise ParameterError("Misfit.sigma", self.sigma, expected)

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Differences of ``values`` from the data, in units of the standard deviations."""
        return (values - np.array(list(self.data.values()))) / np.asarray(self.sigma)


@dataclass(frozen=True)
class Numbers:
    """Numbers by name.

    A number is one part (the value of a column at one time, or the column's integral), or a misfit of several
    parts.
    """

    wanted: tuple[Wanted, ...]
    """The parts of all numbers."""
    of_names: dict[str, tuple[slice, Misfit | None]]
    balances: Mapping[str, Balanced] = field(default_factory=dict)

    @property
    def columns(self) -> list[str]:
        """The columns of which the parts are linear functions."""
        names: list[str] = []
        for part in self.wanted:
            state, impulses = self.balances.get(part.column, (part.column, []))
            names += [state, *impulses]
        return list(dict.fromkeys(names))

    @classmethod
    def of(
        cls,
        of: Sequence[str] | Mapping[str, str | Misfit],
        until: float,
        begin: float = 0.0,
        balances: Mapping[str, Balanced] | None = None,
    ) -> Numbers:
        """The numbers for the argument ``of`` of ``gradient``, in a run from ``begin`` to ``until``, s.

        ``balances`` has the columns that are defects of balances, see ``Momentum.balances``.  Raises
        ParameterError for an invalid text, and for a time outside the run.
        """
        expected = 'texts such as "kinetic at 0.5"'
        texts = () if isinstance(of, Mapping) else require_collection("of", of, expected)
        given = of if isinstance(of, Mapping) else {str(text): text for text in texts}
        numbers: list[Wanted] = []
        named: dict[str, tuple[slice, Misfit | None]] = {}
        for name, request in given.items():
            misfit = request if isinstance(request, Misfit) else None
            parts = [Wanted.of(text) for text in (request.data if isinstance(request, Misfit) else [request])]
            named[name] = slice(len(numbers), len(numbers) + len(parts)), misfit
            numbers += parts
        if not named:
            raise ParameterError("of", of, "at least one number of the run")
        end = as_number(until)
        for part in numbers:
            if end is None or not begin * (1 - 1e-12) <= part.time <= end * (1 + 1e-12):
                expected = f"a time of the run, which goes from t = {begin:g} s to its end t = {until} s"
                text = f"{part.column} {'until' if part.is_integral else 'at'} {part.time:g}"
                raise ParameterError("of", text, expected)
        return cls(tuple(numbers), named, balances or {})

    @property
    def names(self) -> list[str]:
        return list(self.of_names)

    def _weights(self, number: Wanted, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weights of the columns at the ends of steps, and of their integrals, (steps + 1, columns) each."""
        ends, integrals = (np.zeros((len(times), len(self.columns))) for _ in range(2))
        at_ends, of_integrals = number.weights(times)
        if number.column not in self.balances:
            column = self.columns.index(number.column)
            ends[:, column], integrals[:, column] = at_ends, of_integrals
            return ends, integrals
        state, impulses = self.balances[number.column]
        of_state = ends[:, self.columns.index(state)]
        of_state += at_ends + of_integrals
        of_state[:-1] -= at_ends[1:]  # the change in a step
        of_state[0] -= at_ends[0] + of_integrals.sum()
        for name in impulses:
            column = self.columns.index(name)
            ends[:, column], integrals[:, column] = -at_ends, -of_integrals
        return ends, integrals

    def parts(self, history: History) -> np.ndarray:
        """Values of the numbers before misfits are summed, (parts, ...): a misfit has one part for each
        datum, another number has one."""
        values = []
        for number in self.wanted:
            parts = zip(self._weights(number, history.times), (history.ends, history.integrals), strict=True)
            # columns without a weight are left out, since they may be NaN
            read = [(weights, rows, weights.any(axis=0)) for weights, rows in parts]
            values.append(sum(np.tensordot(w[:, at], rows[:, at], 2) for w, rows, at in read))
        return np.array(values)

    def values(self, parts: np.ndarray) -> np.ndarray:
        """Values of the numbers from values of their parts, (numbers,)."""
        return np.array(
            [
                parts[where][0] if misfit is None else 0.5 * np.sum(misfit.residuals(parts[where]) ** 2)
                for where, misfit in self.of_names.values()
            ]
        )

    def coefficients(self, parts: np.ndarray) -> np.ndarray:
        """Derivatives of the numbers by their parts, (numbers, parts)."""
        result = np.zeros((len(self.of_names), len(parts)))
        for row, (at, misfit) in zip(result, self.of_names.values(), strict=True):
            row[at] = 1.0 if misfit is None else misfit.residuals(parts[at]) / np.asarray(misfit.sigma)
        return result

    def weights(self, history: History, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the numbers by columns at the ends of steps, and by columns' means over stages.

        Both arrays are (numbers, steps + 1, columns).
        """
        times, of_stages = history.times, columns.is_of_stages
        lengths = np.diff(times, prepend=times[0])[:, None]
        ends, integrals = np.moveaxis(np.array([self._weights(n, times) for n in self.wanted]), 1, 0)
        # the integral up to a time contains all steps before it
        means = np.flip(np.cumsum(np.flip(integrals, 1), 1), 1)
        means *= lengths
        means += np.where(of_stages, ends * np.where(columns.is_of_steps, lengths, 1.0), 0.0)
        coefficients = self.coefficients(self.parts(history))
        of_ends = np.where(of_stages, 0.0, ends)
        return np.tensordot(coefficients, of_ends, 1), np.tensordot(coefficients, means, 1)

"""Errors on a sequence of meshes or steps, and their rates."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.verification.case import Curve, Plot, Table, VerificationError


def extrapolated(coarse: Any, middle: Any, fine: Any) -> Any:
    """Of steps tau, tau/2 and tau/4 twice to none: errors of first and second order go."""
    return (8 * fine - 6 * middle + coarse) / 3


@dataclass
class RateTable:
    """Errors on a sequence of meshes or steps, each half the last."""

    title: str
    sizes: list[float] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=dict)

    def rates(self, name: str) -> list[float]:
        e = np.array(self.errors[name])
        h = np.array(self.sizes)
        return list(np.log(e[:-1] / e[1:]) / np.log(h[:-1] / h[1:]))

    def __str__(self) -> str:
        lines = [self.title]
        for name, errors in self.errors.items():
            rates = ["", *(f"({rate:.2f})" for rate in self.rates(name))]
            lines.append(
                f"  {name:8s}" + "  ".join(f"{e:.3e} {r:>6s}" for e, r in zip(errors, rates, strict=True))
            )
        return "\n".join(lines)

    def add(self, size: float, **errors: float) -> None:
        """A further row."""
        self.sizes.append(size)
        for name, error in errors.items():
            self.errors.setdefault(name, []).append(error)

    def require(self, **least: float) -> None:
        """Ask for the rate of the finest pair of every named column, and print the table.

        Raises VerificationError if one is smaller (or not a number); the message is the table.
        """
        print(self)
        for name, rate in least.items():
            if not self.rates(name)[-1] >= rate:
                raise VerificationError(f"rate of {name} < {rate}\n{self}")

    def last(self, name: str) -> float:
        """The rate of the finest pair."""
        return float(self.rates(name)[-1])

    def lasts(self, quantity: str = "rate of {}") -> list[tuple[str, float]]:
        """The rate of the finest pair of every column, by a quantity with the column's name in it."""
        return [(quantity.format(name), self.last(name)) for name in self.errors]

    def shown(
        self, size: str, error: str = "error", slope: float | None = None, of: str = ""
    ) -> tuple[Table, Plot]:
        """``table`` and ``plot``."""
        return self.table(size), self.plot(size, error, slope, of)

    def table(self, size: str = "h") -> Table:
        """Sizes, errors and rates, a row for each size."""
        columns = [size]
        for name in self.errors:
            columns += [name, "rate"]
        rows: list[list[str | float]] = []
        for i, h in enumerate(self.sizes):
            row: list[str | float] = [h]
            for name, errors in self.errors.items():
                row += [errors[i], f"{self.rates(name)[i - 1]:.2f}" if i else ""]
            rows.append(row)
        return Table(self.title, columns, rows)

    def plot(self, size: str = "h", error: str = "error", slope: float | None = None, of: str = "") -> Plot:
        """Errors over sizes, doubly logarithmic; with a line of a slope through a column's last point."""
        curves = [Curve(name, self.sizes, errors) for name, errors in self.errors.items()]
        if slope is not None:
            last = self.errors[of or next(iter(self.errors))][-1]
            line = [last * (s / self.sizes[-1]) ** slope for s in self.sizes]
            curves.append(Curve(f"slope {slope:g}", self.sizes, line, "k--"))
        return Plot(self.title, size, error, curves, log="xy")

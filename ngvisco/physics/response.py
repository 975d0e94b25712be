"""The response of a material at points: its energy and the first two derivatives, as arrays."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np


@dataclass(frozen=True)
class Response:
    """An energy, (n,), Pa, at n states of N components, its slope, (n, N), and Hessian, (n, N, N)."""

    energy: np.ndarray
    slope: np.ndarray
    hessian: np.ndarray
    failure: str | None = None
    """The reason why some entries are NaN; None if all are finite."""

    @property
    def finite(self) -> np.ndarray:
        """Mask of the states whose energy and derivatives are finite, (n,)."""
        matrices = np.isfinite(self.hessian).all(axis=(1, 2))
        return np.isfinite(self.energy) & np.isfinite(self.slope).all(axis=1) & matrices


Respond: TypeAlias = Callable[..., Response]
"""Function of states, (n, N), that gives their response.

For a material with lagged variables (``Material.lagged``) it has a second argument, (n, N): the states with
the lagged variables' values at the step's start. The slopes by all other variables read these states."""

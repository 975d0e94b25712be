"""Anderson acceleration of a fixed-point iteration x <- x - f(x)."""

from __future__ import annotations

import numpy as np


class Anderson:
    """Type II, by least squares over the last ``depth`` differences of f.

    (D. G. Anderson 1965; H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49, 2011.)
    """

    def __init__(self, depth: int, conditioning: float = 1e-3) -> None:
        """``depth`` differences are kept; directions smaller than ``conditioning`` are dropped."""
        self.depth, self.conditioning = depth, conditioning
        self.restart()

    def restart(self) -> None:
        """Forget the differences."""
        self._dx: list[np.ndarray] = []
        self._df: list[np.ndarray] = []
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def step(self, x: np.ndarray, f: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """The next x; lengths are measured in f/scale."""
        if self._last is not None:
            self._dx.append(x - self._last[0])
            self._df.append((f - self._last[1]) / scale)
            if len(self._dx) > self.depth:
                self._dx.pop(0)
                self._df.pop(0)
        self._last = (x.copy(), f.copy())
        if not self._df:
            return x - f
        differences = np.array(self._df)
        size = np.linalg.norm(differences, axis=1)
        size[size == 0] = 1.0
        differences /= size[:, None]
        gamma = np.linalg.lstsq(differences.T, f / scale, rcond=self.conditioning)[0] / size
        result = x - f
        for g, dx, df in zip(gamma, self._dx, self._df, strict=True):
            result -= g * (dx - df * scale)
        return result

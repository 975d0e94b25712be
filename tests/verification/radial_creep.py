"""The creep rate's equation with a gradient term on a ball, by itself: a reference in one dimension.

For a driving stress M = m(r) D on a disc or a ball, D a constant tensor of size one, Pi = a(r) D with

    G_m a - r^{1-d} (r^{d-1} nu |a'|^{q-2} a')' = m   in 0 < r < R,   a'(0) = a'(R) = 0:

a minimises int (G_m a^2/2 + nu |a'|^q/q - m a) r^{d-1} dr.  Here that is done by linear elements on thousands
of intervals and a damped Newton iteration, in NumPy, with nothing of the package's forms or spaces.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from tests.verification.case import VerificationError

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_ITERATIONS, _DECREMENT = 200, 1e-15
"""Of Newton's iteration: how long, and the relative decrease of the energy at which it ends."""


@dataclass(frozen=True)
class RadialCreep:
    """The problem; ``dim`` is 2 or 3, ``driving`` is m as a function of arrays of r."""

    dim: int
    radius: float
    G_m: float
    nu: float
    q: float
    driving: Callable[[np.ndarray], np.ndarray]

    def solve(self, intervals: int = 4000) -> tuple[np.ndarray, np.ndarray]:
        """Nodes r and values a(r); raises VerificationError if the iteration does not end."""
        r = np.linspace(0.0, self.radius, intervals + 1)
        h = r[1] - r[0]
        share = 0.5 * (_POINTS + 1)
        at = r[:-1, None] + h * share
        volume = 0.5 * h * _WEIGHTS * at ** (self.dim - 1)
        shapes = np.stack([1 - share, share])

        def gathered(of_cells: np.ndarray) -> np.ndarray:
            """Sums of (2, cells) over the nodes."""
            result = np.zeros(intervals + 1)
            result[:-1] += of_cells[0]
            result[1:] += of_cells[1]
            return result

        load = gathered(np.stack([(volume * self.driving(at) * s).sum(axis=1) for s in shapes]))
        mass = self.G_m * np.einsum("cp,ap,bp->abc", volume, shapes, shapes)
        size = volume.sum(axis=1)

        def energy(a: np.ndarray) -> float:
            slope = np.diff(a) / h
            squares = np.einsum("abc,ac,bc->", mass, np.stack([a[:-1], a[1:]]), np.stack([a[:-1], a[1:]]))
            return float(0.5 * squares + self.nu / self.q * (size * abs(slope) ** self.q).sum() - load @ a)

        def slope_of(a: np.ndarray) -> np.ndarray:
            ends, slope = np.stack([a[:-1], a[1:]]), np.diff(a) / h
            flux = self.nu * size * abs(slope) ** (self.q - 2) * slope / h
            return gathered(np.einsum("abc,bc->ac", mass, ends) + np.stack([-flux, flux])) - load

        a = self.driving(r) / self.G_m
        for _ in range(_ITERATIONS):
            residual = slope_of(a)
            stiff = self.nu * (self.q - 1) * size * abs(np.diff(a) / h) ** (self.q - 2) / h**2
            matrix = np.zeros((3, intervals + 1))
            matrix[1] = gathered(np.stack([mass[0, 0], mass[1, 1]]) + stiff)
            matrix[0, 1:] = matrix[2, :-1] = mass[0, 1] - stiff
            step = solve_banded((1, 1), matrix, -residual, check_finite=False)
            damping, before = 1.0, energy(a)
            if -(residual @ step) <= _DECREMENT * abs(before):
                return r, a
            while (
                energy(a + damping * step) > before + 1e-4 * damping * (residual @ step) and damping > 1e-10
            ):
                damping *= 0.5
            a = a + damping * step
        raise VerificationError("the radial creep rate has not converged")

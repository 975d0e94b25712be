"""A tube in uniaxial strain by another method: Lagrangian coordinates and ordinary differential equations.

    lambda' = d_X v,   rho_0 v' = d_X (P(lambda) + (K_v + 4/3 G_v) lambda'/lambda),   P = dW/dlambda,

with W the energy per referential volume of F = diag(lambda, 1, 1) and rho = rho_0/lambda.  It shares no line
of code with the solver.
"""

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.integrate import solve_ivp

Stress = Callable[[np.ndarray], np.ndarray]


def densities(
    stress: Stress, viscosity: float, velocity: Stress, times: Sequence[float], line: np.ndarray, cells: int
) -> np.ndarray:
    """rho/rho_0 at the places ``line`` (m) and ``times`` (s), (times, places).

    Parameters
    ----------
    stress : callable
        P of lambda, Pa, for a density rho_0 of 1 kg/m3.
    viscosity : float
        K_v + 4/3 G_v, Pa s.
    velocity : callable
        v at the first time of a place in the tube of 1 m, periodic; odd, so that x = 0 stays at rest.
    cells : int
        Cells of equal reference length, with lambda in the middle and v between them.
    """
    h = 1.0 / cells
    X = h * np.arange(cells)

    def rate(_: float, u: np.ndarray) -> np.ndarray:
        stretch, v = u[:cells], u[cells:]
        stretching = (np.roll(v, -1) - v) / h  # cell i lies between the nodes i and i + 1
        total = stress(stretch) + viscosity * stretching / stretch
        return np.concatenate([stretching, (total - np.roll(total, 1)) / h])

    ring = sp.diags([1.0] * 5, [-1, 0, 1, cells - 1, 1 - cells], shape=(cells, cells))
    result = solve_ivp(
        rate,
        (0.0, times[-1]),
        np.concatenate([np.ones(cells), velocity(X)]),
        method="BDF",
        t_eval=times,
        jac_sparsity=sp.bmat([[ring, ring], [ring, ring]]),
        rtol=1e-6,
        atol=1e-8,
    )
    if not result.success:
        raise RuntimeError(f"the tube's reference solution failed: {result.message}")
    profiles = []
    for stretch in result.y[:cells].T:
        middle = h * (np.cumsum(stretch) - 0.5 * stretch)
        profiles.append(np.interp(line, middle, 1 / stretch, period=1.0))
    return np.array(profiles)

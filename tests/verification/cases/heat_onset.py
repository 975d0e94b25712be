"""Convection at its onset against the linear theory; heat in motion against manufactured solutions."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, Integrate, cos, sin, x, y
from numpy.polynomial import Polynomial
from scipy.linalg import eig

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.physics.variables import Jacobian
from tests.verification.case import Cases, Measured, RateTable, Table
from tests.verification.convergence import coupled_rates, free_solution
from tests.verification.manufactured import Sources
from tests.verification.setups import followed, separation

CASES = Cases("Heat")

# --- the onset of convection ---------------------------------------------------------------------------

POINTS = 24
"""Chebyshev intervals of the eigenvalue problem."""


@dataclass(frozen=True)
class Plates:
    """Two plates 1 m apart, and the onset of convection between them.

    ``wall`` makes a plate with a ``WallHeat``.  At a plate, W, Theta and the derivative of W of the order
    ``derivative`` vanish.  ``wave`` is the critical wave number, 1/m, and ``critical`` the critical Rayleigh
    number.  The first Rayleigh number of ``numbers`` is below the critical number, the second above it."""

    wall: Callable[..., Any]
    derivative: int
    wave: float
    critical: float
    numbers: tuple[float, float]


SLIP = Plates(nv.Slip, 2, math.pi / math.sqrt(2), 657.511, (600.0, 720.0))
NO_SLIP = Plates(nv.NoSlip, 1, 3.117, 1707.762, (1600.0, 1800.0))


def _mode(plates: Plates, Ra: float) -> tuple[float, Polynomial, Polynomial]:
    """Growth, W and Theta of the fastest mode exp(growth t) (W, Theta)(y) cos(k x), for nu = kappa/c = 1.

    The mode is found by collocation of (D^2 - k^2 - s)(D^2 - k^2) W = Ra k^2 Theta, (D^2 - k^2 - s) Theta =
    -W."""
    n, k = POINTS, plates.wave
    points = np.cos(np.pi * np.arange(n + 1) / n)
    weights = np.r_[2, np.ones(n - 1), 2] * (-1.0) ** np.arange(n + 1)
    D = np.outer(weights, 1 / weights) / (points[:, None] - points + np.eye(n + 1))
    D = 2 * (D - np.diag(D.sum(axis=1)))  # the matrix D differentiates values at Chebyshev's points
    one, zero = np.eye(n + 1), np.zeros((n + 1, n + 1))
    laplace = D @ D - k * k * one
    A = np.block([[laplace @ laplace, -Ra * k * k * one], [one, laplace]])
    B = np.block([[laplace, zero], [zero, one]])
    W_walls, slopes = (
        np.hstack([of[[0, n]], 0 * of[[0, n]]]) for of in (one, np.linalg.matrix_power(D, plates.derivative))
    )
    rows = np.vstack([W_walls, slopes, np.roll(W_walls, n + 1, axis=1)])
    at = [0, n, 1, n - 1, n + 1, 2 * n + 1]
    A[at], B[at] = rows, 0.0
    values, vectors = eig(A, B)
    growth = np.where(np.isfinite(values) & (abs(values) < 1e6), values.real, -np.inf)
    first = int(growth.argmax())
    vector = (vectors[:, first] / vectors[n // 2, first]).real
    places = (points + 1) / 2
    W, Theta = (Polynomial.fit(places, of, 12, domain=[0, 1], window=[0, 1]) for of in np.split(vector, 2))
    return float(growth[first]), W, Theta


def _at_height(polynomial: Polynomial) -> CoefficientFunction:
    value = CF(0.0)
    for coefficient in polynomial.coef[::-1]:
        value = value * y + float(coefficient)
    return value


def _rolls(plates: Plates, Ra: float, amplitude: float) -> np.ndarray:
    """Amplitudes, m/s, of half of a roll that starts with the velocity of its mode, after steps of 0.01 s.

    The fluid is nearly incompressible: expansion 3e-3/K, 1 K between the plates, g/K_e < 1e-3/m, isentropic
    slope 2e-3 K/m.
    """
    expansion, K_e, c, middle = 3e-3, 1e9, 1e7, 10.0
    (_, *mode), k, g = _mode(plates, Ra), plates.wave, Ra / expansion
    cold = nv.CustomMaterial(
        transported=(Jacobian(),), stored_energy=lambda J: K_e / 2 * (J - 1) * (J - 1) / J
    )
    model = nv.Model(
        material=nv.Thermal(material=cold, c=c, theta_R=middle, expansion=expansion),
        viscosity=nv.StokesViscosity(K_v=1.0, G_v=1.0),
        heat=nv.Heat(conductivity=c),
        loads=(nv.Gravity((0.0, -g)),),
    )
    walls: Any = {
        name: plates.wall(heat=nv.WallHeat(temperature=middle + above, coefficient=1e5 * c))
        for name, above in (("bottom", 0.5), ("top", -0.5))
    }
    W, slope, Theta = (_at_height(of) for of in (mode[0], mode[0].deriv(), mode[1]))
    warmer = 0.5 - y + amplitude * Theta * cos(k * x)
    J = 1 + g / K_e * (y - 0.5) + expansion * warmer
    start = nv.Initial(
        density=1 / J,
        F=CF((1, 0, 0, 0, J, 0, 0, 0, 1), dims=(3, 3)),
        temperature=middle + warmer,
        velocity=(-amplitude / k * slope * sin(k * x), amplitude * W * cos(k * x)),
    )
    mesh = box((math.pi / k, 1), maxh=0.25)
    run = nv.Simulation(
        mesh,
        model,
        time=nv.TimeSteps(dt=0.01, scheme="midpoint", velocity_scale=100.0),
        initial=start,
        walls=walls,
        solver="coupled",
        discretisation=nv.Discretisation(k=3, m=2),
        newton=nv.NewtonOptions(tolerance=1e-7),  # pressures are rounded to 1e-16 K_e
    )
    rising = run.fields["velocity"][1] * cos(k * x) * W
    return followed(run, 15, lambda run: Integrate(rising, mesh, order=10))[1][1:]


def _onset(plates: Plates) -> Measured:
    """Growth below and above the onset. The amplitude is half of the difference of two runs, in which effects
    of second order cancel."""
    rows, size = [], plates.wave**2 + math.pi**2
    for Ra in plates.numbers:
        roll = 0.5 * (_rolls(plates, Ra, 0.05) - _rolls(plates, Ra, -0.05))
        # fit a line, as undamped sound remains in the differences of steps
        found = 100 * float(np.polyfit(np.arange(10), np.log(roll[-10:]), 1)[0])
        expected = _mode(plates, Ra)[0]
        rows.append([Ra, found, expected, abs(found - expected) / size])
    root = float(np.interp(0.0, [row[1] for row in rows], np.sqrt(plates.numbers)))
    yield "error of the growth over k^2 + pi^2", max(row[3] for row in rows)
    yield "error of the critical Rayleigh number", abs(root**2 / plates.critical - 1)
    yield from Table("growth of a roll", "Ra | growth, 1/s | theory, 1/s | error", rows).drawn(0, 1, 2)


_SETTING = (
    "Half of a roll of the critical wave number, plates 1 K apart, 34 cells of 0.25 m with P3 velocities and "
    "P2 fields, midpoint rule; the start is the theory's mode with both signs. Two Rayleigh numbers, and "
    "their growths interpolated over sqrt(Ra).  The bounds were written after trials on coarser cells."
)
_BOUNDS = """- error of the growth over k^2 + pi^2 <= 0.01: (pi h)^4/72 = 5e-3 of P2, 1e-3 of the fluid
    - error of the critical Rayleigh number <= 0.01: as much; (k^2 + pi^2)/Ra is a growth's share"""

for name, plates, what, source in (
    ("heat-onset", SLIP, "slip sets in", "Rayleigh 1916: 657.5 between walls that slip"),
    (
        "heat-onset-no-slip",
        NO_SLIP,
        "hold the fluid sets in",
        "Jeffreys 1928, Chandrasekhar 1961: 1707.762 between walls without slip",
    ),
):
    CASES(f"""{name}
        Convection between plates that {what} at the critical Rayleigh number.
        label: {source}
        setting: {_SETTING}
        {_BOUNDS}
        """)(partial(_onset, plates))


# --- manufactured solutions ----------------------------------------------------------------------------

KIND = "with heat"


class WithoutItsHeat(Sources):
    """Sources that include neither the heat of dissipation nor the conduction of heat."""

    def heating(self, Pi: CoefficientFunction) -> CoefficientFunction:
        return CF(0.0)


def _in_space(p: float | None) -> Measured:
    right, wrong = (
        coupled_rates(KIND, 2, p, 2, 1, 0.4, 3, regularised=p is not None, delta=False, sources=sources)
        for sources in (Sources, WithoutItsHeat)
    )
    wrong.title += ", sources without heat"
    yield from right.lasts()
    yield "rate of z, control without heat in the sources", wrong.last("z")
    yield from (right, wrong.table())


HYPER = "viscosity, hyperviscosity with p = 4, epsilon |v|^(p-2) v and creep"
for name, p, terms, (of_v, others) in (
    ("heat-moving", None, "viscosity and creep", (2.7, 1.85)),
    ("heat-moving-hyper", 4.0, HYPER, (1.7, 1.75)),
):
    CASES(f"""{name}
        A moving body that is heated by {terms}, and conducts it, converges to a manufactured solution of v,
          rho, F, J, A and s.
        label: heat-entropy, heat-temperature
        setting: Unit square, 0.4 m refined twice, k = 2, m = 1; gruneisen = 0.8, kappa = theta^1.5/4 W/(m K),
          gravity; two steps of 0.05 s with the discrete time derivative in the sources.
        - rate of v >= {of_v}: as without heat
        - rate of [rho; z] >= {others}: as without heat
        - rate of z, control without heat in the sources <= 0.5: an error stays
        """)(partial(_in_space, p))


@CASES("""heat-moving-time
    With manufactured sources that drive every mechanism and heat, the midpoint rule is of order 2 in v, rho
      and z, the entropy among these.
    label: heat-weak
    setting: As heat-moving with hyperviscosity (p = 2) and epsilon-terms; one mesh, differences of successive
      runs of 4, 8, 16, 32 steps in 0.1 s.
    - rate of [v; rho; z] >= 1.9: second order
    """)
def _in_time() -> Measured:
    options: dict[str, Any] = {"delta": False, "scheme": "midpoint", "velocity_scale": 3e5}
    counts = (4, 8, 16, 32)
    runs = [free_solution(KIND, steps, 0.1, p=2.0, driven=True, **options) for steps in counts]
    table = RateTable("differences of successive steps", "tau, s")
    for steps, (coarse, fine) in zip(counts, pairwise(runs), strict=False):
        table.add(0.1 / steps, **separation(fine, coarse))
    yield from table.lasts()
    yield table

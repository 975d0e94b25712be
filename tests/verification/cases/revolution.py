"""Bodies of revolution: the radial modes of a free ball on a mesh of its meridian's half disc.

The mode nS0 has the displacement j_1(k r) along the radius, with k = omega/c_p. No traction on r = 1 gives
tan k = k/(1 - (c_p/c_s)^2 k^2/4) (Lamb 1882).  At the axis v_r/r is a third of the dilatation.
"""

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, InnerProduct, x, y
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import half_disc
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.setups import followed, swing_by_midpoint

CASES = Cases("Exact solutions: waves")

K_E, G_E = 1.0, 0.5
SIZES = (0.5, 0.25)
PERIODS, PER_PERIOD, FASTEST = 1, 24, 1e-5
BRACKETS = ((1.8, 3.1), (4.8, 6.2))
"""Brackets of the roots k of 0S0 and 1S0."""
TERMS = 24


def root(n: int) -> float:
    """The wave number k of nS0, 1/m."""
    ratio = (K_E + 4 / 3 * G_E) / G_E
    return float(brentq(lambda k: math.tan(k) * (1 - ratio * k * k / 4) - k, *BRACKETS[n], xtol=1e-14))


def mode(n: int) -> CoefficientFunction:
    """The velocity 3 j_1(k r)/(k r) x as a power series, which is smooth at the centre."""
    square, radial, term = root(n) ** 2 * (x * x + y * y), CF(0.0), CF(1.0)
    for i in range(TERMS):
        radial = radial + term
        term = -term * square / ((2 * i + 2) * (2 * i + 5))
    return radial * CF((x, y))


def oscillation(n: int, maxh: float) -> tuple[nv.Simulation, complex, np.ndarray]:
    """Run a mode by the midpoint rule, starting with its velocity and no strain.

    Returns the run, s = -decay + i frequency, and the projection of v on the mode over its initial value."""
    shape, omega = mode(n), root(n) * math.sqrt(K_E + 4 / 3 * G_E)
    tau = 2 * math.pi / omega / PER_PERIOD
    run = nv.Simulation(
        half_disc(1.0, maxh),
        nv.Model(material=nv.LinearElastic(K_e=K_E, G_e=G_E)),
        time=nv.TimeSteps(dt=tau, scheme="midpoint", velocity_scale=1.0),
        initial=nv.Initial(velocity=FASTEST * shape),
        walls={"wall": nv.Open()},
        symmetry="axisymmetric",
    )
    moment, integrate = InnerProduct(run.fields["velocity"], shape), run.rothe_step.quadrature.integrate_cells
    _, values = followed(run, PERIODS * PER_PERIOD, lambda run: integrate(moment))
    return run, swing_by_midpoint(values, tau), values / values[0]


@CASES(f"""radial-modes
    An elastic ball without traction on its surface, computed as a body of revolution, swings in its radial
      modes 0S0 and 1S0 with Lamb's frequencies, and does not move along its axis.
    label: Euler-small-viscoelastodyn+; Lamb 1882
    setting: R = 1 m, rho = 1 kg/m3, K_e = {K_E:g} Pa, G_e = {G_E:g} Pa, no viscosity; curved triangles of a
      half disc, maxh = {SIZES[0]:g} and {SIZES[1]:g} m, k = 2, m = 1; midpoint, {PER_PERIOD} steps a period;
      the step's own factor is undone.
    - relative error of 0S0 <= 1e-3: four quadratic cells in a radius
    - relative error of 1S0 <= 1e-2: four quadratic cells in a radius
    - least of both errors >= 1e-8: a smaller error would not be the mesh's
    - least ratio of the errors of both meshes >= 3.0: order h^2 at least: 2^2 = 4
    - change of the momentum along the axis, over the integral of its size <= 1e-3: the mesh is not symmetric
    - change of the energy <= 1e-4: the problem is linear except for upwinding
    - closure
    """)
def _radial() -> Measured:
    rows, curves, errors, changes, moved = [], [], {}, [], []
    for n in range(len(BRACKETS)):
        exact = root(n) * math.sqrt(K_E + 4 / 3 * G_E)
        for maxh in SIZES:
            run, s, values = oscillation(n, maxh)
            errors[n, maxh] = abs(abs(s.imag) / exact - 1)
            energy = run.ledger.column("kinetic") + run.ledger.column("stored")
            changes.append(abs(float(energy[-1] / energy[0]) - 1))
            sizes = run.ledger.column("momentum_size")
            moved.append(float(np.abs(run.ledger.column("momentum_2")).max() / sizes.max()))
            rows.append([n, run.mesh.ne, abs(s.imag), exact, abs(s.imag) / exact - 1, -s.real])
        curves.append(Curve(f"{n}S0", run.ledger.column("time") * exact / (2 * math.pi), values, "o"))
    coarse, best = SIZES
    for n in range(len(BRACKETS)):
        yield f"relative error of {n}S0", errors[n, best]
    yield "least of both errors", min(errors[n, best] for n in range(len(BRACKETS)))
    yield (
        "least ratio of the errors of both meshes",
        min(errors[n, coarse] / errors[n, best] for n in range(len(BRACKETS))),
    )
    yield "change of the momentum along the axis, over the integral of its size", max(moved)
    yield "change of the energy", max(changes)
    yield Table("frequencies", "n | triangles | omega, 1/s | exact | error | decay, 1/s", rows)
    fine = np.linspace(0, PERIODS, 200)
    curves.append(Curve("exact", fine, np.cos(2 * math.pi * fine), "k-"))
    yield Plot("Radial modes, finer mesh", "t, periods of each", "amplitude of v", curves)

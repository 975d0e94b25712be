"""A jelly of density 1 drops through a medium of a thousandth of it, bounces and settles.

Both have a viscosity of 1e-3 Pa s.  Without it backward Euler takes, iterations and rejected steps:

    density   tau, s   until, s
    0.1       0.01     0.4        338 and 0
    0.001     0.005    0.3        595 and 1, the first; 1,843 and 19 where points may be as light as rho > 0
    0.001     0.005    0.6        1,260 and 1

To 5 s it comes by the bounds of the tensors (``Mixture.bounds``): without these X has an eigenvalue of
-136 at 4.84 s in four cells at the floor, by (0.4, 0) m, where half is jelly, and velocities rise from 0.2 to
19 m/s.  Energies that are linear in X have no least value where it is not positive.

Where traces bear stress as the body does (``taking_part`` = {}) there is no step from 0.13 s on at 0.1.
"""

import numpy as np

import ngvisco as nv
from ngvisco.geometries import box
from ngvisco.run.ledger import NUMERICAL
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import fluid, stokes

CASES = Cases("Bodies and their interfaces")

BULK, SHEAR, VISCOSITY = 50.0, 1.0, 1e-3
"""K_e of both, G_e of the jelly, Pa; of both, Pa s."""
LIGHT, RADIUS, GRAVITY = 1e-3, 0.2, 1.0
"""Density of the medium, kg/m^3; m; m/s^2."""
TAU, END, FALLING = 0.005, 5.0, 0.2


def dropped(until: float, ratio: float = LIGHT, tau: float = TAU) -> tuple[nv.Simulation, nv.Bodies]:
    """The run until a time, s, with a medium of density ``ratio``, and its table."""
    jelly, thin = nv.Ball((0.5, 0.5), RADIUS), stokes(VISCOSITY)
    solid = nv.ReferentialNeoHookean(K_e=BULK, G_e=SHEAR)
    bodies = (
        nv.Body(name="jelly", where=jelly, material=solid, viscosity=thin, density=1.0),
        nv.Body(name="medium", material=fluid(BULK), viscosity=thin, density=ratio),
    )
    table = nv.Bodies()
    run = nv.Simulation(
        box((1, 1), 0.1),
        nv.Model(bodies=bodies, loads=(nv.Gravity((0.0, -GRAVITY)),)),
        time=nv.TimeSteps(dt=tau, velocity_scale=1.0),
        discretisation=nv.Discretisation(k=3),  # P_2 locks where volumes are stiff
        observers=[table],
    )
    run.run(until)
    return run, table


def lost(run: nv.Simulation) -> np.ndarray:
    """What each step takes of the total energy, gravity's included, J/m."""
    ledger = run.ledger
    rates = [ledger.column(entry.name) for entry in ledger.entries if entry.kind == "dissipation"]
    taken = [ledger.column(name) for name in NUMERICAL]
    return np.asarray((ledger.column("dt") * sum(rates) + sum(taken))[1:])


@CASES(f"""jelly-in-a-light-medium
    A jelly in a medium of a thousandth of its density drops as free fall says, bounces and settles; no step
      is repeated, and the total energy never rises by backward Euler.
    label: FORMULATION.md, Section 9
    setting: Unit box (slip), jelly of {RADIUS:g} m in its middle, G_e = {SHEAR:g} Pa, K_e = {BULK:g} Pa in
      both, densities 1 and {LIGHT:g} kg/m3, {VISCOSITY:g} Pa s, g = {GRAVITY:g} m/s2; 230 triangles,
      velocities of order 3, backward Euler, tau = {TAU:g} s until {END:g} s; energies over the fall's.
    - height at 0.2 s over free fall's, less one <= 0.01: buoyancy is a thousandth
    - how far it rises again, m >= 0.01: it bounces, though backward Euler damps
    - kinetic energy at the end over the largest <= 0.02: it settles
    - rejected steps <= 0.0: none
    - largest rise of the total energy in a step <= 1e-10: phi is jointly convex
    - bregman's negative parts <= 1e-11: phi is jointly convex
    - limiter's negative parts <= 1e-11: Jensen's inequality, momentum limited with mass
    - change of its mass <= 1e-10: conserved
    - closure
    """)
def _jelly() -> Outcome:
    run, table = dropped(END)
    ledger, times, height = run.ledger, table.column("time"), table.column("jelly_y")
    first, kinetic = float(np.interp(FALLING, times, height)), ledger.column("kinetic")
    low = int(np.argmax(np.diff(height) > 0))
    masses = table.column("jelly_mass")
    weight = GRAVITY * float(masses[0]) * (0.5 - RADIUS)
    free = 0.5 - GRAVITY * FALLING**2 / 2
    return measured(
        {
            "height at 0.2 s over free fall's, less one": abs(first / free - 1),
            "how far it rises again, m": float(height[low:].max() - height[low]),
            "kinetic energy at the end over the largest": float(kinetic[-1] / kinetic.max()),
            "rejected steps": float(ledger.column("rejections").sum()),
            "largest rise of the total energy in a step": float(-lost(run).min()) / weight,
            "bregman's negative parts": float(-np.minimum(ledger.column("bregman")[1:], 0).sum()) / weight,
            "limiter's negative parts": float(-np.minimum(ledger.column("limiter")[1:], 0).sum()) / weight,
            "change of its mass": float(np.abs(masses / masses[0] - 1).max()),
        },
        Table(
            "the jelly",
            "t, s | height of the centroid, m | kinetic energy, J/m | iterations | limited cells",
            [[times[i], height[i], kinetic[i], *_efforts(run, i)] for i in range(0, len(times), 40)],
        ),
        Plot(
            "A jelly in a light medium",
            "t, s",
            "height of the centroid, m",
            [Curve("jelly", times, height, "-")],
        ),
        "The bounds were written after trials until 4.2 s without the energy's column, that of the "
        "limiter after one until 5 s.",
    )


def _efforts(run: nv.Simulation, until: int) -> list[float]:
    """Iterations and limited cells of all steps so far."""
    names = ("newton_iterations", "limited_cells")
    return [float(run.ledger.column(name)[: until + 1].sum()) for name in names]

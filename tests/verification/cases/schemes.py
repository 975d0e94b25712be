"""Time schemes: energies of waves, dissipation of a swirl, orders by exact and manufactured solutions."""

import cmath
import math
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import sin

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.geometries import box, channel
from ngvisco.timestepping.scheme import scheme_of
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table
from tests.verification.cases.rheology import startup
from tests.verification.cases.waves import G_E, standing_wave
from tests.verification.convergence import KINDS as MODELS
from tests.verification.convergence import free_solution
from tests.verification.setups import KINDS, SWIRL, closure, separation, stokes

CASES = Cases("Time schemes")

SECOND_ORDER = ("midpoint", "sdirk2")
LABEL = "Euler-small-viscoelastodyn+disc, Euler-large-viscoelastodyn+disc, and beyond the paper"


def growth(scheme: str, z: complex) -> complex:
    """The factor by which a step multiplies a solution of u' = s u, as a function of z = s tau."""
    tableau = scheme_of(scheme)
    A, b = np.array(tableau.A), np.array(tableau.b)
    return complex(1 + z * (b @ np.linalg.solve(np.eye(len(b)) - z * A, np.ones(len(b)))))


def _energies(run: nv.Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic plus stored energy after every step, J, and what upwinding has dissipated until then, J."""
    column = run.ledger.column
    return column("kinetic") + column("stored"), np.cumsum(column("dt") * column("dissipation_upwinding"))


def _standing(scheme: str) -> Measured:
    """A standing wave without viscosity: its amplitude and energy after five periods."""
    k, periods = 2.0, 5
    omega, table = (
        k * math.sqrt(G_E),
        RateTable("largest error of the amplitude; energy drift beside upwinding", "tau, s"),
    )
    deviation = 0.0
    for per_period in (20, 40, 80):
        dt = 2 * math.pi / omega / per_period
        run, a = standing_wave(
            "linearised", "shear", k, dt, periods * per_period, mu=0.0, viscous=False, scheme=scheme
        )
        n, z = np.arange(len(a)), growth(scheme, 1j * omega * dt)
        deviation = max(deviation, float(np.abs(a - (z**n).real).max()))
        energy, upwinding = _energies(run)
        error = np.abs(a - np.cos(omega * dt * n)).max()
        drift = abs(math.log((energy + upwinding)[-1] / energy[0]))
        table.add(dt, amplitude=float(error), drift=drift, upwinding=float(upwinding[-1] / energy[0]))
    yield "deviation from the scheme's own formula", deviation
    if scheme == "backward-euler":
        yield "rate of the energy drift in tau", table.last("drift")
    else:
        yield "rate of the amplitude in tau", table.last("amplitude")
        yield "energy drift in five periods of 40 steps, less upwinding", table.errors["drift"][1]
        yield "dissipated by upwinding in five periods of 40 steps", table.errors["upwinding"][1]
    yield table


CASES("""standing-wave
    A small elastic standing wave follows cos(k x) cos(c_s k t); only the implicit step's damping changes its
      energy, and vanishes like tau.
    label: Euler-small-viscoelastodyn+; Underworld3
    setting: Strip of one wave length, k = 2 1/m, G_e = 1 Pa, no viscosity, five periods of 20, 40, 80 steps.
    - deviation from the scheme's own formula <= 2e-3: the error in space
    - rate of the energy drift in tau >= 0.9: order tau
    - closure
    """)(partial(_standing, "backward-euler"))


for scheme in SECOND_ORDER:
    drift = 1e-8 if scheme == "midpoint" else 1e-2
    CASES(f"""standing-wave-{scheme}
        By {scheme} a small elastic standing wave follows cos(k x) cos(c_s k t) to second order.
        label: {LABEL}
        setting: The strip of standing-wave: five periods of 20, 40 and 80 steps.
        - deviation from the scheme's own formula <= 2e-3: the error in space
        - rate of the amplitude in tau >= 1.9: second order
        - energy drift in five periods of 40 steps, less upwinding <= {drift}: none, or of third order
        - dissipated by upwinding in five periods of 40 steps in [0, 1e-5]: of third order in the amplitude
        - closure
        """)(partial(_standing, scheme))


@CASES(f"""hundred-periods
    Over 100 periods of an elastic wave the midpoint rule conserves the energy; its phase error follows the
      scheme's formula.
    label: {LABEL}
    setting: The strip of standing-wave without viscosity; 100 periods of 20 steps.
    - midpoint: relative energy drift, less upwinding <= 1e-6: R has the size of rounding for a linear wave
    - midpoint: dissipated by upwinding over the energy in [0, 2e-4]: 20 times that of five periods
    - midpoint: deviation from its formula <= 0.03: the error in space, 100 periods long
    - sdirk2: relative loss of energy in [0.12, 0.14]: its formula: 0.131
    - closure
    """)
def _hundred_periods() -> Measured:
    k, steps, rows, curves = 2.0, 2000, [], []
    omega = k * math.sqrt(G_E)
    dt = 2 * math.pi / omega / 20
    for scheme in SECOND_ORDER:
        run, a = standing_wave("linearised", "shear", k, dt, steps, mu=0.0, viscous=False, scheme=scheme)
        energy, upwinding = _energies(run)
        kept = (energy + upwinding) / energy[0]
        z = growth(scheme, 1j * omega * dt)
        off = np.abs(a - (z ** np.arange(len(a))).real).max()
        slip = cmath.phase(z) / (omega * dt) - 1
        rows.append([scheme, abs(kept[-1] - 1), abs(z) ** (2 * steps) - 1, slip, off])
        of = "energy drift, less upwinding" if scheme == "midpoint" else "loss of energy"
        yield f"{scheme}: relative {of}", rows[-1][1]
        if scheme == "midpoint":
            yield "midpoint: dissipated by upwinding over the energy", upwinding[-1] / energy[0]
        curves.append(Curve(scheme, run.ledger.column("time")[::10], (energy / energy[0])[::10], "-"))
    yield "midpoint: deviation from its formula", rows[0][-1]
    head = "scheme | energy drift, less upwinding | its formula | slip of the phase | deviation from formula"
    yield Table("after 100 periods of 20 steps", head, rows)
    yield "Bounds of what upwinding dissipates were written after a trial: 2.1e-6 in five periods."
    yield Plot("Energy of an elastic wave over 100 periods", "t, s", "relative to the start", curves)


LIMIT = 0.20386
"""Kinetic energy of the swirl at 0.2 s, J, extrapolated from the two finest midpoint runs."""
LENGTHS = {
    "backward-euler": (0.02, 0.0025, 0.000625),
    "midpoint": (0.04, 0.02, 0.01, 0.005, 0.0025),
    "sdirk2": (0.04, 0.02, 0.01),
}
"""Lengths of steps, s."""


@CASES("""swirl-schemes
    A swirl's kinetic energy at 0.2 s with the midpoint rule and steps of 0.02 s is nearer to the limit than
      with backward Euler and a thirtieth of the step; the midpoint rule dissipates no energy.
    label: Euler-large-viscoelastodyn+disc, and beyond the paper
    setting: The demo's swirl, cells of 0.25 m; three schemes, eleven steps' lengths.
    - error of midpoint, dt = 0.04 s <= 0.04: second order
    - error of midpoint, dt = 0.02 s <= 0.01: second order
    - error of backward Euler, dt = 0.000625 s, and no less in [0.02, 0.04]: first order: not nearer than
      the midpoint rule with 0.04 s
    - numerical dissipation of midpoint, dt = 0.02 s, J <= 1e-5: of the 0.25 J of motion
    - closure
    """)
def _swirl() -> Measured:
    model = nv.Model(
        material=nv.NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=stokes(0.01),
        hyperviscosity=nv.HyperViscosity(mu=1e-5, p=4),
        loads=(nv.Gravity((0.0, -1.0)),),
    )
    rows, initial = {}, nv.Initial(velocity=SWIRL)
    for scheme, steps in LENGTHS.items():
        for dt in steps:
            run = nv.Simulation(box((1, 1), 0.25), model, dt=dt, initial=initial, scheme=scheme)
            ledger = run.run(0.2)
            kinetic, count = float(ledger.column("kinetic")[-1]), ledger.column("newton_iterations").sum()
            lost = float(ledger.column("inertial").sum() + ledger.column("bregman").sum())
            rows[scheme, dt] = [scheme, dt, count, kinetic, abs(kinetic / LIMIT - 1), lost, closure(run)]
    yield "error of midpoint, dt = 0.04 s", rows["midpoint", 0.04][4]
    yield "error of midpoint, dt = 0.02 s", rows["midpoint", 0.02][4]
    yield "error of backward Euler, dt = 0.000625 s, and no less", rows["backward-euler", 0.000625][4]
    yield "numerical dissipation of midpoint, dt = 0.02 s, J", abs(rows["midpoint", 0.02][5])
    head = "scheme | dt, s | iterations | kinetic energy, J | error | numerical, J | closure"
    yield from Table("kinetic energy at 0.2 s", head, rows.values()).drawn(1, 4, by=0, log="xy")


def channel_velocity(y: np.ndarray, t: float, nu: float, speed: float) -> np.ndarray:
    """Couette start-up of a Newtonian fluid whose upper wall moves at speed sin²(t): Fourier's series."""
    n = np.arange(1, 200)[:, None]
    decay, modes = nu * (math.pi * n) ** 2, np.sin(math.pi * n * y)
    # by the wall's acceleration sin(2 t): int_0^t exp(-decay (t - s)) sin(2 s) ds
    memory = (decay * math.sin(2 * t) - 2 * math.cos(2 * t) + 2 * np.exp(-decay * t)) / (decay**2 + 4)
    return speed * (math.sin(t) ** 2 * y + (2 * (-1.0) ** n / (math.pi * n) * modes * memory).sum(axis=0))


def _couette(scheme: str) -> Measured:
    """Compare a smoothly accelerated lid over a Newtonian channel with Fourier's series."""
    nu, speed, until = 0.2, 0.1, 1.5
    table = RateTable("largest error of v_1 on a line, relative to the wall's speed", "tau, s")
    y = np.linspace(0.05, 0.95, 19)
    for steps in (6, 12, 24):
        viscosity = nv.StokesViscosity(K_v=nu, G_v=nu / 2)
        run = nv.Simulation(
            channel(0.5, 1, maxh=0.2),
            nv.Model(material=nv.BarotropicFluid(B=1.0, gamma=1.4), viscosity=viscosity),
            dt=until / steps,
            walls={"top": nv.PrescribedTangential((speed * sin(time) ** 2, 0)), "bottom": nv.NoSlip()},
            initial=nv.Initial(density=0.5),
            discretisation=nv.Discretisation(k=3, m=2),
            scheme=scheme,
        )
        run.run(until)
        v = run.fields["velocity"](run.mesh(0 * y + 0.21, y))[:, 0]
        table.add(until / steps, v=float(np.abs(v - channel_velocity(y, until, nu, speed)).max() / speed))
    yield "rate of v in tau", table.last("v")
    yield "error at 24 steps", table.errors["v"][-1]
    yield table


def _manufactured(scheme: str, kind: str) -> Measured:
    """Differences of runs with halved steps on one mesh; manufactured sources drive all terms."""
    counts, duration = (4, 8, 16, 32), 0.1
    runs = [
        free_solution(kind, n, duration, p=2.0, driven=True, scheme=scheme, velocity_scale=3e3)
        for n in counts
    ]
    table = RateTable(f"differences of successive steps, {kind}", "tau, s")
    for n, (coarse, fine) in zip(counts, pairwise(runs), strict=False):
        table.add(duration / n, **separation(fine, coarse))
    yield from table.lasts()
    yield table


for scheme in SECOND_ORDER:
    midpoint = scheme == "midpoint"
    for kind in KINDS:
        CASES(f"""jeffreys-startup-{kind}-{scheme}
            By {scheme} start-up of shear of a Jeffreys material in {KINDS[kind]} follows its ODE to second
              order.
            label: {"ED-Euler-large2, ED-Euler-large3" if kind == "finite" else "Euler-small-flow-rule"}
            setting: The channel of jeffreys-startup; 20, 40, 80 steps until 4 s.
            - rate of [T_12; T_11 − T_22] >= 1.9: second order
            - error at the finest step <= 1e-3: a fiftieth of backward Euler's bound
            - closure
            """)(partial(startup, kind, scheme))
    reduction = "order reduction: its stages are of order one where a wall's velocity changes"
    CASES(f"""couette-startup-{scheme}{" (reduced)" * midpoint}
        By {scheme} a Newtonian fluid under a lid that is accelerated follows Fourier's
          {"series, to second order." if midpoint else "series, to order 1.5 at least."}
        label: Euler-small-viscoelastodyn+1
        setting: Channel of 1 m, P3 velocity, rho = 0.5 kg/m3, D = 0.1 Pa s of shear, lid 0.1 sin²(t) m/s
          until 1.5 s; 6, 12, 24 steps.
        - rate of v in tau >= {"1.9: second order" if midpoint else f"1.5: {reduction}"}
        - error at 24 steps <= 2e-3: tau = 0.0625 s
        - closure
        """)(partial(_couette, scheme))


ORDERS = {"backward-euler": (1, 0.85), "midpoint": (2, 1.9), "sdirk2": (2, 1.9)}
"""Order in time, and the required rate."""

for scheme, (order, least) in ORDERS.items():
    for kind in MODELS:
        reduced = " (reduced)" * (kind == "linear" and order == 1)
        CASES(f"""order-in-time-{"finite" if kind == "neo-hookean" else "linearised"}-{scheme}{reduced}
            With manufactured sources that drive every term, {scheme} is of order {order} in v, rho and z.
            label: {LABEL}
            setting: Creep, gravity, viscosity, hyperviscosity, delta- and epsilon-terms; one mesh,
              differences of successive runs of 4, 8, 16, 32 steps in 0.1 s.
            - rate of [v; rho; z] >= {least}: order {order}
            """)(partial(_manufactured, scheme, kind))

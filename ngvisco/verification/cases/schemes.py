"""Time schemes: order against exact and manufactured solutions, energy, long runs, what they dissipate."""

from __future__ import annotations

import cmath
import math
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import sin

from ngvisco.forms.context import time
from ngvisco.forms.initial import Initial
from ngvisco.geometries import box, channel
from ngvisco.physics.materials import BarotropicFluid, LinearElastic, NeoHookean
from ngvisco.physics.model import Gravity, Model
from ngvisco.physics.rheology import HyperViscosity, StokesViscosity
from ngvisco.physics.walls import NoSlip, PrescribedTangential
from ngvisco.run.simulation import Simulation
from ngvisco.timestepping.scheme import scheme_of
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from ngvisco.verification.cases.maxwell import oscillating
from ngvisco.verification.cases.rheology import G_M, G_V, startup_ode
from ngvisco.verification.cases.rheology import material as rheological
from ngvisco.verification.cases.shear import ETA, RATE, TABLE, G, sheared
from ngvisco.verification.cases.waves import G_E, MU, dispersion, standing_wave
from ngvisco.verification.convergence import free_solution, separation
from ngvisco.verification.models import KINDS as MODELS
from ngvisco.verification.rates import RateTable
from ngvisco.verification.setups import KINDS, SWIRL, closure

THEME = "Time schemes"
SECOND_ORDER = ("midpoint", "sdirk2")
CLOSURE = Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration")
LABEL = "Euler-small-viscoelastodyn+disc, Euler-large-viscoelastodyn+disc, and beyond the paper"


def growth(scheme: str, z: complex) -> complex:
    """The factor by which a step of length tau multiplies a solution of u' = s u, z = s tau."""
    tableau = scheme_of(scheme)
    A, b = np.array(tableau.A), np.array(tableau.b)
    return complex(1 + z * (b @ np.linalg.solve(np.eye(len(b)) - z * A, np.ones(len(b)))))


def numerical(run: Simulation) -> float:
    """What the scheme has dissipated, J."""
    return float(run.ledger.column("inertial").sum() + run.ledger.column("bregman").sum())


# --- waves -----------------------------------------------------------------------------------------------


def _standing(scheme: str) -> Outcome:
    k, periods = 2.0, 5
    omega = k * math.sqrt(G_E)
    table, curves, deviation, runs = RateTable("largest error of the amplitude"), [], 0.0, []
    drifts = []
    for per_period in (20, 40, 80):
        dt = 2 * math.pi / omega / per_period
        run, a = standing_wave(
            "linearised", "shear", k, dt, periods * per_period, mu=0.0, viscous=False, scheme=scheme
        )
        n, z = np.arange(len(a)), growth(scheme, 1j * omega * dt)
        deviation = max(deviation, float(np.abs(a - (z**n).real).max()))
        t = dt * n
        table.add(dt, amplitude=float(np.abs(a - np.cos(omega * t)).max()))
        energy = run.ledger.column("kinetic") + run.ledger.column("stored")
        drifts.append(abs(float(math.log(energy[-1] / energy[0]))))
        runs.append(run)
        times = [float(s) for s in t]
        curves.append(Curve(f"{per_period} steps a period", times, [float(v) for v in a], "-"))
    curves.append(Curve("exact", times, [math.cos(omega * s) for s in times], "k--"))
    return Outcome(
        values={
            "deviation from the scheme's own formula": deviation,
            "rate of the amplitude in tau": table.last("amplitude"),
            "energy drift in five periods of 40 steps": drifts[1],
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[Plot(f"Elastic standing wave by {scheme}", "t, s", "relative velocity amplitude", curves)],
    )


def _hundred_periods() -> Outcome:
    """A wave without viscosity over 100 periods of 40 steps: energy and phase."""
    k, periods, per_period = 2.0, 100, 40
    omega = k * math.sqrt(G_E)
    dt = 2 * math.pi / omega / per_period
    rows, curves, values, runs = [], [], {}, []
    for scheme in ("midpoint", "sdirk2", "backward-euler"):
        run, a = standing_wave(
            "linearised", "shear", k, dt, periods * per_period, mu=0.0, viscous=False, scheme=scheme
        )
        energy = run.ledger.column("kinetic") + run.ledger.column("stored")
        drift = abs(float(energy[-1] / energy[0] - 1))
        z = growth(scheme, 1j * omega * dt)
        n = np.arange(len(a))
        slip = abs(cmath.phase(z)) / (omega * dt) - 1
        off = float(np.abs(a - (z**n).real).max())
        rows.append([scheme, drift, abs(z) ** (2 * len(n) - 2) - 1, slip, off])
        if scheme == "midpoint":
            values["midpoint: relative energy drift"] = drift
            values["midpoint: deviation from its formula"] = off
        if scheme == "sdirk2":
            values["sdirk2: relative energy drift"] = drift
        runs.append(run)
        every = slice(None, None, 10)
        t = [float(s) for s in (dt * n)[every]]
        curves.append(Curve(scheme, t, [float(e) for e in (energy / energy[0])[every]], "-"))
    head = ["scheme", "energy drift", "its formula", "relative slip of the phase", "deviation from formula"]
    return Outcome(
        values={**values, "largest |closure|": closure(*runs)},
        tables=[Table("after 100 periods of 40 steps", head, rows)],
        plots=[Plot("Energy of an elastic wave over 100 periods", "t, s", "relative to the start", curves)],
    )


def _dispersion(scheme: str, kind: str) -> Outcome:
    """Phase speed and decay as they come, with nothing of the scheme undone, over the step."""
    k = 5.0
    exact = dispersion(k, "shear", MU)
    table, runs = RateTable("error of s in exp(s t), relative"), []
    for per_time in (5, 10, 20):
        dt = 1 / (per_time * abs(exact))
        run, a = standing_wave(kind, "shear", k, dt, 6 * per_time, scheme=scheme)
        fit = np.linalg.lstsq(np.array([a[2:-1], a[1:-2]]).T, a[3:], rcond=None)[0]
        s = cmath.log(complex(np.roots([1.0, -fit[0], -fit[1]])[0])) / dt
        s = complex(s.real, abs(s.imag))
        table.add(dt, s=abs(s - complex(exact.real, abs(exact.imag))) / abs(exact))
        runs.append(run)
    return Outcome(
        values={
            "rate of s in tau": table.last("s"),
            "error at 20 steps a radian": table.errors["s"][-1],
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "relative error of s")],
    )


# --- shear -----------------------------------------------------------------------------------------------


def _jaumann(scheme: str) -> Outcome:
    table, runs = RateTable("largest error in t <= 2 s, relative to eta gamma'"), []
    times = (0.25, 0.5, 1.0, 2.0)
    for steps in (16, 32, 64):
        run, rows = sheared(
            LinearElastic(K_e=2 * G, G_e=G), 2 / steps, 2.0, rate=RATE, G_m=2 * ETA, scheme=scheme
        )
        r, t = RATE, rows[:, 0]
        decay, scale = np.exp(-t), RATE * ETA / (1 + RATE**2)
        tau_12 = scale * (1 - decay * (np.cos(r * t) - r * np.sin(r * t)))
        tau_11 = scale * (r - decay * (r * np.cos(r * t) + np.sin(r * t)))
        table.add(
            2 / steps,
            tau_12=float(np.abs(rows[:, 1] - tau_12).max() / (RATE * ETA)),
            tau_11=float(np.abs(rows[:, 3] - tau_11).max() / (RATE * ETA)),
        )
        runs.append(run)
    at_table = max(abs(rows[round(t * 32), 1] / TABLE[t][0] - 1) for t in times)
    return Outcome(
        values={
            "rate of tau_12": table.last("tau_12"),
            "rate of tau_11": table.last("tau_11"),
            "relative error against the reference's table, 64 steps": float(at_table),
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "error")],
    )


def _startup(scheme: str, kind: str) -> Outcome:
    rate, until = 1.0, 4.0
    table, runs = RateTable("largest error over the run, relative to G"), []
    for steps in (20, 40, 80):
        run, rows = sheared(
            rheological(kind), until / steps, until, rate=rate, G_m=G_M, viscosity=G_V, scheme=scheme
        )
        errors = np.abs(rows[:, 1:3] - startup_ode(kind, rate, rows[:, 0])).max(axis=0)
        table.add(until / steps, T_12=float(errors[0]), N_1=float(errors[1]))
        runs.append(run)
    return Outcome(
        values={
            "rate of T_12": table.last("T_12"),
            "rate of T_11 − T_22": table.last("N_1"),
            "error at the finest step": max(table.errors["T_12"][-1], table.errors["N_1"][-1]),
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "error")],
    )


def _oscillation(scheme: str) -> Outcome:
    table, runs, plain = RateTable("largest error, relative to eta gamma_0"), [], 0.0
    for steps in (40, 80, 160):
        run, _, found, exact = oscillating(steps, scheme)
        table.add(8 / steps, tau_12=float(np.abs(found - exact).max()))
        runs.append(run)
    _, _, found, exact = oscillating(160)
    plain = float(np.abs(found - exact).max())
    return Outcome(
        values={
            "rate in tau": table.last("tau_12"),
            "error at 80 steps a period": table.errors["tau_12"][-1],
            "the same by backward Euler / by this scheme": plain / table.errors["tau_12"][-1],
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "error")],
    )


def channel_velocity(y: np.ndarray, t: float, nu: float, speed: float) -> np.ndarray:
    """Couette start-up of a Newtonian fluid whose upper wall moves at speed sin²(t): Fourier's series."""
    n = np.arange(1, 200)[:, None]
    decay, modes = nu * (math.pi * n) ** 2, np.sin(math.pi * n * y)
    # of the wall's acceleration sin(2 t): int_0^t exp(-decay (t - s)) sin(2 s) ds
    memory = (decay * math.sin(2 * t) - 2 * math.cos(2 * t) + 2 * np.exp(-decay * t)) / (decay**2 + 4)
    return speed * (math.sin(t) ** 2 * y + (2 * (-1.0) ** n / (math.pi * n) * modes * memory).sum(axis=0))


def _couette(scheme: str) -> Outcome:
    """A lid that is accelerated smoothly over a Newtonian channel, against Fourier's series."""
    nu, speed, until = 0.2, 0.1, 1.5
    table, runs = RateTable("largest error of v_1 on a line, relative to the wall's speed"), []
    y = np.linspace(0.05, 0.95, 19)
    for steps in (6, 12, 24):
        run = Simulation(
            channel(0.5, 1, maxh=0.2),
            Model(material=BarotropicFluid(B=1.0, gamma=1.4), viscosity=StokesViscosity(K_v=nu, G_v=nu / 2)),
            dt=until / steps,
            walls={"top": PrescribedTangential((speed * sin(time) ** 2, 0)), "bottom": NoSlip()},
            initial=Initial(density=0.5),
            scheme=scheme,
        )
        run.run(until)
        v = np.array([run.fields["velocity"](run.mesh(0.21, s))[0] for s in y])
        exact = channel_velocity(y, until, nu, speed)
        table.add(until / steps, v=float(np.abs(v - exact).max() / speed))
        runs.append(run)
    return Outcome(
        values={
            "rate of v in tau": table.last("v"),
            "largest |closure|": closure(*runs),
        },
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "error")],
    )


# --- manufactured solutions, the swirl ---------------------------------------------------------------------


def _manufactured(scheme: str, kind: str) -> Outcome:
    """One mesh, sources that drive all terms, steps tau to tau/4 against tau/8 extrapolated by the order."""
    duration, coarsest = 0.1, 4
    runs = [
        free_solution(kind, n * coarsest, duration, p=2.0, driven=True, scheme=scheme, velocity_scale=3e3)
        for n in (1, 2, 4, 8)
    ]
    table = RateTable(f"differences of successive steps, {kind}")
    for n, (coarse, fine) in zip((1, 2, 4), pairwise(runs), strict=True):
        table.add(duration / (n * coarsest), **separation(fine, coarse))
    return Outcome(
        values={f"rate of {name}": table.last(name) for name in table.errors},
        tables=[table.table("tau, s")],
        plots=[table.plot("tau, s", "difference in L2")],
        remarks=["The upwinding is smooth here (0.3 m/s): a sharp one makes v piecewise smooth in time."],
    )


LIMIT = 0.20386
"""Kinetic energy of the swirl at 0.2 s, J, extrapolated from the two finest midpoint runs."""


def swirl(scheme: str, dt: float) -> Simulation:
    """The demo's swirl with cells of 0.25 m, until 0.2 s."""
    model = Model(
        material=NeoHookean(K_e=10.0, G_e=5.0, epsilon=0.1),
        viscosity=StokesViscosity(K_v=0.01, G_v=0.01),
        hyperviscosity=HyperViscosity(mu=1e-5, p=4),
        loads=(Gravity((0.0, -1.0)),),
    )
    initial = Initial(velocity=SWIRL)
    run = Simulation(box((1, 1), 0.25), model, dt=dt, initial=initial, scheme=scheme)
    run.run(0.2)
    return run


def _swirl() -> Outcome:
    rows: list[list[str | float]] = []
    runs, error = [], {}
    for scheme, steps in (
        ("backward-euler", (0.02, 0.0025, 0.000625)),
        ("midpoint", (0.04, 0.02, 0.01, 0.005, 0.0025)),
        ("sdirk2", (0.04, 0.02, 0.01)),
    ):
        for dt in steps:
            run = swirl(scheme, dt)
            runs.append(run)
            kinetic = float(run.ledger.column("kinetic")[-1])
            error[scheme, dt] = abs(kinetic / LIMIT - 1)
            count = float(run.ledger.column("newton_iterations").sum())
            rows.append([scheme, dt, count, kinetic, error[scheme, dt], numerical(run), closure(run)])
            if (scheme, dt) == ("midpoint", 0.02):
                lost = abs(numerical(run))
    head = ["scheme", "dt, s", "iterations", "kinetic energy, J", "error", "numerical, J", "closure"]
    return Outcome(
        values={
            "error of midpoint, dt = 0.04 s": error["midpoint", 0.04],
            "error of midpoint, dt = 0.02 s": error["midpoint", 0.02],
            "error of backward Euler, dt = 0.000625 s": error["backward-euler", 0.000625],
            "numerical dissipation of midpoint, dt = 0.02 s, J": lost,
            "largest |closure|": closure(*runs),
        },
        tables=[Table("kinetic energy at 0.2 s", head, rows)],
        remarks=["The limit is 0.20386 J; the model dissipates 4 mJ until then."],
    )


def _cases(scheme: str) -> tuple[Case, ...]:
    midpoint = scheme == "midpoint"
    drift = 1e-8 if midpoint else 1e-2
    order = Bound("rate in tau", ">=", 1.9, "second order")
    waves = (
        Case(
            name=f"standing-wave-{scheme}",
            theme=THEME,
            statement=f"By {scheme} a small elastic standing wave follows cos(k x) cos(c_s k t) to second "
            "order.",
            label=LABEL,
            setting="The strip of standing-wave: five periods of 20, 40 and 80 steps.",
            bounds=(
                Bound("deviation from the scheme's own formula", "<=", 2e-3, "the error in space"),
                Bound("rate of the amplitude in tau", ">=", 1.9, "second order"),
                Bound("energy drift in five periods of 40 steps", "<=", drift, "none, or of third order"),
                CLOSURE,
            ),
            run=partial(_standing, scheme),
        ),
        *(
            Case(
                name=f"dispersion-shear-{kind}-{scheme}",
                theme=THEME,
                statement=f"By {scheme} a damped shear wave in {KINDS[kind]} decays and travels as the "
                "dispersion relation says, to second order in the step.",
                label=LABEL,
                setting="The strip of dispersion-shear with k = 5 1/m; 5, 10, 20 steps a radian.",
                bounds=(
                    Bound("rate of s in tau", ">=", 1.9, "second order"),
                    Bound("error at 20 steps a radian", "<=", 2e-3, "tau²/12 |s|² and the error in space"),
                    CLOSURE,
                ),
                run=partial(_dispersion, scheme, kind),
                reduced=midpoint and kind == "linearised",
            )
            for kind in KINDS
        ),
    )
    shear = (
        Case(
            name=f"jaumann-shear-{scheme}",
            theme=THEME,
            statement=f"By {scheme} the stresses of a Zaremba–Jaumann Maxwell fluid in simple shear are "
            "those "
            "of the closed form, to second order and without extrapolation.",
            label="ZJ, Euler-small-flow-rule; Farrington et al. 2014",
            setting="The channel of jaumann-shear until 2 s; 16, 32, 64 steps.",
            bounds=(
                Bound("rate of tau_12", ">=", 1.9, "second order"),
                Bound("rate of tau_11", ">=", 1.9, "second order"),
                Bound(
                    "relative error against the reference's table, 64 steps", "<=", 1e-3, "as extrapolated"
                ),
                CLOSURE,
            ),
            run=partial(_jaumann, scheme),
            reduced=midpoint,
        ),
        *(
            Case(
                name=f"jeffreys-startup-{kind}-{scheme}",
                theme=THEME,
                statement=f"By {scheme} start-up of shear of a Jeffreys material in {KINDS[kind]} follows "
                "its "
                "ODE to second order.",
                label="ED-Euler-large2, ED-Euler-large3" if kind == "finite" else "Euler-small-flow-rule",
                setting="The channel of jeffreys-startup; 20, 40, 80 steps until 4 s.",
                bounds=(
                    Bound("rate of T_12", ">=", 1.9, "second order"),
                    Bound("rate of T_11 − T_22", ">=", 1.9, "second order"),
                    Bound("error at the finest step", "<=", 1e-3, "a fiftieth of backward Euler's bound"),
                    CLOSURE,
                ),
                run=partial(_startup, scheme, kind),
            )
            for kind in KINDS
        ),
        Case(
            name=f"oscillatory-shear-{scheme}",
            theme=THEME,
            statement=f"By {scheme} oscillatory shear of a Maxwell material follows the closed form to "
            "second "
            "order: the excess viscosity G dt/2 of backward Euler is gone.",
            label="Euler-small-viscoelastodyn+2; Underworld3",
            setting="The channel of oscillatory-shear: load and lid depend on time; 40, 80, 160 steps in two "
            "periods.",
            bounds=(
                order,
                Bound("error at 80 steps a period", "<=", 1e-3, "second order"),
                Bound("the same by backward Euler / by this scheme", ">=", 20.0, "an order more"),
                CLOSURE,
            ),
            run=partial(_oscillation, scheme),
        ),
        Case(
            name=f"couette-startup-{scheme}",
            theme=THEME,
            statement=f"By {scheme} a Newtonian fluid under a lid that is accelerated follows Fourier's "
            "series "
            "to second order.",
            label="Euler-small-viscoelastodyn+1",
            setting="Channel of 1 m, rho = 0.5 kg/m3, D = 0.1 Pa s of shear, lid 0.1 sin²(t) m/s until "
            "1.5 s; "
            "6, 12, 24 steps.",
            bounds=(Bound("rate of v in tau", ">=", 1.9, "second order"), CLOSURE),
            run=partial(_couette, scheme),
        ),
    )
    manufactured = tuple(
        Case(
            name=f"order-in-time-{'finite' if kind == 'neo-hookean' else 'linearised'}-{scheme}",
            theme=THEME,
            statement=f"With manufactured sources that drive every term, {scheme} is of second order in "
            "v, rho "
            "and z.",
            label=LABEL,
            setting="Creep, gravity, viscosity, hyperviscosity, delta- and epsilon-terms; one mesh, "
            "differences "
            "of successive runs of 4, 8, 16, 32 steps in 0.1 s.",
            bounds=tuple(Bound(f"rate of {name}", ">=", 1.9, "second order") for name in ("v", "rho", "z")),
            run=partial(_manufactured, scheme, kind),
        )
        for kind in MODELS
    )
    return (*waves, *shear, *manufactured)


CASES = (
    *(case for scheme in SECOND_ORDER for case in _cases(scheme)),
    Case(
        name="hundred-periods",
        theme=THEME,
        statement="Over 100 periods of an elastic wave the midpoint rule keeps the energy; what its phase "
        "is off "
        "by is the scheme's own formula.",
        label=LABEL,
        setting="The strip of standing-wave without viscosity; 100 periods of 40 steps, by three schemes.",
        bounds=(
            Bound("midpoint: relative energy drift", "<=", 1e-6, "R is of rounding for a linear wave"),
            Bound("midpoint: deviation from its formula", "<=", 0.03, "the error in space, 100 periods long"),
            Bound("sdirk2: relative energy drift", "<=", 0.2, "of third order in the step"),
            CLOSURE,
        ),
        run=_hundred_periods,
    ),
    Case(
        name="swirl-schemes",
        theme=THEME,
        statement="Of a swirl's kinetic energy at 0.2 s the midpoint rule with 0.02 s is nearer to the "
        "limit than "
        "backward Euler with a thirtieth of that step, and dissipates nothing of its own.",
        label="Euler-large-viscoelastodyn+disc, and beyond the paper",
        setting="The demo's swirl, cells of 0.25 m; three schemes, eleven steps' lengths.",
        bounds=(
            Bound("error of midpoint, dt = 0.04 s", "<=", 0.04, "second order"),
            Bound("error of midpoint, dt = 0.02 s", "<=", 0.01, "second order"),
            Bound("error of backward Euler, dt = 0.000625 s", ">=", 0.02, "first order: not nearer"),
            Bound("numerical dissipation of midpoint, dt = 0.02 s, J", "<=", 1e-5, "of the 0.25 J of motion"),
            CLOSURE,
        ),
        run=_swirl,
    ),
)

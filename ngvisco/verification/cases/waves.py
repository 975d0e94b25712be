"""Waves of small amplitude, the first Stokes problem, and a compression pulse with a steep front."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from ngsolve import CF, Det, Integrate, cos, erf, pi, sin, x, y

from ngvisco.forms.initial import Initial
from ngvisco.forms.spaces import Discretisation
from ngvisco.forms.walls import Conditions
from ngvisco.geometries import box
from ngvisco.physics.material import Material
from ngvisco.physics.materials import LinearElastic, NeoHookean, ReferentialNeoHookean
from ngvisco.physics.model import Model
from ngvisco.physics.rheology import Creep, HyperViscosity, StokesViscosity
from ngvisco.physics.walls import NoSlip, PrescribedTangential
from ngvisco.run.simulation import Simulation
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from ngvisco.verification.problems import distance
from ngvisco.verification.rates import RateTable
from ngvisco.verification.setups import KINDS, closure

THEME = "Exact solutions: waves and fronts"
CLOSURE = Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration")
K_E, G_E, G_V, K_V, MU = 2.0, 1.0, 0.02, 0.01, 1e-3
AMPLITUDE = 1e-3


def material(kind: str) -> Material:
    """Bulk modulus K_E and shear modulus G_E in both models (the neo-Hookean G_e is half of it)."""
    if kind == "linearised":
        return LinearElastic(K_e=K_E, G_e=G_E)
    return ReferentialNeoHookean(K_e=K_E, G_e=G_E / 2)


def dispersion(k: float, wave: str, mu: float, viscous: bool = True) -> complex:
    """s of rho s² + (D k² + mu k⁴) s + M k² = 0, rho = 1: the decay is −Re s, the phase speed |Im s|/k."""
    M = G_E if wave == "shear" else K_E + 4 / 3 * G_E
    D = (G_V if wave == "shear" else K_V + 4 / 3 * G_V) if viscous else 0.0
    return complex(np.roots([1.0, D * k**2 + mu * k**4, M * k**2])[0])


def standing_wave(
    kind: str, wave: str, k: float, dt: float, steps: int, mu: float = MU, viscous: bool = True
) -> tuple[Simulation, np.ndarray]:
    """Amplitudes of the velocity in a strip of one wave length, periodic in x and y, after every step."""
    length = 2 * math.pi / k
    model = Model(
        material=material(kind),
        viscosity=StokesViscosity(K_v=K_V, G_v=G_V) if viscous else None,
        hyperviscosity=HyperViscosity(mu=mu, p=2) if mu else None,
    )
    shape = cos(k * x)
    velocity = (0.0, AMPLITUDE * shape) if wave == "shear" else (AMPLITUDE * shape, 0.0)
    mesh = box((length, length / 4), length / 8, periodic="xy")
    run = Simulation(
        mesh,
        model,
        dt=dt,
        initial=Initial(velocity=CF(velocity)),
        discretisation=Discretisation(k=3, m=2),
        velocity_scale=1.0,
    )
    component, values = 1 if wave == "shear" else 0, [1.0]
    for _ in range(steps):
        run.advance()
        moment = Integrate(run.fields["velocity"][component] * shape, mesh, order=8)
        values.append(float(moment) / (AMPLITUDE * length**2 / 8))
    return run, np.array(values)


def exponent(a: np.ndarray, dt: float) -> complex:
    """s of a_n+1 = (z + z*) a_n − |z|² a_n-1: an implicit step multiplies by z = 1/(1 − s tau)."""
    b = np.linalg.lstsq(np.array([a[2:-1], a[1:-2]]).T, a[3:], rcond=None)[0]
    return complex((1 - 1 / np.roots([1.0, -b[0], -b[1]])[0]) / dt)


WAVE_NUMBERS = (1.0, 2.0, 5.0, 10.0)


def _dispersion(kind: str, wave: str) -> Outcome:
    rows, speeds, decays, closures = [], [], [], []
    for k in WAVE_NUMBERS:
        exact = dispersion(k, wave, MU)
        dt = 0.1 / abs(exact)
        run, a = standing_wave(kind, wave, k, dt, 30)
        s = exponent(a, dt)
        speed, decay = abs(s.imag) / k, -s.real
        speeds.append(abs(speed / (abs(exact.imag) / k) - 1))
        decays.append(abs(decay / -exact.real - 1))
        closures.append(closure(run))
        rows.append([k, speed, abs(exact.imag) / k, speeds[-1], decay, -exact.real, decays[-1]])
    fine = np.logspace(0, 1, 60)
    relation = [dispersion(float(k), wave, MU) for k in fine]
    xs, ks = [float(k) for k in fine], list(WAVE_NUMBERS)
    exact_speeds = [abs(s.imag) / k for s, k in zip(relation, xs, strict=True)]
    head = ["k, 1/m", "speed, m/s", "exact", "error", "decay, 1/s", "exact", "error"]
    return Outcome(
        values={
            "largest relative error of the phase speed": max(speeds),
            "largest relative error of the decay": max(decays),
            "largest |closure|": max(closures),
        },
        tables=[Table("phase speed and decay", head, rows)],
        plots=[
            Plot(
                f"{wave} wave: phase speed and decay",
                "k, 1/m",
                "m/s and 1/s",
                [
                    Curve("phase speed, exact", xs, exact_speeds, "-"),
                    Curve("decay, exact", xs, [-s.real for s in relation], "-"),
                    Curve("phase speed", ks, [float(row[1]) for row in rows], "o"),
                    Curve("decay", ks, [float(row[4]) for row in rows], "s"),
                ],
                log="xy",
            )
        ],
    )


def _standing() -> Outcome:
    """Five periods without any viscosity: the amplitude and energy that implicit Euler leaves."""
    k, periods = 2.0, 5
    omega = k * math.sqrt(G_E)
    table, curves, deviation, closures = RateTable("energy drift over five periods"), [], 0.0, []
    for per_period in (20, 40, 80):
        dt = 2 * math.pi / omega / per_period
        run, a = standing_wave("linearised", "shear", k, dt, periods * per_period, mu=0.0, viscous=False)
        z = 1 / (1 - 1j * omega * dt)
        n = np.arange(len(a))
        # the two modes +-i omega of the implicit step, from v = 1 and no strain
        deviation = max(deviation, float(np.abs(a - (z**n).real).max()))
        energy = run.ledger.column("kinetic") + run.ledger.column("stored")
        table.add(dt, drift=float(-math.log(energy[-1] / energy[0])))
        closures.append(closure(run))
        times = [float(t) for t in run.ledger.column("time")]
        curves.append(Curve(f"{per_period} steps a period", times, [float(v) for v in a], "-"))
    curves.append(Curve("exact", times, [math.cos(omega * t) for t in times], "k--"))
    return Outcome(
        values={
            "deviation from the implicit Euler formula": deviation,
            "rate of the energy drift in tau": table.last("drift"),
            "largest |closure|": max(closures),
        },
        tables=[table.table("tau, s")],
        plots=[Plot("Elastic standing wave, five periods", "t, s", "relative velocity amplitude", curves)],
        remarks=[
            "The drift column is −ln(energy/initial energy): first order in tau, and large for a wave, "
            "which is the price of a fully implicit scheme."
        ],
    )


def _stokes(creeping: bool) -> Outcome:
    """Viscosity 1e-2 Pa s, as a Stokes viscosity or as the creep of a Maxwell fluid (lambda = 1 ms)."""
    eta, top, begin, end = 1e-2, 0.1, 0.25, 1.0
    # exact fluid at t = 0.25 s: the wall's jump has become a layer of 0.05 m
    profile = top * erf(y / (2 * math.sqrt(eta * begin)))
    exact = top * erf(y / (2 * math.sqrt(eta * end)))
    table, curves, closures = RateTable("error of v_1 at t = 1 s, relative to 0.1 m/s"), [], []
    ys = np.linspace(0.0, 1.0, 41)
    for steps in (15, 30, 60):
        model = Model(
            material=LinearElastic(K_e=20.0, G_e=10.0) if creeping else LinearElastic(K_e=1e-6, G_e=1e-6),
            viscosity=None if creeping else StokesViscosity(K_v=eta, G_v=eta),
            creep=Creep(G_m=2 * eta) if creeping else None,
        )
        walls: Conditions = {"bottom": NoSlip(), "top": PrescribedTangential((top, 0.0))}
        # a Maxwell fluid starts with the stress of the layer it starts with
        slope = profile.Diff(y) * (eta / 20.0 if creeping else 0.0)
        E_0 = CF((0, slope, 0, slope, 0, 0, 0, 0, 0), dims=(3, 3))
        initial = Initial(velocity=(profile, 0.0), values={"E": E_0})
        mesh = box((0.2, 1.0), 0.1, periodic="x")
        orders = Discretisation(k=3, m=2)
        run = Simulation(
            mesh, model, dt=(end - begin) / steps, walls=walls, initial=initial, discretisation=orders
        )
        run.run(end - begin)
        error = distance(run.fields["velocity"][0], exact, mesh) / (top * math.sqrt(0.2))
        table.add(run.dt, v=error)
        closures.append(closure(run))
        v = [float(run.fields["velocity"](mesh(0.05, min(s, 1 - 1e-12)))[0]) for s in ys]
        curves.append(Curve(f"{steps} steps", [float(s) for s in ys], v, "."))
    points = [float(s) for s in ys]
    curves.append(Curve("exact", points, [top * math.erf(s / 0.2) for s in points], "k-"))
    return Outcome(
        values={
            "rate in tau": table.last("v"),
            "relative error, extrapolated": abs(2 * table.errors["v"][-1] - table.errors["v"][-2]),
            "largest |closure|": max(closures),
        },
        tables=[table.table("tau, s")],
        plots=[Plot("First Stokes problem at t = 1 s", "y, m", "v_1, m/s", curves)],
    )


def _pulse(kind: str) -> Outcome:
    """A pulse that steepens; rho J and rho det F should stay rho_0 = 1."""
    material = (
        NeoHookean(K_e=1.0, G_e=0.5, epsilon=0.5)
        if kind == "J and det F"
        else ReferentialNeoHookean(K_e=1.0, G_e=0.5)
    )
    table, curves, closures, compression = (
        RateTable("L2 distance to rho det F = rho_0 at t = 0.4 s"),
        [],
        [],
        [],
    )
    for cells, steps in ((10, 20), (20, 40), (40, 80)):
        mesh = box((1.0, 2 / cells), 1 / cells, periodic="xy")
        model = Model(material=material, viscosity=StokesViscosity(K_v=0.05, G_v=0.05))
        speed = sin(2 * pi * x)
        run = Simulation(mesh, model, dt=0.4 / steps, initial=Initial(velocity=(speed, 0.0)))
        ledger = run.run(0.4)
        rho, z = run.fields["density"], run.fields
        # det H of H = J^(-5/6) F is det F^(-3/2)
        det_F = Det(z["F"]) if "F" in z else Det(z["H"]) ** (-2 / 3)
        defects = {
            "rho J": distance(rho * z["J"], CF(1.0), mesh),
            "rho det F": distance(rho * det_F, CF(1.0), mesh),
        }
        table.add(1 / cells, **{n: d * math.sqrt(cells / 2) for n, d in defects.items()})
        closures.append(closure(run))
        compression.append(float(ledger.column("rho_max").max()))
        xs = np.linspace(0.01, 0.99, 99)
        profile = [float(rho(mesh(s, 0.5 / cells))) for s in xs]
        curves.append(Curve(f"{cells} cells", [float(s) for s in xs], profile, "-"))
    return Outcome(
        values={
            "rate of rho J − rho_0 in h ~ tau": table.last("rho J"),
            "rate of rho det F − rho_0 in h ~ tau": table.last("rho det F"),
            "largest compression rho/rho_0": compression[-1],
            "largest |closure|": max(closures),
        },
        tables=[table.table("h, m")],
        plots=[Plot("Density of the pulse at t = 0.4 s", "x, m", "kg/m3", curves)],
    )


def _wave_cases(kind: str) -> tuple[Case, ...]:
    return tuple(
        Case(
            name=f"dispersion-{wave}-{kind}",
            theme=THEME,
            statement=f"A small {wave} wave in {KINDS[kind]} has the phase speed and the decay of the "
            "dispersion relation rho omega² = M k² − i omega (D k² + mu k⁴), over a decade of k.",
            label="Euler-small-viscoelastodyn+1" if kind == "linearised" else "ED-Euler-large1",
            setting=f"Strip of one wave length, periodic; M = "
            f"{'G_e' if wave == 'shear' else 'K_e + 4/3 G_e'}, "
            f"K_e = {K_E:g} Pa, G_e = {G_E:g} Pa, K_v = {K_V:g}, G_v = {G_V:g} Pa s, mu = {MU:g} Pa s "
            f"m2 with p = 2; "
            "k = 1, 2, 5, 10 1/m; k = 3, m = 2, eight cells a wave, 30 steps; the step's own factor is "
            "undone.",
            bounds=(
                Bound("largest relative error of the phase speed", "<=", 2e-3, "eight cubic cells a wave"),
                Bound("largest relative error of the decay", "<=", 1e-2, "eight cubic cells a wave"),
                CLOSURE,
            ),
            run=partial(_dispersion, kind, wave),
            reduced=kind == "linearised" and wave == "shear",
        )
        for wave in ("shear", "acoustic")
    )


CASES = (
    *(case for kind in KINDS for case in _wave_cases(kind)),
    Case(
        name="standing-wave",
        theme=THEME,
        statement="A small elastic standing wave follows cos(k x) cos(c_s k t); its energy drifts by "
        "the implicit "
        "step's own damping only, which vanishes like tau.",
        label="Euler-small-viscoelastodyn+; Underworld3",
        setting="Strip of one wave length, k = 2 1/m, G_e = 1 Pa, no viscosity, five periods of 20, 40, "
        "80 steps.",
        bounds=(
            Bound("deviation from the implicit Euler formula", "<=", 2e-3, "the error in space"),
            Bound("rate of the energy drift in tau", ">=", 0.9, "order tau"),
            CLOSURE,
        ),
        run=_standing,
    ),
    *(
        Case(
            name=f"stokes-layer-{name}",
            theme=THEME,
            statement=f"The first Stokes problem, v = 0.1 erf(x/(2 sqrt(mu t))), is met by {what}.",
            label="Euler-small-viscoelastodyn+; benchmarks: first Stokes problem",
            setting="Column of 0.2 m x 1 m, periodic in x, at rest below, 0.1 m/s above, rho = 1, mu = "
            "1e-2 Pa s; from "
            "the exact layer at t = 0.25 s to t = 1 s in 15, 30, 60 steps; k = 3, m = 2, cells of 0.1 m.",
            bounds=(
                Bound("rate in tau", ">=", 0.85, "implicit Euler"),
                Bound("relative error, extrapolated", "<=", 5e-3, "one extrapolation, cells of 0.1 m"),
                CLOSURE,
            ),
            run=partial(_stokes, creeping),
            reduced=not creeping,
        )
        for name, what, creeping in (
            ("viscous", "a fluid of Stokes viscosity", False),
            ("maxwell", "a Maxwell body in its fluid limit (relaxation time 1 ms)", True),
        )
    ),
    *(
        Case(
            name=f"pulse-{name}",
            theme=THEME,
            statement="In a strong compression pulse with a steep front rho det F stays rho_0 in the "
            "limit, though "
            f"rho and {what} are transported apart.",
            label="1/J-continuity-eq, DT-det-extended",
            setting="Periodic tube of 1 m, v = sin(2 pi x) m/s at first, K_e = 1 Pa, G_e = 0.5 Pa, K_v "
            "= G_v = "
            "0.05 Pa s, until 0.4 s; 10, 20, 40 cells with twice as many steps.",
            bounds=(
                Bound("rate of rho J − rho_0 in h ~ tau", ">=", 0.8, "first order in tau ~ h"),
                Bound("rate of rho det F − rho_0 in h ~ tau", ">=", 0.8, "first order in tau ~ h"),
                Bound("largest compression rho/rho_0", ">=", 1.5, "a strong pulse"),
                CLOSURE,
            ),
            run=partial(_pulse, what),
        )
        for name, what in (("neo-hookean", "J and det F"), ("referential", "J and J^(-5/6) F"))
    ),
)

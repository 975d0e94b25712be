"""Jeffreys and Maxwell rheologies, and fluids by a conformation tensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel, structured_box
from ngvisco.physics.materials import FENEP
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table, extrapolated
from tests.verification.cases.shear import sheared, stresses
from tests.verification.setups import KINDS, elastic, followed, stokes

CASES = Cases("Exact solutions: rheology")

# --- Jeffreys and Maxwell bodies in shear --------------------------------------------------------------
"""In homogeneous simple shear the field equations are an ODE for the tensor (E, or F and J), which SciPy
integrates independently of the package's variables and rates."""

BY_B = "finite-b"
"""Name of the finite-strain model with B = F F^T instead of F, which has the same differential equation."""
NAMES = {**KINDS, BY_B: "the finite-strain model by B"}
G, LAMBDA, G_V = 1.0, 1.0, 0.25
"""Shear modulus, Pa, relaxation time, s, and parallel viscosity, Pa s. The viscosity of the Maxwell element
is G LAMBDA."""
G_M = 2 * G * LAMBDA


def material(kind: str) -> nv.Material:
    """The elastic material of the given kind (``NAMES``), with the shear modulus G."""
    return elastic(kind, 50.0, G)


def deviator(A: np.ndarray) -> np.ndarray:
    return A - np.trace(A) / 3 * np.eye(3)


def tensor_rate(kind: str, A: np.ndarray, rate: float, Pi: np.ndarray) -> np.ndarray:
    """The rate E' = eps + W E - E W - Pi, or F' = L F - F Pi, at a shear rate."""
    L = np.zeros((3, 3))
    L[0, 1] = rate
    W = (L - L.T) / 2
    return (L + L.T) / 2 + W @ A - A @ W - Pi if kind == "linearised" else L @ A - A @ Pi


def mandel(kind: str, A: np.ndarray) -> np.ndarray:
    """The driving stress: dev S, S = 2 G dev E, or dev(F^T S_F), F^T S_F = G J^(-5/3) F^T F with J = 1."""
    return 2 * G * deviator(A) if kind == "linearised" else deviator(G * A.T @ A)


def shear_stress(kind: str, values: np.ndarray) -> np.ndarray:
    """The elastic stress 2 G dev E, or G dev(F F^T), of a flattened tensor."""
    A = values.reshape(3, 3)
    return 2 * G * deviator(A) if kind == "linearised" else deviator(G * A @ A.T)


def start(kind: str) -> np.ndarray:
    return (np.zeros((3, 3)) if kind == "linearised" else np.eye(3)).ravel()


def _jeffreys_rate(kind: str, values: np.ndarray, rate: float) -> np.ndarray:
    A = values.reshape(3, 3)
    return tensor_rate(kind, A, rate, mandel(kind, A) / G_M).ravel()


def startup_ode(kind: str, rate: float, t: np.ndarray) -> np.ndarray:
    """Rows (T_12, T_11 - T_22) of the elastic stress at a constant shear rate."""
    found = solve_ivp(
        lambda _, A: _jeffreys_rate(kind, A, rate), (0, t[-1]), start(kind), t_eval=t, rtol=1e-10, atol=1e-12
    )
    T = [shear_stress(kind, values) for values in found.y.T]
    return np.array([(S[0, 1], S[0, 0] - S[1, 1]) for S in T])


def creep_ode(kind: str, traction: float, t: np.ndarray) -> np.ndarray:
    """Rows (shear, T_12) at a constant shear stress, traction = G_V rate + T_12."""

    def derivative(_: float, values: np.ndarray) -> np.ndarray:
        rate = (traction - shear_stress(kind, values[:9])[0, 1]) / G_V
        return np.append(_jeffreys_rate(kind, values[:9], rate), rate)

    begin = np.append(start(kind), 0.0)
    found = solve_ivp(derivative, (0, t[-1]), begin, t_eval=t, rtol=1e-10, atol=1e-12)
    stress = [shear_stress(kind, values[:9])[0, 1] for values in found.y.T]
    return np.array([found.y[9], stress]).T


def startup(kind: str, scheme: str = "backward-euler") -> Measured:
    rate, until = 1.0, 4.0
    table, curves = RateTable("largest error over the run, relative to G", "tau, s"), []
    for steps in (20, 40, 80):
        tau = until / steps
        _, rows = sheared(material(kind), tau, until, rate=rate, G_m=G_M, viscosity=G_V, scheme=scheme)
        exact = startup_ode(kind, rate, rows[:, 0])
        T_12, N_1 = np.abs(rows[:, 1:3] - exact).max(axis=0) / G
        table.add(tau, **{"T_12": float(T_12), "T_11 − T_22": float(N_1)})
        curves.append(Curve(f"{steps} steps", rows[:, 0], rows[:, 1] + G_V * rate, "."))
    curves.append(Curve("ODE", rows[:, 0], exact[:, 0] + G_V * rate, "k-"))
    yield from table.lasts()
    yield "error at the finest step", max(errors[-1] for errors in table.errors.values())
    yield table.table()
    yield Plot("Start-up of shear of a Jeffreys material", "t, s", "shear stress, Pa", curves)


def _creep(kind: str) -> Measured:
    traction, until = 0.5, 4.0
    table, curves = RateTable("largest error over the run", "tau, s"), []
    for steps in (20, 40, 80):
        model = nv.Model(material=material(kind), viscosity=stokes(G_V), creep=nv.Creep(G_m=G_M))
        walls: Conditions = {"top": nv.Traction(f=(traction, 0.0)), "bottom": nv.NoSlip()}
        dt, initial = until / steps, nv.Initial(density=1e-4)
        run = nv.Simulation(channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=initial)
        t, at_wall = followed(
            run, steps, lambda run: (run.fields["velocity"](run.mesh(0.4, 1.0))[0], stresses(run)[0])
        )
        at_wall[0] = 0.0
        shear = dt * np.cumsum(at_wall[:, 0])  # the wall's displacement over the height
        exact = creep_ode(kind, traction, t)
        errors = np.abs(np.column_stack([shear, at_wall[:, 1]]) - exact).max(axis=0)
        table.add(dt, **{"the shear": float(errors[0]), "T_12": float(errors[1])})
        curves.append(Curve(f"{steps} steps", t, shear, "."))
    curves.append(Curve("ODE", t, exact[:, 0], "k-"))
    yield from table.lasts()
    yield "error of the shear at the finest step", table.errors["the shear"][-1]
    yield table.table()
    yield Plot("Creep of a Jeffreys material under constant shear stress", "t, s", "shear", curves)


def _upper_convected(kind: str) -> Measured:
    """Compare with the upper-convected Maxwell fluid, the limit for Wi = lambda rate -> 0.

    F Pi F^T is (b^2 - tr b/3 b) G/G_m, the upper-convected (b - I)/(2 lambda) to first order in b - I."""
    table, against_ode = RateTable("deviation at t = 4 s, relative", "Wi"), 0.0
    for wi in (0.4, 0.2, 0.1, 0.05):
        rate, until, dt = wi / LAMBDA, 4.0, 0.1
        rows = extrapolated(
            *(sheared(material(kind), dt / n, until, rate=rate, G_m=G_M)[1][::n] for n in (1, 2, 4))
        )
        ode = startup_ode(kind, rate, rows[:, 0])[-1]
        against_ode = max(against_ode, np.abs(rows[-1, 1:3] / ode - 1).max())
        decay, eta = math.exp(-until / LAMBDA), G * LAMBDA
        normal = 2 * eta * LAMBDA * rate**2 * (1 - decay * (1 + until / LAMBDA))
        off = abs(rows[-1, 1:3] / [eta * rate * (1 - decay), normal] - 1)
        table.add(wi, **{"T_12": float(off[0]), "T_11 − T_22": float(off[1])})
    yield from table.lasts("rate of the deviation of {} in Wi")
    yield "size of the deviation of T_12 at Wi = 0.05", table.errors["T_12"][-1]
    yield "relative error against the ODE, extrapolated", against_ode
    yield table


for name, kind in (("upper-convected", "finite"), ("upper-convected-b", BY_B)):
    CASES(f"""{name}
        A Maxwell fluid of {NAMES[kind]} in shear tends to the upper-convected Maxwell fluid for small
          Weissenberg numbers, with a deviation of second order.
        label: ED-Euler-large2, ED-Euler-large3
        setting: The channel of jeffreys-startup without G_v; lambda = {LAMBDA:g} s, Wi = 0.4 to 0.05, until
          4 s, extrapolated twice from tau = 0.1 s.
        - rate of the deviation of [T_12; T_11 − T_22] in Wi >= 1.8: quadratic in the elastic strain
        - size of the deviation of T_12 at Wi = 0.05 in [6e-4, 0.01]: a quarter of Wi² and
          four times it
        - relative error against the ODE, extrapolated <= 2e-3: two extrapolations
        """)(partial(_upper_convected, kind))


for kind, name in NAMES.items():
    setting = f"G = {G:g} Pa, G_m = {G_M:g} Pa s, G_v = {G_V:g} Pa s, channel of 1 m x 1 m; 20, 40, 80 steps"
    label = "Euler-small-flow-rule" if kind == "linearised" else "ED-Euler-large2, ED-Euler-large3"
    CASES(f"""jeffreys-startup-{kind}{" (reduced)" * (kind == "finite")}
        Start-up of shear of a Jeffreys material in {name} follows its ODE.
        label: {label}
        setting: {setting}; shear rate 1/s until 4 s (shear 4).
        - rate of [T_12; T_11 − T_22] >= 0.85: implicit Euler
        - error at the finest step <= 0.05: first order, tau = 0.05 s
        - closure
        """)(partial(startup, kind))
    CASES(f"""jeffreys-creep-{kind}
        Creep of a Jeffreys material under a constant shear stress in {name} follows its ODE.
        label: {label}, rem-f-ne-0
        setting: {setting}; traction 0.5 Pa on the upper wall until 4 s, density 1e-4 (no inertia in the ODE).
        - rate of [the shear; T_12] >= 0.85: implicit Euler
        - error of the shear at the finest step <= 0.05: first order, tau = 0.05 s
        - closure
        """)(partial(_creep, kind))


# --- Oldroyd-B, FENE-P and Leonov ----------------------------------------------------------------------

G_E, RELAXATION = 0.5, 1.0
"""Half the shear modulus, Pa, and relaxation time, s; the viscosity is 2 G_E LAMBDA = 1 Pa s."""
G_M_FLUID = 4 * G_E * RELAXATION
WEISSENBERG = (0.5, 1.0, 2.0, 4.0)
EXTENSIBILITY = 30.0

Stresses = Callable[[float], tuple[float, float]]
"""A function that gives (T_12, N_1), Pa, for a Weissenberg number."""


def oldroyd(wi: float) -> tuple[float, float]:
    """The stresses eta rate and 2 eta lambda rate^2, without shear thinning."""
    return 2 * G_E * wi, 4 * G_E * wi**2


def leonov(wi: float) -> tuple[float, float]:
    """The stresses from c_12^2 + c_22^2 = 1, Wi c_22 = c_12 (c_11 + c_22)/2 and det c = 1.

    The solution is c_12 = Wi s, c_11 = (2 - s)/sqrt s with s = c_22^2 = (sqrt(1 + 4 Wi^2) - 1)/(2 Wi^2)."""
    s = (np.sqrt(1 + 4 * wi**2) - 1) / (2 * wi**2)
    return float(2 * G_E * wi * s), float(4 * G_E * (1 - s) / np.sqrt(s))


def fenep(wi: float) -> tuple[float, float]:
    """The stresses from f c - I = convected rate of c: c_22 = 1/f, c_12 = Wi/f^2, c_11 = (1 + 2
    Wi^2/f^2)/f."""
    b = EXTENSIBILITY
    # the root with tr c < b lies above the pole
    pole = brentq(lambda f: b * f**3 - 3 * f**2 - 2 * wi**2, 1e-6, 10 + 2 * wi**2)
    f = brentq(lambda f: f - (b - 3) / (b - (3 + 2 * wi**2 / f**2) / f), pole * (1 + 1e-12), 10 + 2 * wi**2)
    return 2 * G_E * wi / f, 4 * G_E * wi**2 / f**2


FLUIDS: dict[str, tuple[nv.Material, Stresses, str]] = {
    "oldroyd-b": (
        nv.OldroydB(K_e=100.0, G_e=G_E),
        oldroyd,
        "An Oldroyd-B fluid in steady shear has no shear thinning, and N_1 = 2 eta lambda rate².",
    ),
    "fene-p": (
        FENEP(K_e=100.0, G_e=G_E, b=EXTENSIBILITY),
        fenep,
        f"A FENE-P fluid (b = {EXTENSIBILITY:g}) in steady shear has the stresses of its closed form.",
    ),
}


def _steady(name: str) -> Measured:
    material, exact, _ = FLUIDS[name]
    rows = []
    for wi in WEISSENBERG:
        _, stress = sheared(material, 0.25, 25.0, rate=wi / RELAXATION, G_m=G_M_FLUID, law="conformation")
        found = stress[-1, 1:3]
        rows.append([wi, *found, *exact(wi), *abs(found / exact(wi) - 1)])
    yield "largest relative error of T_12", max(row[-2] for row in rows)
    yield "largest relative error of N_1", max(row[-1] for row in rows)
    head = "Wi | T_12 | N_1 | exact T_12 | exact N_1 | error | error"
    yield from Table("steady stresses, Pa", head, rows).drawn(0, 1, 2, 3, 4, log="xy")


for name, (*_, claim) in FLUIDS.items():
    CASES(f"""{name}-shear{" (reduced)" * (name == "oldroyd-b")}
        {claim}
        label: Bird, Armstrong, Hassager 1987; Leonov 1976
        setting: Channel of 1 m x 1 m between a resting and a sliding wall, lambda = 1 s, eta = 1 Pa s, K_e =
          100 Pa, Wi = 0.5 to 4, 100 steps of 0.25 s.
        - largest relative error of [T_12; N_1] <= 1e-6: a steady state has no error of time
        - closure
        """)(partial(_steady, name))


@CASES("""leonov-shear
    A Leonov fluid in steady shear has the stresses of its closed form; its shear stress is bounded.
    label: Leonov 1976
    setting: The same channel, Wi = 0.5 to 2, until 12 s, extrapolated twice from tau = 0.1 s.
    - relative error of [T_12; N_1], extrapolated <= 0.02: two extrapolations
    - smallest rate in tau >= 0.8: implicit Euler
    - closure
    """)
def _leonov() -> Measured:
    """Measure stresses extrapolated in tau. Since Pi is trace-free, an error of det B = 1 that the start-up
    makes remains."""
    material, dt, until = nv.OldroydB(K_e=100.0, G_e=G_E), 0.1, 12.0
    rows = []
    for wi in WEISSENBERG[:3]:
        A, B, C = (
            sheared(material, dt / n, until, rate=wi / RELAXATION, G_m=G_M_FLUID, law="leonov")[1][-1, 1:3]
            for n in (1, 2, 4)
        )
        exact = np.array(leonov(wi))
        found, rate = extrapolated(A, B, C), np.log2(abs(B - exact) / abs(C - exact)).min()
        rows.append([wi, *found, *exact, *abs(found / exact - 1), rate])
    yield "relative error of T_12, extrapolated", max(row[-3] for row in rows)
    yield "relative error of N_1, extrapolated", max(row[-2] for row in rows)
    yield "smallest rate in tau", min(row[-1] for row in rows)
    head = "Wi | T_12 | N_1 | exact T_12 | exact N_1 | error | error | rate"
    yield from Table("stresses, Pa, extrapolated", head, rows).drawn(0, 1, 2, 3, 4, log="xy")


# --- waves of velocity in a starting Couette flow ---------------------------------------------------------

WAVE_MODULUS, WAVE_SOLVENT, WAVE_TIME = 1.0, 0.1, 1.0
"""Modulus, Pa, and relaxation time, s, of the chains, and viscosity of the solvent, Pa s."""
WAVE_INSTANTS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Times at which the velocities are compared, s."""


def started_couette(y: float, t: float, modes: int = 400) -> float:
    """v(y, t) of an Oldroyd-B fluid of density 1 kg/m^3 in 0 < y < 1 m, whose wall y = 1 moves with 1 m/s.

    Less the steady v = y, the velocity is a sum of sin(q y), q = k pi, whose amplitudes a and those s of the
    chains' stress obey a' = -q (eta_s q a + s) and lambda s' + s = G lambda q a (Waters and King 1970).
    """
    v = y
    for k in range(1, modes + 1):
        q = k * np.pi
        rates, vectors = np.linalg.eig(
            np.array([[-WAVE_SOLVENT * q * q, -q], [WAVE_MODULUS * q, -1 / WAVE_TIME]], dtype=complex)
        )
        amplitude = vectors[0] @ (np.linalg.solve(vectors, [1, 0]) * np.exp(rates * t))
        v += 2 * (-1) ** k / q * amplitude.real * np.sin(q * y)
    return v


@CASES("""oldroyd-b-started-couette
    An Oldroyd-B fluid beside a wall that starts has waves of velocity, which come back from the other wall.
    label: Waters, King 1970
    setting: A gap of 1 m, 12 rows of cells, periodic along the wall; density 1 kg/m3, G = 1 Pa, lambda = 1 s,
      solvent 0.1 Pa s, K_e = 1000 Pa; the wall moves with 1 m/s from t = 0 on; k = 2, m = 1, SDIRK2, steps of
      0.025 s. The bound was stated before trials.
    - velocity less the closed form's in [a quarter; the middle; three quarters] of the gap, m/s in [-0.01,
      0.01]: at 1 s v in the middle is 0.23 above its steady value
    - closure
    """)
def _started_couette() -> Measured:
    G_m = 2 * WAVE_MODULUS * WAVE_TIME
    model = nv.Model(
        material=nv.OldroydB(K_e=1000.0, G_e=WAVE_MODULUS / 2),
        viscosity=stokes(WAVE_SOLVENT),
        creep=nv.Creep(G_m=G_m, law="conformation"),
    )
    run = nv.Simulation(
        structured_box((0.1, 1.0), (1, 12), periodic="x"),
        model,
        time=nv.TimeSteps(dt=0.025, scheme="sdirk2"),
        walls={"top": nv.PrescribedTangential((1.0, 0.0)), "bottom": nv.NoSlip()},
        initial=nv.Initial(density=1.0),
    )
    places, rows = {"a quarter": 0.25, "the middle": 0.5, "three quarters": 0.75}, []
    for t in WAVE_INSTANTS:
        run.run(t)
        found = [run.fields["velocity"](run.mesh(0.05, y))[0] for y in places.values()]
        rows.append([t, *found, *(started_couette(y, t) for y in places.values())])
    for i, name in enumerate(places, 1):
        off = max((row[i] - row[i + 3] for row in rows), key=abs)
        yield f"velocity less the closed form's in {name} of the gap, m/s", off
    head = "t, s | at 0.25 m | at 0.5 m | at 0.75 m | exact | exact | exact"
    yield from Table("velocities, m/s", head, rows).drawn(0, 1, 2, 3, 4, 5, 6)

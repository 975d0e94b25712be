"""Jeffreys and Maxwell rheologies against ordinary differential equations and the upper-convected limit.

In a homogeneous simple shear every field equation is an ODE for the tensor (E, or F and J), which SciPy
integrates independently of the package's variables and rates.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel
from tests.verification.case import Cases, Curve, Outcome, Plot, measured
from tests.verification.cases.shear import sheared, stresses
from tests.verification.rates import RateTable
from tests.verification.setups import KINDS, elastic, stokes

CASES = Cases("Exact solutions: rheology")

BY_B = "finite-b"
"""The finite-strain model with the material by B = F F^T instead of F: the same differential equation."""
NAMES = {**KINDS, BY_B: "the finite-strain model by B"}
G, LAMBDA, G_V = 1.0, 1.0, 0.25
"""Shear modulus Pa, relaxation time s, viscosity beside the Maxwell element Pa s; its own is G LAMBDA."""

Rate = Callable[[np.ndarray, float], np.ndarray]
"""Time derivative of the flattened tensor for a shear rate."""


def material(kind: str) -> nv.Material:
    """Shear modulus G in all of ``NAMES``."""
    return elastic(kind, 50.0, G)


G_M = 2 * G * LAMBDA


def deviator(A: np.ndarray) -> np.ndarray:
    return A - np.trace(A) / 3 * np.eye(3)


def linearised_rate(values: np.ndarray, rate: float) -> np.ndarray:
    """E' = eps + W E - E W - dev S/G_m, S = 2 G dev E."""
    E, L = values.reshape(3, 3), np.zeros((3, 3))
    L[0, 1] = rate
    W = (L - L.T) / 2
    return ((L + L.T) / 2 + W @ E - E @ W - 2 * G * deviator(E) / G_M).ravel()


def finite_rate(values: np.ndarray, rate: float) -> np.ndarray:
    """F' = L F - F dev(F^T S_F)/G_m with F^T S_F = G J^(-5/3) F^T F; J stays 1."""
    F, L = values.reshape(3, 3), np.zeros((3, 3))
    L[0, 1] = rate
    return (L @ F - F @ (deviator(G * F.T @ F) / G_M)).ravel()


def shear_stress(kind: str, values: np.ndarray) -> np.ndarray:
    """The elastic stress of the tensor: 2 G dev E, or G dev(F F^T)."""
    A = values.reshape(3, 3)
    return 2 * G * deviator(A) if kind == "linearised" else deviator(G * A @ A.T)


def start(kind: str) -> np.ndarray:
    return (np.zeros((3, 3)) if kind == "linearised" else np.eye(3)).ravel()


RATES: dict[str, Rate] = {"linearised": linearised_rate, "finite": finite_rate, BY_B: finite_rate}


def startup_ode(kind: str, rate: float, t: np.ndarray) -> np.ndarray:
    """Rows (T_12, T_11 - T_22) of the elastic stress at constant shear rate."""
    ode = RATES[kind]
    solution = solve_ivp(lambda _, A: ode(A, rate), (0, t[-1]), start(kind), t_eval=t, rtol=1e-10, atol=1e-12)
    T = [shear_stress(kind, values) for values in solution.y.T]
    return np.array([(S[0, 1], S[0, 0] - S[1, 1]) for S in T])


def creep_ode(kind: str, traction: float, t: np.ndarray) -> np.ndarray:
    """Rows (shear, T_12) at constant shear stress, traction = G_V rate + T_12."""
    ode = RATES[kind]

    def derivative(_: float, values: np.ndarray) -> np.ndarray:
        rate = (traction - shear_stress(kind, values[:9])[0, 1]) / G_V
        return np.append(ode(values[:9], rate), rate)

    begin = np.append(start(kind), 0.0)
    solution = solve_ivp(derivative, (0, t[-1]), begin, t_eval=t, rtol=1e-10, atol=1e-12)
    stress = [shear_stress(kind, values[:9])[0, 1] for values in solution.y.T]
    return np.array([solution.y[9], stress]).T


def startup(kind: str, scheme: str = "backward-euler") -> Outcome:
    rate, until = 1.0, 4.0
    table, curves = RateTable("largest error over the run, relative to G"), []
    for steps in (20, 40, 80):
        _, rows = sheared(
            material(kind), until / steps, until, rate=rate, G_m=G_M, viscosity=G_V, scheme=scheme
        )
        exact = startup_ode(kind, rate, rows[:, 0])
        errors = np.abs(rows[:, 1:3] - exact).max(axis=0) / G
        table.add(until / steps, T_12=float(errors[0]), N_1=float(errors[1]))
        curves.append(Curve(f"{steps} steps", rows[:, 0], rows[:, 1] + G_V * rate, "."))
    curves.append(Curve("ODE", rows[:, 0], exact[:, 0] + G_V * rate, "k-"))
    return measured(
        {
            "rate of T_12": table.last("T_12"),
            "rate of T_11 − T_22": table.last("N_1"),
            "error at the finest step": max(table.errors["T_12"][-1], table.errors["N_1"][-1]),
        },
        table.table("tau, s"),
        Plot("Start-up of shear of a Jeffreys material", "t, s", "shear stress, Pa", curves),
    )


def _creep(kind: str) -> Outcome:
    traction, until, density = 0.5, 4.0, 1e-4
    table, curves = RateTable("largest error over the run"), []
    for steps in (20, 40, 80):
        model = nv.Model(material=material(kind), viscosity=stokes(G_V), creep=nv.Creep(G_m=G_M))
        walls: Conditions = {"top": nv.Traction(f=(traction, 0.0)), "bottom": nv.NoSlip()}
        dt = until / steps
        run = nv.Simulation(
            channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=nv.Initial(density=density)
        )
        rows, shear = [(0.0, 0.0, 0.0)], 0.0
        for _ in range(steps):
            run.advance()
            # the wall's displacement over the height
            shear += dt * float(run.fields["velocity"](run.mesh(0.4, 1.0))[0])
            rows.append((run.t, shear, stresses(run)[0]))
        found = np.array(rows)
        exact = creep_ode(kind, traction, found[:, 0])
        errors = np.abs(found[:, 1:] - exact).max(axis=0)
        table.add(dt, shear=float(errors[0]), T_12=float(errors[1]))
        curves.append(Curve(f"{steps} steps", found[:, 0], found[:, 1], "."))
    curves.append(Curve("ODE", found[:, 0], exact[:, 0], "k-"))
    return measured(
        {
            "rate of the shear": table.last("shear"),
            "rate of T_12": table.last("T_12"),
            "error of the shear at the finest step": table.errors["shear"][-1],
        },
        table.table("tau, s"),
        Plot("Creep of a Jeffreys material under constant shear stress", "t, s", "shear", curves),
    )


def _upper_convected(kind: str) -> Outcome:
    """The finite-strain Maxwell fluid at small Weissenberg number is the upper-convected one."""
    table, curves = RateTable("deviation from the upper-convected Maxwell fluid at t = 4 s, relative"), []
    against_ode = 0.0
    for wi in (0.4, 0.2, 0.1, 0.05):
        rate, until, dt = wi / LAMBDA, 4.0, 0.1
        (_, a), (_, b), (_, c) = (
            sheared(material(kind), dt / n, until, rate=rate, G_m=G_M) for n in (1, 2, 4)
        )
        rows = (8 * c[::4] - 6 * b[::2] + a) / 3
        t = rows[:, 0]
        ode = startup_ode(kind, rate, t)
        against_ode = max(against_ode, float(np.abs(rows[-1, 1:3] / ode[-1] - 1).max()))
        decay, eta = np.exp(-t / LAMBDA), G * LAMBDA
        shear = eta * rate * (1 - decay)
        normal = 2 * eta * LAMBDA * rate**2 * (1 - decay * (1 + t / LAMBDA))
        deviation = [float(abs(rows[-1, i] / f[-1] - 1)) for i, f in ((1, shear), (2, normal))]
        table.add(wi, T_12=deviation[0], N_1=deviation[1])
        curves.append(Curve(f"Wi = {wi:g}", t, rows[:, 1] / (eta * rate), "."))
    curves.append(Curve("upper-convected", t, 1 - decay, "k-"))
    return measured(
        {
            "rate of the deviation of T_12 in Wi": table.last("T_12"),
            "rate of the deviation of T_11 − T_22 in Wi": table.last("N_1"),
            "deviation of T_12 at Wi = 0.05": table.errors["T_12"][-1],
            "relative error against the ODE, extrapolated": against_ode,
        },
        table.table("Wi"),
        Plot("Start-up of shear, finite-strain Maxwell", "t, s", "T_12 / (eta rate)", curves),
        "F Pi F^T = (F dev(F^T F) F^T) G/G_m is (b² − tr b/3 b) G/G_m, which is the upper-convected "
        "(b − I)/(2 lambda) only to first order in b − I: the two fluids agree as Wi = lambda rate -> 0.",
    )


for kind in NAMES:
    name = NAMES[kind]
    setting = (
        f"G = {G:g} Pa, G_m = {G_M:g} Pa s, G_v = {G_V:g} Pa s, channel of 1 m x 1 m (cells of 0.5 m); 20, "
        "40, 80 steps"
    )
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


for kind in ("finite", BY_B):
    CASES(f"""{"upper-convected" if kind == "finite" else "upper-convected-b"}
        A Maxwell fluid of {NAMES[kind]} in shear is the upper-convected Maxwell fluid in the limit of small
          Weissenberg numbers, with a deviation of second order.
        label: ED-Euler-large2, ED-Euler-large3
        setting: The same channel without G_v; lambda = {LAMBDA:g} s, Wi = 0.4 to 0.05, until 4 s,
          extrapolated twice from tau = 0.1 s.
        - rate of the deviation of [T_12; T_11 − T_22] in Wi >= 1.8: quadratic in the elastic strain
        - deviation of T_12 at Wi = 0.05 <= 0.01: of the order of Wi²
        - relative error against the ODE, extrapolated <= 2e-3: two extrapolations
        """)(partial(_upper_convected, kind))

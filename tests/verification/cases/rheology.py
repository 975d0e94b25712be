"""Jeffreys and Maxwell rheologies, and fluids by a conformation tensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np
from netgen.occ import Circle, OCCGeometry, WorkPlane
from ngsolve import CF, CoefficientFunction, Mesh, cos, exp, sin, y
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel, structured_box
from ngvisco.physics.flow_rules import CreepLaw
from ngvisco.physics.materials import FENEP
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.cases.shear import sheared, stresses
from tests.verification.rates import RateTable, extrapolated
from tests.verification.setups import KINDS, elastic, followed, stokes

CASES = Cases("Exact solutions: rheology")

# --- Jeffreys and Maxwell bodies in shear --------------------------------------------------------------
"""Jeffreys and Maxwell rheologies against ordinary differential equations and the upper-convected limit.

In a homogeneous simple shear every field equation is an ODE for the tensor (E, or F and J), which SciPy
integrates independently of the package's variables and rates.
"""

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


def startup(kind: str, scheme: str = "backward-euler") -> Measured:
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
    yield "rate of T_12", table.last("T_12")
    yield "rate of T_11 − T_22", table.last("N_1")
    yield "error at the finest step", max(table.errors["T_12"][-1], table.errors["N_1"][-1])
    yield table.table("tau, s")
    yield Plot("Start-up of shear of a Jeffreys material", "t, s", "shear stress, Pa", curves)


def _creep(kind: str) -> Measured:
    traction, until, density = 0.5, 4.0, 1e-4
    table, curves = RateTable("largest error over the run"), []
    for steps in (20, 40, 80):
        model = nv.Model(material=material(kind), viscosity=stokes(G_V), creep=nv.Creep(G_m=G_M))
        walls: Conditions = {"top": nv.Traction(f=(traction, 0.0)), "bottom": nv.NoSlip()}
        dt = until / steps
        run = nv.Simulation(
            channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=nv.Initial(density=density)
        )
        t, at_wall = followed(
            run, steps, lambda run: (run.fields["velocity"](run.mesh(0.4, 1.0))[0], stresses(run)[0])
        )
        at_wall[0] = 0.0
        # the wall's displacement over the height
        found = np.column_stack([t, dt * np.cumsum(at_wall[:, 0]), at_wall[:, 1]])
        exact = creep_ode(kind, traction, found[:, 0])
        errors = np.abs(found[:, 1:] - exact).max(axis=0)
        table.add(dt, shear=float(errors[0]), T_12=float(errors[1]))
        curves.append(Curve(f"{steps} steps", found[:, 0], found[:, 1], "."))
    curves.append(Curve("ODE", found[:, 0], exact[:, 0], "k-"))
    yield "rate of the shear", table.last("shear")
    yield "rate of T_12", table.last("T_12")
    yield "error of the shear at the finest step", table.errors["shear"][-1]
    yield table.table("tau, s")
    yield Plot("Creep of a Jeffreys material under constant shear stress", "t, s", "shear", curves)


def _upper_convected(kind: str) -> Measured:
    """The finite-strain Maxwell fluid at small Weissenberg number is the upper-convected one."""
    table, curves = RateTable("deviation from the upper-convected Maxwell fluid at t = 4 s, relative"), []
    against_ode = 0.0
    for wi in (0.4, 0.2, 0.1, 0.05):
        rate, until, dt = wi / LAMBDA, 4.0, 0.1
        rows = extrapolated(
            *(sheared(material(kind), dt / n, until, rate=rate, G_m=G_M)[1][::n] for n in (1, 2, 4))
        )
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
    yield "rate of the deviation of T_12 in Wi", table.last("T_12")
    yield "rate of the deviation of T_11 − T_22 in Wi", table.last("N_1")
    yield "deviation of T_12 at Wi = 0.05", table.errors["T_12"][-1]
    yield "relative error against the ODE, extrapolated", against_ode
    yield table.table("Wi")
    yield Plot("Start-up of shear, finite-strain Maxwell", "t, s", "T_12 / (eta rate)", curves)
    yield (
        "F Pi F^T = (F dev(F^T F) F^T) G/G_m is (b² − tr b/3 b) G/G_m, which is the upper-convected "
        "(b − I)/(2 lambda) only to first order in b − I: the two fluids agree as Wi = lambda rate -> 0."
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


# --- Oldroyd-B, FENE-P and Leonov ----------------------------------------------------------------------

G_E, RELAXATION = 0.5, 1.0
"""Half the shear modulus, Pa, and relaxation time, s; the viscosity is 2 G_E LAMBDA = 1 Pa s."""
G_M_FLUID = 4 * G_E * RELAXATION
WEISSENBERG = (0.5, 1.0, 2.0, 4.0)
EXTENSIBILITY = 30.0

Curves = Callable[[float], tuple[float, float]]
"""(T_12, N_1) in Pa for a Weissenberg number."""


def oldroyd(wi: float) -> tuple[float, float]:
    """eta rate and 2 eta lambda rate^2: no shear thinning."""
    return 2 * G_E * wi, 4 * G_E * wi**2


def leonov(wi: float) -> tuple[float, float]:
    """From c_12^2 + c_22^2 = 1, Wi c_22 = c_12 (c_11 + c_22)/2 and det c = 1: with s = c_22^2,
    s = (sqrt(1 + 4 Wi^2) - 1)/(2 Wi^2), c_12 = Wi s, c_11 = (2 - s)/sqrt s.
    """
    s = (np.sqrt(1 + 4 * wi**2) - 1) / (2 * wi**2)
    return float(2 * G_E * wi * s), float(4 * G_E * (1 - s) / np.sqrt(s))


def fenep(wi: float) -> tuple[float, float]:
    """f c - I = the convected rate of c, so that c_22 = 1/f, c_12 = Wi/f^2, c_11 = (1 + 2 Wi^2/f^2)/f."""
    b = EXTENSIBILITY

    def defect(f: float) -> float:
        return f - (b - 3) / (b - (3 + 2 * wi**2 / f**2) / f)

    # the root with tr c < b lies above the pole
    pole = brentq(lambda f: b * f**3 - 3 * f**2 - 2 * wi**2, 1e-6, 10 + 2 * wi**2)
    f = brentq(defect, pole * (1 + 1e-12), 10 + 2 * wi**2)
    return 2 * G_E * wi / f, 4 * G_E * wi**2 / f**2


FLUIDS: dict[str, tuple[nv.Material, CreepLaw, Curves, str]] = {
    "oldroyd-b": (
        nv.OldroydB(K_e=100.0, G_e=G_E),
        "conformation",
        oldroyd,
        "An Oldroyd-B fluid in steady shear has no shear thinning, and N_1 = 2 eta lambda rate².",
    ),
    "fene-p": (
        FENEP(K_e=100.0, G_e=G_E, b=EXTENSIBILITY),
        "conformation",
        fenep,
        f"A FENE-P fluid (b = {EXTENSIBILITY:g}) in steady shear has the stresses of its closed form.",
    ),
}


def _curves(exact: Curves, numbers: Sequence[float], found: Sequence[Sequence[float]]) -> list[Curve]:
    """Stresses that were found at some Weissenberg numbers, and the closed form."""
    fine = np.geomspace(0.2, 6, 40)
    closed = np.array([exact(wi) for wi in fine])
    return [
        Curve("T_12", numbers, [T for T, _ in found], "o"),
        Curve("N_1", numbers, [N for _, N in found], "s"),
        Curve("T_12, closed form", fine, closed[:, 0], "k-"),
        Curve("N_1, closed form", fine, closed[:, 1], "k--"),
    ]


def _steady(name: str) -> Measured:
    material, law, exact, _ = FLUIDS[name]
    rows, errors, found = [], [0.0, 0.0], []
    for wi in WEISSENBERG:
        run, stress = sheared(material, 0.25, 25.0, rate=wi / RELAXATION, G_m=G_M_FLUID, law=law)
        T, N = float(stress[-1, 1]), float(stress[-1, 2])
        T_exact, N_exact = exact(wi)
        found.append((T, N))
        errors = [max(errors[0], abs(T / T_exact - 1)), max(errors[1], abs(N / N_exact - 1))]
        rows.append([wi, T, T_exact, N, N_exact, float(run.ledger.column("closure_relative").max())])
    yield "largest relative error of T_12", errors[0]
    yield "largest relative error of N_1", errors[1]
    yield Table("steady stresses, Pa", "Wi | T_12 | exact | N_1 | exact | closure", rows)
    yield Plot(f"Steady shear, {name}", "Wi", "Pa", _curves(exact, WEISSENBERG, found), log="xy")


for name in FLUIDS:
    CASES(f"""{name}-shear{" (reduced)" * (name == "oldroyd-b")}
        {FLUIDS[name][3]}
        label: Bird, Armstrong, Hassager 1987; Leonov 1976
        setting: Channel of 1 m x 1 m between a resting and a sliding wall, lambda = 1 s, eta = 1 Pa s, K_e =
          100 Pa, Wi = 0.5 to 4, 100 steps of 0.25 s.
        - largest relative error of T_12 <= 1e-6: a steady state has no error of time
        - largest relative error of N_1 <= 1e-6: a steady state has no error of time
        - closure
        """)(partial(_steady, name))


@CASES("""leonov-shear
    A Leonov fluid in steady shear has the stresses of its closed form; its shear stress has a bound.
    label: Leonov 1976
    setting: The same channel, Wi = 0.5 to 2, until 12 s, extrapolated twice from tau = 0.1 s.
    - relative error of T_12, extrapolated <= 0.02: two extrapolations
    - relative error of N_1, extrapolated <= 0.02: two extrapolations
    - smallest rate in tau >= 0.8: implicit Euler
    - closure
    """)
def _leonov() -> Measured:
    """Extrapolated: Pi is trace-free, so that what the start-up's steps lose of det B = 1 stays lost."""
    material, dt, until = nv.OldroydB(K_e=100.0, G_e=G_E), 0.1, 12.0
    rows, errors, rates, found = [], [0.0, 0.0], [], []
    for wi in WEISSENBERG[:3]:
        A, B, C = (
            sheared(material, dt / n, until, rate=wi / RELAXATION, G_m=G_M_FLUID, law="leonov")[1][-1, 1:3]
            for n in (1, 2, 4)
        )
        exact = np.array(leonov(wi))
        T, N = extrapolated(A, B, C)
        errors = [max(errors[0], abs(T / exact[0] - 1)), max(errors[1], abs(N / exact[1] - 1))]
        rates.append(float(np.log2(abs(B - exact) / abs(C - exact)).min()))
        found.append((float(T), float(N)))
        rows.append([wi, float(C[0]), float(T), float(exact[0]), float(N), float(exact[1]), rates[-1]])
    curves = _curves(leonov, WEISSENBERG[:3], found)
    yield "relative error of T_12, extrapolated", errors[0]
    yield "relative error of N_1, extrapolated", errors[1]
    yield "smallest rate in tau", min(rates)
    yield Table(
        "steady stresses, Pa",
        "Wi | T_12, tau = 0.025 s | extrapolated | exact | N_1 | exact | rate",
        rows,
    )
    yield Plot("Steady shear, Leonov", "Wi", "Pa", curves, log="xy")


def channel_startup(t: np.ndarray, heights: np.ndarray, eta_s: float) -> np.ndarray:
    """v(t, y) of an Oldroyd-B fluid of density 1 under a unit force from rest, (times, heights).

    rho v_t = eta_s v_yy + tau_y + 1, lambda tau_t = eta_p v_y - tau (Waters and King 1970), for each sine in
    y an equation for two numbers with constant coefficients, solved by the matrix exponential.
    """
    v = np.zeros((len(t), len(heights)))
    for n in range(1, 80, 2):
        A, steady = _of_sine(n, eta_s)
        amplitudes = [(steady - expm(A * s) @ steady)[0] for s in t]
        v += np.outer(amplitudes, np.sin(n * np.pi * heights))
    return v


def startup_velocity(eta_s: float) -> CoefficientFunction:
    """The same as a function of y and ``ngvisco.time``, by the eigenvectors of each sine's equation."""
    v = CF(0.0)
    for n in range(1, 16, 2):
        A, steady = _of_sine(n, eta_s)
        rates, vectors = np.linalg.eig(A.astype(complex))
        amplitude = CF(float(steady[0]))
        for rate, c in zip(rates, vectors[0] * np.linalg.solve(vectors, steady), strict=True):
            turn = float(rate.imag) * nv.time
            swing = float(c.real) * cos(turn) - float(c.imag) * sin(turn)
            amplitude -= exp(float(rate.real) * nv.time) * swing
        v += amplitude * sin(n * np.pi * y)
    return v


def _of_sine(n: int, eta_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and steady state of (v, tau) of the n-th sine."""
    k, eta_p = n * np.pi, 2 * G_E * RELAXATION
    A = np.array([[-eta_s * k * k, -k], [eta_p * k / RELAXATION, -1 / RELAXATION]])
    return A, np.linalg.solve(A, [-4 / (n * np.pi), 0.0])


def _periodic(eta_s: float) -> tuple[Mesh, Conditions]:
    return channel(0.3, 1.0, maxh=0.15), {}


def _in_and_out(eta_s: float) -> tuple[Mesh, Conditions]:
    """With an inlet that moves as the series says, by a fluid at rest before it, and an outlet."""
    inlet = nv.Inflow(velocity=(startup_velocity(eta_s), 0.0), density=1.0)
    return structured_box((2.0, 1.0), (12, 7)), {"left": inlet, "right": nv.Open(density=1.0)}


def _waters_king(domain: Callable[[float], tuple[Mesh, Conditions]], place: float) -> Measured:
    """The velocity across the channel at x = ``place``."""
    eta_s, until = 0.1, 4.0
    heights = np.linspace(0.05, 0.95, 19)
    x0 = 0 * heights + place
    table, curves = RateTable("largest error of the velocity, relative to the steady maximum"), []
    found = []
    largest = 1 / (8 * (eta_s + 2 * G_E * RELAXATION))
    for steps in (40, 80, 160):
        model = nv.Model(
            material=nv.OldroydB(K_e=200.0, G_e=G_E),
            viscosity=stokes(eta_s),
            creep=nv.Creep(G_m=G_M_FLUID, law="conformation"),
            loads=(nv.BodyForce((1.0, 0.0)),),
        )
        mesh, ends = domain(eta_s)
        walls = {"bottom": nv.NoSlip(), "top": nv.NoSlip(), **dict(ends)}
        orders = nv.Discretisation(k=2, m=1)
        run = nv.Simulation(mesh, model, dt=until / steps, walls=walls, discretisation=orders)
        _, v = followed(run, steps, lambda run: run.fields["velocity"](run.mesh(x0, heights))[:, 0])
        t = run.dt * np.arange(1, steps + 1)
        exact = channel_startup(t, heights, eta_s)
        found.append(v[1:])
        table.add(run.dt, v=float(np.abs(v[1:] - exact).max() / largest))
        curves.append(Curve(f"{steps} steps", t, found[-1][:, 9], "."))
    best = extrapolated(found[0], found[1][1::2], found[2][3::4])
    curves.append(Curve("series", t, exact[:, 9], "k-"))
    yield "rate in tau", table.last("v")
    yield "error, extrapolated", np.abs(best - exact[3::4]).max() / largest
    yield "overshoot of the exact solution", exact[:, 9].max() / exact[-1, 9]
    yield table.table("tau, s")
    yield Plot("Start-up of channel flow, Oldroyd-B", "t, s", "v in the middle, m/s", curves)


_STARTUP = """- rate in tau >= 0.8: implicit Euler, with an inertial start
    - error, extrapolated <= 0.05: two extrapolations
    - overshoot of the exact solution >= 1.5: the fluid is elastic
    - closure"""
CASES(f"""waters-king
    The start-up of plane channel flow of an Oldroyd-B fluid overshoots as the series says.
    label: Waters and King 1970
    setting: Channel of height 1 m, density 1, body force 1 N/m3, eta_s = 0.1 and eta_p = 1 Pa s, lambda = 1
      s, K_e = 200 Pa; cells of 0.15 m, 40, 80 and 160 steps until 4 s.
    {_STARTUP}
    """)(partial(_waters_king, _periodic, 0.11))
CASES(f"""waters-king-in-and-out
    The same between an inlet and an outlet: a height from each the flow is that of the endless channel.
    label: Waters and King 1970
    setting: The same fluid in a channel of 2 m x 1 m, at whose left end the velocity is that of the series
      and fluid at rest comes in, at whose right end there is no stress; 168 triangles, 40, 80 and 160 steps
      until 4 s.
    {_STARTUP}
    """)(partial(_waters_king, _in_and_out, 1.0))


# --- an Oldroyd-B fluid past a cylinder that blocks half of a channel ----------------------------------
"""Creeping flow of an Oldroyd-B fluid past a cylinder that blocks half of a channel: the drag.

Half of the channel by symmetry, radius and mean velocity 1; fluid comes in with the stretch of the flow
between plates, and leaves under that flow's stress.  A Weissenberg number Wi is the relaxation time, s; each
run starts from the state of the one before.

What ends runs of larger Wi is that det B turns negative at points of some cells: with m = 2 and cells of
0.8 m along the channel's wall in those at (1.2, 1.8) and (1.9, 1.8) m, not at the cylinder.  Two cells are
limited at Wi = 0.6 then, and the drag, the reaction before the limiter, in which phi has ln det B, is no
number.  With 0.25 m there none is limited.  With m = 1 (0.15 m at the cylinder) cells are from Wi = 0.3 on,
and with 0.03 m there from Wi = 0.5 on; the split solver finds no step at Wi = 0.3 after 1.25 s.
"""

BETA, DENSITY, BULK, DT = 0.59, 0.01, 2e4, 0.25
"""The solvent's share of the viscosity, which is 1 Pa s; kg/m^3: Re = 0.01; Pa; s."""
PUBLISHED = {0.3: 123.193, 0.4: 120.596, 0.5: 118.836, 0.6: 117.775}
"""Drag, N/m, by Wi: Hulsen, Fattal and Kupferman 2005."""
NEWTONIAN = 132.358
LENGTHS = (-4.0, -2.0, 4.0, 8.0)
"""Where the channel begins and ends, and its finer part, m."""


def half_channel() -> Mesh:
    """Its upper half: cells of 0.07 m at the cylinder, 0.25 m near it at wall and axis, else 0.8 m."""
    outline = WorkPlane().MoveTo(LENGTHS[0], 0.0)
    for s in LENGTHS[1:]:
        outline.LineTo(s, 0.0)
    for s in reversed(LENGTHS):
        outline.LineTo(s, 2.0)
    face = outline.Close().Face() - Circle((0, 0), 1.0).Face()
    for edge in face.edges:
        s, height = edge.center.x, edge.center.y
        is_near = LENGTHS[1] < s < LENGTHS[2]
        if math.isclose(height, 2):
            edge.name = "top"
        elif abs(height) < 1e-9:
            edge.name = "axis"
            is_near = is_near and s > 0
        elif math.isclose(s, LENGTHS[0]) or math.isclose(s, LENGTHS[-1]):
            edge.name, is_near = "left" if s < 0 else "right", False
        else:
            edge.name, edge.maxh, is_near = "cylinder", 0.07, False
        if is_near:
            edge.maxh = 0.25
    return Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=0.8, grading=0.4)).Curve(3)


def _past_cylinder(mesh: Mesh, wi: float, forces: nv.WallForces) -> nv.Simulation:
    """From rest, of which nothing is left where it goes on from another one."""
    chains, grown = 1 - BETA, 1 - exp(-6 * nv.time)
    rate = -0.75 * y * grown  # of shear in the flow between plates
    B = CF((1 + 2 * (wi * rate) ** 2, wi * rate, 0, wi * rate, 1, 0, 0, 0, 1), dims=(3, 3))
    profile = 1.5 * (1 - y * y / 4) * grown
    return nv.Simulation(
        mesh,
        nv.Model(
            material=nv.OldroydB(K_e=BULK, G_e=chains / (2 * wi)),
            viscosity=nv.StokesViscosity(K_v=0.0, G_v=BETA),
            creep=nv.Creep(G_m=2 * chains, law="conformation"),
        ),
        dt=DT,
        initial=nv.Initial(density=DENSITY),
        walls={
            "left": nv.Inflow(velocity=(profile, 0.0), density=DENSITY, values={"B": B}),
            "right": nv.Open(traction=(2 * chains * wi * rate**2, rate), density=DENSITY),
            ("top", "cylinder"): nv.NoSlip(),
        },
        discretisation=nv.Discretisation(k=3, m=2),
        solver="coupled",
        observers=[forces],
    )


@CASES(f"""oldroyd-b-past-a-cylinder
    The drag of an Oldroyd-B fluid on a cylinder that blocks half of a channel falls with the Weissenberg
      number as is published.
    label: Hulsen, Fattal, Kupferman 2005; Fan, Tanner, Phan-Thien 1999
    setting: Channel 4 m wide from x = {LENGTHS[0]:g} to {LENGTHS[-1]:g} m, half of it, radius and mean
      velocity 1, viscosity 1 Pa s of which the solvent has {BETA:g}, K_e = {BULK:g} Pa, Re = {DENSITY:g}; k =
      3, m = 2, steps of {DT:g} s: 3 s from rest, then six relaxation times.
    - largest relative distance from the published drag <= 0.01: 474 cells; p/K_e = 0.3 %
    - change of the drag in the last step <= 2e-3: steady: six relaxation times
    - least fall of the drag from one to the next >= 0.5: 1.06 to 2.6 N/m are published
    - drag at Wi = 0.6 over the Newtonian one <= 0.9: chains take 11 % off
    - drift
    - closure
    """)
def _cylinder() -> Measured:
    mesh, runs = half_channel(), list[nv.Simulation]()
    rows, curves = list[list[float]](), list[Curve]()
    for wi, published in PUBLISHED.items():
        forces = nv.WallForces(["cylinder"])
        run = _past_cylinder(mesh, wi, forces)
        if runs:
            nv.transfer(runs[-1], run)
        run.run(run.t + DT * math.ceil((6 * wi if runs else 3.0) / DT))
        runs.append(run)
        drag = 2 * forces.column("cylinder.force_1")
        change = abs(drag[-1] - drag[-2]) / published
        limited = run.ledger.column("limited_cells").max()
        rows.append([wi, drag[-1], published, drag[-1] / published - 1, change, limited])
        curves.append(Curve(f"Wi = {wi:g}", forces.column("time"), drag, "."))
    found = [row[1] for row in rows]
    yield "largest relative distance from the published drag", max(abs(row[3]) for row in rows)
    yield "change of the drag in the last step", max(row[4] for row in rows)
    yield "least fall of the drag from one to the next", min(a - b for a, b in pairwise(found))
    yield "drag at Wi = 0.6 over the Newtonian one", found[-1] / NEWTONIAN
    yield Table(
        f"{mesh.ne} cells",
        "Wi | drag, N/m | published | distance | change in the last step | limited cells",
        [[float(np.round(v, 12)) for v in row] for row in rows],
    )
    yield Plot("Drag of an Oldroyd-B fluid on a cylinder", "t, s", "N/m", curves)
    yield "The bounds were written after trials: -0.5 % at Wi = 0.3 (2 s), -0.3 % at 0.5, -0.2 % at 0.6."

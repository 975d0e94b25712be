"""Fluids by a conformation tensor in shear: Oldroyd-B, FENE-P and Leonov against closed forms."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from ngsolve import CF, CoefficientFunction, Mesh, cos, exp, sin, y
from scipy.linalg import expm
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel, structured_box
from ngvisco.physics.flow_rules import CreepLaw
from ngvisco.physics.materials import FENEP
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.cases.shear import sheared
from tests.verification.rates import RateTable
from tests.verification.setups import stokes

CASES = Cases("Exact solutions: rheology")

G_E, LAMBDA = 0.5, 1.0
"""Half the shear modulus, Pa, and relaxation time, s; the viscosity is 2 G_E LAMBDA = 1 Pa s."""
G_M = 4 * G_E * LAMBDA
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


def _steady(name: str) -> Outcome:
    material, law, exact, _ = FLUIDS[name]
    rows, errors, found = [], [0.0, 0.0], []
    for wi in WEISSENBERG:
        run, stress = sheared(material, 0.25, 25.0, rate=wi / LAMBDA, G_m=G_M, law=law)
        T, N = float(stress[-1, 1]), float(stress[-1, 2])
        T_exact, N_exact = exact(wi)
        found.append((T, N))
        errors = [max(errors[0], abs(T / T_exact - 1)), max(errors[1], abs(N / N_exact - 1))]
        rows.append([wi, T, T_exact, N, N_exact, float(run.ledger.column("closure_relative").max())])
    return measured(
        {
            "largest relative error of T_12": errors[0],
            "largest relative error of N_1": errors[1],
        },
        Table("steady stresses, Pa", "Wi | T_12 | exact | N_1 | exact | closure", rows),
        Plot(f"Steady shear, {name}", "Wi", "Pa", _curves(exact, WEISSENBERG, found), log="xy"),
    )


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
def _leonov() -> Outcome:
    """Extrapolated: Pi is trace-free, so that what the start-up's steps lose of det B = 1 stays lost."""
    material, dt, until = nv.OldroydB(K_e=100.0, G_e=G_E), 0.1, 12.0
    rows, errors, rates, found = [], [0.0, 0.0], [], []
    for wi in WEISSENBERG[:3]:
        a, b, c = (
            sheared(material, dt / n, until, rate=wi / LAMBDA, G_m=G_M, law="leonov") for n in (1, 2, 4)
        )
        (A, B, C), exact = (part[1][-1, 1:3] for part in (a, b, c)), np.array(leonov(wi))
        T, N = (8 * C - 6 * B + A) / 3
        errors = [max(errors[0], abs(T / exact[0] - 1)), max(errors[1], abs(N / exact[1] - 1))]
        rates.append(float(np.log2(abs(B - exact) / abs(C - exact)).min()))
        found.append((float(T), float(N)))
        rows.append([wi, float(C[0]), float(T), float(exact[0]), float(N), float(exact[1]), rates[-1]])
    curves = _curves(leonov, WEISSENBERG[:3], found)
    return measured(
        {
            "relative error of T_12, extrapolated": float(errors[0]),
            "relative error of N_1, extrapolated": float(errors[1]),
            "smallest rate in tau": min(rates),
        },
        Table(
            "steady stresses, Pa",
            "Wi | T_12, tau = 0.025 s | extrapolated | exact | N_1 | exact | rate",
            rows,
        ),
        Plot("Steady shear, Leonov", "Wi", "Pa", curves, log="xy"),
    )


def channel_startup(t: np.ndarray, heights: np.ndarray, eta_s: float, modes: int = 40) -> np.ndarray:
    """v(t, y) of an Oldroyd-B fluid of density 1 under a unit force from rest, (times, heights).

    rho v_t = eta_s v_yy + tau_y + 1, lambda tau_t = eta_p v_y - tau (Waters and King 1970), for each sine in
    y an equation for two numbers with constant coefficients, solved by the matrix exponential.
    """
    v = np.zeros((len(t), len(heights)))
    for n in range(1, 2 * modes, 2):
        A, steady = _of_sine(n, eta_s)
        amplitudes = [(steady - expm(A * s) @ steady)[0] for s in t]
        v += np.outer(amplitudes, np.sin(n * np.pi * heights))
    return v


def startup_velocity(eta_s: float, modes: int = 8) -> CoefficientFunction:
    """The same as a function of y and ``ngvisco.time``, by the eigenvectors of each sine's equation."""
    v = CF(0.0)
    for n in range(1, 2 * modes, 2):
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
    k, eta_p = n * np.pi, 2 * G_E * LAMBDA
    A = np.array([[-eta_s * k * k, -k], [eta_p * k / LAMBDA, -1 / LAMBDA]])
    return A, np.linalg.solve(A, [-4 / (n * np.pi), 0.0])


def _periodic(eta_s: float) -> tuple[Mesh, Conditions]:
    return channel(0.3, 1.0, maxh=0.15), {}


def _in_and_out(eta_s: float) -> tuple[Mesh, Conditions]:
    """With an inlet that moves as the series says, by a fluid at rest before it, and an outlet."""
    inlet = nv.Inflow(velocity=(startup_velocity(eta_s), 0.0), density=1.0)
    return structured_box((2.0, 1.0), (12, 7)), {"left": inlet, "right": nv.Open(density=1.0)}


def _waters_king(domain: Callable[[float], tuple[Mesh, Conditions]], place: float) -> Outcome:
    """The velocity across the channel at x = ``place``."""
    eta_s, until = 0.1, 4.0
    heights = np.linspace(0.05, 0.95, 19)
    table, curves = RateTable("largest error of the velocity, relative to the steady maximum"), []
    found = []
    largest = 1 / (8 * (eta_s + 2 * G_E * LAMBDA))
    for steps in (40, 80, 160):
        model = nv.Model(
            material=nv.OldroydB(K_e=200.0, G_e=G_E),
            viscosity=stokes(eta_s),
            creep=nv.Creep(G_m=G_M, law="conformation"),
            loads=(nv.BodyForce((1.0, 0.0)),),
        )
        mesh, ends = domain(eta_s)
        walls = {"bottom": nv.NoSlip(), "top": nv.NoSlip(), **dict(ends)}
        orders = nv.Discretisation(k=2, m=1)
        run = nv.Simulation(mesh, model, dt=until / steps, walls=walls, discretisation=orders)
        rows = []
        for _ in range(steps):
            run.advance()
            rows.append(run.fields["velocity"](mesh(0 * heights + place, heights))[:, 0])
        t = run.dt * np.arange(1, steps + 1)
        exact = channel_startup(t, heights, eta_s)
        found.append(np.array(rows))
        table.add(run.dt, v=float(np.abs(np.array(rows) - exact).max() / largest))
        curves.append(Curve(f"{steps} steps", t, found[-1][:, 9], "."))
    extrapolated = (8 * found[2][3::4] - 6 * found[1][1::2] + found[0]) / 3
    curves.append(Curve("series", t, exact[:, 9], "k-"))
    return measured(
        {
            "rate in tau": table.last("v"),
            "error, extrapolated": float(np.abs(extrapolated - exact[3::4]).max() / largest),
            "overshoot of the exact solution": float(exact[:, 9].max() / exact[-1, 9]),
        },
        table.table("tau, s"),
        Plot("Start-up of channel flow, Oldroyd-B", "t, s", "v in the middle, m/s", curves),
    )


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

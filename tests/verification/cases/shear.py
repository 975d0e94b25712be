"""Homogeneous simple shear against closed forms."""

import math

import numpy as np
from ngsolve import Mesh, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import channel
from ngvisco.physics.flow_rules import CreepLaw
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.rates import RateTable
from tests.verification.setups import stokes

CASES = Cases("Exact solutions: shear and relaxation")

G, ETA, RATE = 100.0, 100.0, 0.3
TABLE = {
    0.01: (0.298505, 0.000447),
    0.02: (0.594036, 0.001776),
    0.1: (2.854460, 0.042106),
    0.25: (6.630142, 0.238383),
    0.5: (11.765275, 0.810418),
    1.0: (18.747691, 2.362833),
    2.0: (25.079664, 5.231418),
}
"""t, s: (tau_12, tau_11), Pa; shared/reference/benchmarks.md, after Farrington et al. 2014."""


def sheared(
    material: nv.Material,
    dt: float,
    until: float,
    *,
    rate: float,
    G_m: float | None = None,
    creep: nv.FlowRule | None = None,
    viscosity: float = 0.0,
    density: float = 1.0,
    mesh: Mesh | None = None,
    scheme: str = "backward-euler",
    law: CreepLaw = "mandel",
) -> tuple[nv.Simulation, np.ndarray]:
    """A channel of 1 m x 1 m between a resting wall and one that slides at ``rate``.

    Returns the run and rows (t, T_12, T_11 - T_22, T_11 - tr T/3) of the Cauchy stress's elastic part
    (of conjugates; E itself for the linearised model, whose T has the quadratic term phi I).
    """
    model = nv.Model(
        material=material,
        creep=creep if G_m is None else nv.Creep(G_m=G_m, law=law),
        viscosity=stokes(viscosity) if viscosity else None,
    )
    walls: Conditions = {"top": nv.PrescribedTangential((rate, 0.0)), "bottom": nv.NoSlip()}
    initial = nv.Initial(velocity=(rate * y, 0), density=density)
    run = nv.Simulation(
        mesh or channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=initial, scheme=scheme
    )
    rows = [(0.0, 0.0, 0.0, 0.0)]
    while run.t < until - dt / 2:
        run.advance()
        rows.append((run.t, *stresses(run)))
    return run, np.array(rows)


def stresses(run: nv.Simulation) -> tuple[float, float, float]:
    """T_12, T_11 - T_22, T_11 - tr T/3 at a point."""
    T = np.reshape(run.fields["cauchy_stress"](run.mesh(0.4, 0.4)), (3, 3))
    return float(T[0, 1]), float(T[0, 0] - T[1, 1]), float(T[0, 0] - np.trace(T) / 3)


@CASES("""jaumann-shear
    The stresses of a Zaremba–Jaumann Maxwell fluid in simple shear are those of the closed form.
    label: ZJ, Euler-small-flow-rule; Farrington et al. 2014
    setting: Channel between a resting and a sliding wall (0.3 m/s), mu = eta = 100; extrapolated twice from
      steps 0.01 s (t <= 0.1 s) and 0.125 s and their halves and quarters.
    - largest relative error of tau_12 <= 1e-3: ASPECT documents 0.9 to 2 %
    - largest relative error of tau_11 <= 2e-3: ASPECT documents 0.9 to 2 %
    - closure
    """)
def _jaumann() -> Outcome:
    material = nv.LinearElastic(K_e=2 * G, G_e=G)
    rows, largest = [], [0.0, 0.0]
    for dt, times in ((0.01, (0.01, 0.02, 0.1)), (0.125, (0.25, 0.5, 1.0, 2.0))):
        runs = [sheared(material, dt / n, times[-1], rate=RATE, G_m=2 * ETA) for n in (1, 2, 4)]
        a, b, c = (values for _, values in runs)
        curve = (8 * c[::4] - 6 * b[::2] + a) / 3
        for t in times:
            tau_12, tau_11 = curve[round(t / dt)][[1, 3]]
            exact = TABLE[t]
            errors = abs(tau_12 / exact[0] - 1), abs(tau_11 / exact[1] - 1)
            largest = [max(pair) for pair in zip(largest, errors, strict=True)]
            rows.append([t, tau_12, exact[0], errors[0], tau_11, exact[1], errors[1]])
    fine = np.linspace(0, 2, 100)
    r, decay, scale = RATE, np.exp(-fine), RATE * ETA / (1 + RATE**2)
    curve_12 = scale * (1 - decay * (np.cos(r * fine) - r * np.sin(r * fine)))
    curve_11 = scale * (r - decay * (r * np.cos(r * fine) + np.sin(r * fine)))
    marks = np.array(rows).T
    return measured(
        {
            "largest relative error of tau_12": largest[0],
            "largest relative error of tau_11": largest[1],
        },
        Table("stresses, Pa", "t, s | tau_12 | table | error | tau_11 | table | error", rows),
        Plot(
            "Zaremba–Jaumann Maxwell fluid in simple shear",
            "t, s",
            "Pa",
            [
                Curve("tau_12, exact", fine, curve_12, "-"),
                Curve("tau_11, exact", fine, curve_11, "-"),
                Curve("tau_12", marks[0], marks[1], "o"),
                Curve("tau_11", marks[0], marks[4], "s"),
            ],
        ),
    )


@CASES("""jaumann-start-up
    Start-up shear of a Zaremba–Jaumann Maxwell fluid at W = lambda rate = 5, turned by five radians, is eta
      rate/(1 + W²) [1 − exp(−t/lambda) (cos rate t − W sin rate t)].
    label: ZJ, Euler-small-flow-rule
    setting: Channel with a sliding wall, 5 m/s, G = 20 Pa, eta = 20 Pa s, until 2 s by the midpoint rule, 50,
      100 and 200 steps; with a viscosity of 20 Pa s, without which the flow is unstable where its stress
      falls with the rate.
    - rate of sigma_12 >= 1.9: midpoint rule
    - rate of sigma_11 >= 1.9: midpoint rule
    - largest error of sigma_12 <= 8.2e-4: twice (|a| tau)² |a| lambda/(12 e)
    - largest error of sigma_11 <= 8.2e-4: twice (|a| tau)² |a| lambda/(12 e)
    - distance to the law without spin >= 1.0: negative control
    - closure
    """)
def _start_up() -> Outcome:
    """Errors are over the viscous stress eta rate/sqrt(1 + W^2) that the oscillation is about."""
    modulus, relaxation, rate, until = 20.0, 1.0, 5.0, 2.0
    viscosity, W = modulus * relaxation, rate * relaxation
    scale = viscosity * rate / (1 + W**2)

    def exact(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay, angle = np.exp(-t / relaxation), rate * t
        sigma_12 = scale * (1 - decay * (np.cos(angle) - W * np.sin(angle)))
        return sigma_12, scale * (W - decay * (W * np.cos(angle) + np.sin(angle)))

    table = RateTable("largest error over the time, relative to eta rate/sqrt(1 + W²)")
    for steps in (50, 100, 200):
        material = nv.LinearElastic(K_e=2 * modulus, G_e=modulus)
        _, rows = sheared(
            material,
            until / steps,
            until,
            rate=rate,
            G_m=2 * viscosity,
            viscosity=viscosity,
            scheme="midpoint",
            mesh=channel(1, 1, maxh=1.0),
        )
        t, unit = rows[:, 0], scale * math.sqrt(1 + W**2)
        sigma_12, sigma_11 = exact(t)
        error_12 = np.abs(rows[:, 1] - sigma_12).max() / unit
        error_11 = np.abs(rows[:, 3] - sigma_11).max() / unit
        table.add(until / steps, sigma_12=float(error_12), sigma_11=float(error_11))
    unturned = viscosity * rate * (1 - np.exp(-t / relaxation))
    return measured(
        {
            "rate of sigma_12": table.last("sigma_12"),
            "rate of sigma_11": table.last("sigma_11"),
            "largest error of sigma_12": table.errors["sigma_12"][-1],
            "largest error of sigma_11": table.errors["sigma_11"][-1],
            "distance to the law without spin": float(np.abs(rows[:, 1] - unturned).max() / unit),
        },
        table.table("tau, s"),
        Plot(
            "Zaremba–Jaumann start-up shear, W = 5",
            "t, s",
            "Pa",
            [
                Curve("sigma_12, exact", t, sigma_12, "k-"),
                Curve("sigma_12", t, rows[:, 1], "."),
                Curve("sigma_11, exact", t, sigma_11, "k--"),
                Curve("sigma_11", t, rows[:, 3], "."),
            ],
        ),
        "The error of the midpoint rule for exp(a t), a = (−1 + iW)/lambda, is (|a| tau)²/12 times "
        "|a| t exp(−t/lambda), at most |a| lambda/e: 4.1e-4 with 200 steps; bounds are twice that.",
    )


@CASES("""neo-hookean-shear (reduced)
    A neo-Hookean body in simple shear has T_12 = 2 G_e gamma and T_11 − T_22 = 2 G_e gamma².
    label: neo-Hookean-potential-actual, ED-Euler-large2
    setting: Channel with a sliding wall, 1 m/s, G_e = 0.7 Pa, 20 steps of 0.1 s up to gamma = 2.
    - largest relative error of T_12 <= 1e-8: exact for any step
    - largest relative error of T_11 - T_22 <= 1e-8: exact for any step
    - closure
    """)
def _neo_hookean() -> Outcome:
    material = nv.NeoHookean(K_e=3.0, G_e=0.7, epsilon=0.2)
    _, rows = sheared(material, 0.1, 2.0, rate=1.0, viscosity=0.1)
    gamma = rows[1:, 0]
    error_12 = np.abs(rows[1:, 1] / (1.4 * gamma) - 1).max()
    error_n = np.abs(rows[1:, 2] / (1.4 * gamma**2) - 1).max()
    curves = [
        Curve("T_12", gamma, rows[1:, 1], "o"),
        Curve("2 G gamma", gamma, 1.4 * gamma, "k-"),
        Curve("T_11 - T_22", gamma, rows[1:, 2], "s"),
        Curve("2 G gamma²", gamma, 1.4 * gamma * gamma, "k--"),
    ]
    return measured(
        {
            "largest relative error of T_12": float(error_12),
            "largest relative error of T_11 - T_22": float(error_n),
        },
        Plot("Neo-Hookean simple shear", "gamma", "Pa", curves),
        "The implicit step is exact here: L is nilpotent, so (I − tau L)⁻¹ = I + tau L.",
    )

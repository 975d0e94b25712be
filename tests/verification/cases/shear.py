"""A Maxwell body: relaxation and oscillatory shear; homogeneous simple shear against closed forms."""

import math

import numpy as np
from ngsolve import CF, Mesh, cos, sin, y
from ngsolve import pi as PI

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.forms.context import time
from ngvisco.geometries import box, channel
from ngvisco.physics.flow_rules import CreepLaw
from tests.verification.case import Cases, Curve, Measured, Plot, Table
from tests.verification.rates import RateTable, extrapolated
from tests.verification.setups import followed, stokes

CASES = Cases("Exact solutions: shear and relaxation")

# --- a Maxwell body ------------------------------------------------------------------------------------

MYR = 1e6 * 365.25 * 24 * 3600
ROCK = {"G": 1e10, "eta": 1e22, "tau_0": 20e6, "duration": 0.25 * MYR, "size": 100e3, "rho": 3300.0}


def relaxed_stress(
    G: float, eta: float, tau_0: float, duration: float, steps: int, size: float, rho: float
) -> tuple[list[float], nv.Simulation]:
    """dev S_11 after every step in a box with slip, v = 0, from the uniform deviator diag(1, -1, 0) tau_0."""
    E_0 = CF((1, 0, 0, 0, -1, 0, 0, 0, 0), dims=(3, 3)) * (tau_0 / (2 * G))
    model = nv.Model(
        material=nv.LinearElastic(K_e=2 * G, G_e=G),
        viscosity=nv.StokesViscosity(K_v=0.1 * eta, G_v=0.1 * eta),
        creep=nv.Creep(G_m=2 * eta),
    )
    initial = nv.Initial(density=rho, values={"E": E_0})
    run = nv.Simulation(box((size, size), 0.6 * size), model, dt=duration / steps, initial=initial)
    _, E_11 = followed(run, steps, lambda run: run.fields["E"](run.mesh(0.2 * size, 0.3 * size))[0])
    return list(2 * G * E_11[1:]), run


@CASES("""maxwell-relaxation (reduced)
    A Maxwell body's uniform stress relaxes as tau_0 exp(−G t/eta): 20 MPa fall to 7.49 kPa in 250 kyr.
    label: Euler-small-viscoelastodyn+2; ASPECT viscoelastic_relaxation
    setting: Box of 100 km with slip, v = 0, G = 1e10 Pa, eta = 1e22 Pa s (R = 1/(2 eta)); 64, 128, 256 steps.
    - exact stress at 250 kyr, Pa <= 7.5e3: the reference's 7.49 kPa
    - deviation from the implicit Euler formula <= 1e-9: solver tolerance
    - rate in tau >= 0.9: implicit Euler
    - relative error at 250 kyr, extrapolated <= 0.01: two extrapolations
    """)
def _relaxation() -> Measured:
    exact = ROCK["tau_0"] * math.exp(-ROCK["G"] * ROCK["duration"] / ROCK["eta"])
    errors, curves, formula = [], [], 0.0
    counts = [64, 128, 256]
    for steps in counts:
        stresses, _ = relaxed_stress(**ROCK, steps=steps)
        decay = 1 / (1 + ROCK["duration"] / steps * ROCK["G"] / ROCK["eta"])
        discrete = ROCK["tau_0"] * decay ** np.arange(1, steps + 1)
        formula = max(formula, float(np.abs(np.array(stresses) / discrete - 1).max()))
        errors.append(abs(stresses[-1] - exact) / exact)
        years = [1e3 * 250 * (i + 1) / steps for i in range(steps)]
        curves.append(Curve(f"{steps} steps", years, stresses, "-"))
    table = RateTable("relative error of the stress at 250 kyr", [1 / n for n in counts], {"stress": errors})
    curves.append(Curve("exact", [0.0, 250e3], [ROCK["tau_0"], exact], "k--"))
    yield "exact stress at 250 kyr, Pa", exact
    yield "deviation from the implicit Euler formula", formula
    yield "rate in tau", table.last("stress")
    yield "relative error at 250 kyr, extrapolated", abs(extrapolated(*errors))
    yield table.table("tau / 250 kyr")
    yield Plot("Stress relaxation of a Maxwell body", "years", "Pa", curves, log="y")


AMPLITUDE, OMEGA = 1e-3, PI / 2


def oscillating(steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shear rate AMPLITUDE sin(omega t); the body force keeps v linear in y, as without inertia.

    Returns times, T_12 over eta times AMPLITUDE and the closed form of it.
    """
    material = nv.LinearElastic(K_e=2.0, G_e=1.0)
    force = AMPLITUDE * OMEGA * cos(OMEGA * time) * y
    model = nv.Model(material=material, creep=nv.Creep(G_m=2.0), loads=(nv.Gravity((force, 0.0)),))
    wall = nv.PrescribedTangential((AMPLITUDE * sin(OMEGA * time), 0.0))
    run = nv.Simulation(
        channel(1, 1, maxh=0.5), model, dt=8 / steps, walls={"top": wall, "bottom": nv.NoSlip()}
    )
    t, found = (values[1:] for values in followed(run, steps, lambda run: stresses(run)[0] / AMPLITUDE))
    exact = (np.sin(OMEGA * t) - OMEGA * np.cos(OMEGA * t) + OMEGA * np.exp(-t)) / (1 + OMEGA**2)
    return t, found, exact


@CASES("""oscillatory-shear
    Oscillatory shear of a Maxwell material at De = pi/2 follows the closed form.
    label: Euler-small-viscoelastodyn+2; Underworld3
    setting: eta = mu = 1, omega = pi/2, shear rate 1e-3 sin(omega t) (small, so that the spin has no part),
      with a body force that takes inertia away; two periods; 40, 80, 160 steps.
    - rate in tau >= 0.9: implicit Euler
    - error, extrapolated <= 2e-3: two extrapolations
    - closure
    """)
def _oscillation() -> Measured:
    table, curves = RateTable("largest error, relative to eta gamma_0"), []
    for steps in (40, 80, 160):
        t, found, exact = oscillating(steps)
        table.add(8 / steps, tau_12=float(np.abs(found - exact).max()))
        curves.append(Curve(f"{steps} steps", t, found, "."))
    curves.append(Curve("exact", t, exact, "k-"))
    yield "rate in tau", table.last("tau_12")
    yield "error, extrapolated", abs(extrapolated(*table.errors["tau_12"]))
    yield table.table("tau, s")
    yield Plot("Oscillatory shear of a Maxwell material", "t, s", "stress / (eta gamma_0)", curves)


# --- simple shear --------------------------------------------------------------------------------------

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
    initial = nv.Initial(velocity=(rate * y, 0), density=1.0)
    run = nv.Simulation(
        mesh or channel(1, 1, maxh=0.5), model, dt=dt, walls=walls, initial=initial, scheme=scheme
    )
    t, found = followed(run, round(until / dt), stresses)
    return run, np.column_stack([t, found])


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
def _jaumann() -> Measured:
    material = nv.LinearElastic(K_e=2 * G, G_e=G)
    rows, largest = [], [0.0, 0.0]
    for dt, times in ((0.01, (0.01, 0.02, 0.1)), (0.125, (0.25, 0.5, 1.0, 2.0))):
        runs = [sheared(material, dt / n, times[-1], rate=RATE, G_m=2 * ETA) for n in (1, 2, 4)]
        curve = extrapolated(*(values[:: 2**n] for n, (_, values) in enumerate(runs)))
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
    yield "largest relative error of tau_12", largest[0]
    yield "largest relative error of tau_11", largest[1]
    yield Table("stresses, Pa", "t, s | tau_12 | table | error | tau_11 | table | error", rows)
    yield Plot(
        "Zaremba–Jaumann Maxwell fluid in simple shear",
        "t, s",
        "Pa",
        [
            Curve("tau_12, exact", fine, curve_12, "-"),
            Curve("tau_11, exact", fine, curve_11, "-"),
            Curve("tau_12", marks[0], marks[1], "o"),
            Curve("tau_11", marks[0], marks[4], "s"),
        ],
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
def _start_up() -> Measured:
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
    yield "rate of sigma_12", table.last("sigma_12")
    yield "rate of sigma_11", table.last("sigma_11")
    yield "largest error of sigma_12", table.errors["sigma_12"][-1]
    yield "largest error of sigma_11", table.errors["sigma_11"][-1]
    yield "distance to the law without spin", np.abs(rows[:, 1] - unturned).max() / unit
    yield table.table("tau, s")
    yield Plot(
        "Zaremba–Jaumann start-up shear, W = 5",
        "t, s",
        "Pa",
        [
            Curve("sigma_12, exact", t, sigma_12, "k-"),
            Curve("sigma_12", t, rows[:, 1], "."),
            Curve("sigma_11, exact", t, sigma_11, "k--"),
            Curve("sigma_11", t, rows[:, 3], "."),
        ],
    )
    yield (
        "The error of the midpoint rule for exp(a t), a = (−1 + iW)/lambda, is (|a| tau)²/12 times "
        "|a| t exp(−t/lambda), at most |a| lambda/e: 4.1e-4 with 200 steps; bounds are twice that."
    )


@CASES("""neo-hookean-shear (reduced)
    A neo-Hookean body in simple shear has T_12 = 2 G_e gamma and T_11 − T_22 = 2 G_e gamma².
    label: neo-Hookean-potential-actual, ED-Euler-large2
    setting: Channel with a sliding wall, 1 m/s, G_e = 0.7 Pa, 20 steps of 0.1 s up to gamma = 2.
    - largest relative error of T_12 <= 1e-8: exact for any step
    - largest relative error of T_11 - T_22 <= 1e-8: exact for any step
    - closure
    """)
def _neo_hookean() -> Measured:
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
    yield "largest relative error of T_12", error_12
    yield "largest relative error of T_11 - T_22", error_n
    yield Plot("Neo-Hookean simple shear", "gamma", "Pa", curves)
    yield "The implicit step is exact here: L is nilpotent, so (I − tau L)⁻¹ = I + tau L."

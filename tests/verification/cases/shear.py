"""Shear against closed forms: relaxation and oscillation of a Maxwell body, simple shear."""

import math
from typing import Any

import numpy as np
from ngsolve import CF, Mesh, cos, sin, y
from ngsolve import pi as PI

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.forms.context import time
from ngvisco.geometries import box, channel
from ngvisco.physics.flow_rules.laws import CreepLaw
from tests.verification.case import Cases, Curve, Measured, Plot, RateTable, Table, extrapolated
from tests.verification.setups import followed, stokes

CASES = Cases("Exact solutions: shear and relaxation")

# --- a Maxwell body ------------------------------------------------------------------------------------

MYR = 1e6 * 365.25 * 24 * 3600
SHEAR, ETA_ROCK, TAU_0, UNTIL, SIDE = 1e10, 1e22, 20e6, 0.25 * MYR, 100e3
"""Shear modulus, Pa; viscosity, Pa s; initial stress, Pa; end, s; side of the box, m."""


@CASES("""maxwell-relaxation (reduced)
    A Maxwell body's uniform stress relaxes as tau_0 exp(−G t/eta): 20 MPa fall to 7.49 kPa in 250 kyr.
    label: Euler-small-viscoelastodyn+2; ASPECT viscoelastic_relaxation
    setting: Box of 100 km with slip, v = 0, G = 1e10 Pa, eta = 1e22 Pa s (R = 1/(2 eta)); 64, 128, 256 steps.
    - exact stress at 250 kyr, Pa in [7485, 7495]: the reference's 7.49 kPa
    - deviation from the implicit Euler formula <= 1e-9: solver tolerance
    - rate in tau >= 0.9: implicit Euler
    - relative error at 250 kyr, extrapolated <= 0.01: two extrapolations
    """)
def _relaxation() -> Measured:
    """Measure dev S_11 after every step, starting from the uniform deviator diag(1, -1, 0) tau_0."""
    exact, formula = TAU_0 * math.exp(-SHEAR * UNTIL / ETA_ROCK), 0.0
    E = CF((1, 0, 0, 0, -1, 0, 0, 0, 0), dims=(3, 3)) * (TAU_0 / (2 * SHEAR))
    table = RateTable("relative error of the stress at 250 kyr", "tau / 250 kyr")
    for steps in (64, 128, 256):
        model = nv.Model(
            material=nv.LinearElastic(K_e=2 * SHEAR, G_e=SHEAR),
            viscosity=stokes(0.1 * ETA_ROCK),
            creep=nv.Creep(G_m=2 * ETA_ROCK),
        )
        initial = nv.Initial(density=3300.0, values={"E": E})
        run = nv.Simulation(box((SIDE, SIDE), 0.6 * SIDE), model, dt=UNTIL / steps, initial=initial)
        _, E_11 = followed(run, steps, lambda run: run.fields["E"](run.mesh(0.2 * SIDE, 0.3 * SIDE))[0])
        stresses, decay = 2 * SHEAR * E_11[1:], 1 / (1 + UNTIL / steps * SHEAR / ETA_ROCK)
        discrete = TAU_0 * decay ** np.arange(1, steps + 1)
        formula = max(formula, float(np.abs(stresses / discrete - 1).max()))
        table.add(1 / steps, stress=abs(stresses[-1] - exact) / exact)
    yield "exact stress at 250 kyr, Pa", exact
    yield "deviation from the implicit Euler formula", formula
    yield "rate in tau", table.last("stress")
    yield "relative error at 250 kyr, extrapolated", abs(extrapolated(*table.errors["stress"]))
    yield table


AMPLITUDE, OMEGA = 1e-3, PI / 2


@CASES("""oscillatory-shear
    Oscillatory shear of a Maxwell material at De = pi/2 follows the closed form.
    label: Euler-small-viscoelastodyn+2; Underworld3
    setting: eta = mu = 1, omega = pi/2, shear rate 1e-3 sin(omega t) (small, so that the spin does not
      matter),
      with a body force that cancels inertia; two periods; 40, 80, 160 steps.
    - rate in tau >= 0.9: implicit Euler
    - error, extrapolated <= 2e-3: two extrapolations
    - closure
    """)
def _oscillation() -> Measured:
    table, curves = RateTable("largest error, relative to eta gamma_0", "tau, s"), []
    for steps in (40, 80, 160):
        force = AMPLITUDE * OMEGA * cos(OMEGA * time) * y
        wall = nv.PrescribedTangential((AMPLITUDE * sin(OMEGA * time), 0.0))
        run = nv.Simulation(
            channel(1, 1, maxh=0.5),
            nv.Model(
                material=nv.LinearElastic(K_e=2.0, G_e=1.0),
                creep=nv.Creep(G_m=2.0),
                loads=(nv.Gravity((force, 0.0)),),
            ),
            dt=8 / steps,
            walls={"top": wall, "bottom": nv.NoSlip()},
        )
        t, found = (values[1:] for values in followed(run, steps, lambda run: stresses(run)[0] / AMPLITUDE))
        exact = (np.sin(OMEGA * t) - OMEGA * np.cos(OMEGA * t) + OMEGA * np.exp(-t)) / (1 + OMEGA**2)
        table.add(8 / steps, tau_12=float(np.abs(found - exact).max()))
        curves.append(Curve(f"{steps} steps", t, found, "."))
    curves.append(Curve("exact", t, exact, "k-"))
    yield "rate in tau", table.last("tau_12")
    yield "error, extrapolated", abs(extrapolated(*table.errors["tau_12"]))
    yield table.table()
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
"""The stresses (tau_12, tau_11), Pa, by the time, s, from Farrington et al. 2014."""


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
    """Run a channel of 1 m x 1 m between a resting wall and a wall that slides at ``rate``.

    Returns the run, and rows of the time and ``stresses``."""
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
    """Return T_12, T_11 - T_22, T_11 - tr T/3 of the elastic Cauchy stress at a point."""
    T = np.reshape(run.fields["cauchy_stress"](run.mesh(0.4, 0.4)), (3, 3))
    return float(T[0, 1]), float(T[0, 0] - T[1, 1]), float(T[0, 0] - np.trace(T) / 3)


@CASES("""jaumann-shear
    The stresses of a Zaremba–Jaumann Maxwell fluid in simple shear follow the closed form.
    label: ZJ, Euler-small-flow-rule; Farrington et al. 2014
    setting: Channel between a resting and a sliding wall (0.3 m/s), mu = eta = 100; extrapolated twice from
      steps 0.01 s (t <= 0.1 s) and 0.125 s and their halves and quarters.
    - largest relative error of tau_12 <= 1e-3: ASPECT documents 0.9 to 2 %
    - largest relative error of tau_11 <= 2e-3: ASPECT documents 0.9 to 2 %
    - closure
    """)
def _jaumann() -> Measured:
    rows = []
    for dt, times in ((0.01, (0.01, 0.02, 0.1)), (0.125, (0.25, 0.5, 1.0, 2.0))):
        material = nv.LinearElastic(K_e=2 * G, G_e=G)
        runs = [sheared(material, dt / n, times[-1], rate=RATE, G_m=2 * ETA)[1] for n in (1, 2, 4)]
        curve = extrapolated(*(values[:: 2**n] for n, values in enumerate(runs)))
        for t in times:
            (tau_12, tau_11), (of_12, of_11) = curve[round(t / dt)][[1, 3]], TABLE[t]
            rows.append([t, tau_12, of_12, abs(tau_12 / of_12 - 1), tau_11, of_11, abs(tau_11 / of_11 - 1)])
    yield "largest relative error of tau_12", max(row[3] for row in rows)
    yield "largest relative error of tau_11", max(row[6] for row in rows)
    head = "t, s | tau_12 | exact tau_12 | error | tau_11 | exact tau_11 | error"
    yield from Table("stresses, Pa", head, rows).drawn(0, 1, 2, 4, 5)


@CASES("""neo-hookean-shear (reduced)
    A neo-Hookean body in simple shear has T_12 = 2 G_e gamma and T_11 − T_22 = 2 G_e gamma².
    label: neo-Hookean-potential-actual, ED-Euler-large2
    setting: Channel with a sliding wall, 1 m/s, G_e = 0.7 Pa, 20 steps of 0.1 s up to gamma = 2.
    - largest relative error of T_12 <= 1e-8: exact for any step, since L is nilpotent
    - largest relative error of T_11 - T_22 <= 1e-8: the same
    - closure
    """)
def _neo_hookean() -> Measured:
    _, rows = sheared(nv.NeoHookean(K_e=3.0, G_e=0.7, epsilon=0.2), 0.1, 2.0, rate=1.0, viscosity=0.1)
    gamma, T_12, N_1 = rows[1:, :3].T
    yield "largest relative error of T_12", np.abs(T_12 / (1.4 * gamma) - 1).max()
    yield "largest relative error of T_11 - T_22", np.abs(N_1 / (1.4 * gamma**2) - 1).max()
    rows, head = np.array([gamma, T_12, N_1, 1.4 * gamma, 1.4 * gamma**2]).T, "gamma | T_12 | T_11 - T_22"
    yield from Table("stresses, Pa", head + " | 2 G_e gamma | 2 G_e gamma²", rows).drawn(0, 1, 2, 3, 4)


@CASES("""jaumann-start-up
    The start-up stress of a sheared Zaremba–Jaumann Maxwell fluid at W = lambda rate = 5, turned by five
      radians, is eta rate/(1 + W²) [1 − exp(−t/lambda) (cos rate t − W sin rate t)].
    label: ZJ, Euler-small-flow-rule
    setting: Channel with a sliding wall, 5 m/s, G = 20 Pa, eta = 20 Pa s, until 2 s by the midpoint rule, 50,
      100 and 200 steps; with a viscosity of 20 Pa s, without which the flow is unstable where its stress
      falls with the rate.
    - rate of [sigma_12; sigma_11] >= 1.9: midpoint rule
    - largest error of [sigma_12; sigma_11] <= 8.2e-4: twice (|a| tau)² |a| lambda/(12 e)
    - distance to the law without spin >= 1.0: negative control
    - closure
    """)
def _start_up() -> Measured:
    """Measure errors relative to the viscous stress eta rate/sqrt(1 + W^2), about which the stress
    oscillates.

    The midpoint rule's error for exp(a t), a = (-1 + iW)/lambda, is (|a| tau)^2/12 times |a| t
    exp(-t/lambda)."""
    modulus, rate, until = 20.0, 5.0, 2.0
    size = modulus * rate / math.sqrt(1 + rate**2)
    table = RateTable("largest error over the time, relative to eta rate/sqrt(1 + W²)", "tau, s")
    for steps in (50, 100, 200):
        material, mesh = nv.LinearElastic(K_e=2 * modulus, G_e=modulus), channel(1, 1, maxh=1.0)
        options: Any = {"G_m": 2 * modulus, "viscosity": modulus, "scheme": "midpoint", "mesh": mesh}
        t, found, _, along = sheared(material, until / steps, until, rate=rate, **options)[1].T
        decay, scale = np.exp(-t), size / math.sqrt(1 + rate**2)
        sigma_12 = scale * (1 - decay * (np.cos(rate * t) - rate * np.sin(rate * t)))
        sigma_11 = scale * (rate - decay * (rate * np.cos(rate * t) + np.sin(rate * t)))
        errors = np.abs([found - sigma_12, along - sigma_11]).max(axis=1) / size
        table.add(until / steps, sigma_12=errors[0], sigma_11=errors[1])
    yield from table.lasts()
    yield from ((f"largest error of {name}", errors[-1]) for name, errors in table.errors.items())
    unturned = np.abs(found - modulus * rate * (1 - np.exp(-t))).max() / size
    yield "distance to the law without spin", unturned
    yield table.table()
    curves = [Curve("sigma_12, exact", t, sigma_12, "k-"), Curve("sigma_12", t, found, ".")]
    yield Plot("Zaremba–Jaumann start-up shear, W = 5", "t, s", "Pa", curves)

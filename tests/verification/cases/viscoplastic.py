"""Steady flows of viscoplastic fluids between walls against their closed profiles, and Norton's creep.

The fluid is an elastoviscoplastic one: Bingham's flow rule (``Perzyna``, n = 1) in a stiff elastic body,
no viscosity of the state.  What is elastic is of the size of stress/G.
"""

import math
from functools import partial

import numpy as np
from ngsolve import x, y

import ngvisco as nv
from ngvisco.forms.boundary.walls import Conditions
from ngvisco.geometries import annulus, channel
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.cases.rheology import BY_B, NAMES
from tests.verification.rates import RateTable
from tests.verification.setups import around, elastic

CASES = Cases("Exact solutions: flow rules")

TAU_Y, ETA, G = 0.2, 0.1, 100.0
"""Yield stress in shear, Pa, plastic viscosity, Pa s, modulus of shear, Pa."""
KINDS = ("linearised", BY_B)


def bingham(kind: str, loads: tuple[nv.BodyForce, ...] = ()) -> nv.Model:
    rule = nv.Perzyna(sigma_Y=math.sqrt(3) * TAU_Y, G_m=2 * ETA)
    return nv.Model(material=elastic(kind, 2 * G, G), creep=rule, loads=loads)


# --- between plates, driven by a force along them -------------------------------------------------------

FORCE = 1.0
"""N/m^3."""


def profile(y: np.ndarray, tau_Y: float) -> np.ndarray:
    """v_1 over 0 <= y <= 1: a plug where the shear stress FORCE (1/2 - y) is below tau_Y."""
    sheared = 0.5 - tau_Y / FORCE
    near = np.minimum(np.minimum(y, 1 - y), sheared)
    return FORCE / (2 * ETA) * near * (2 * sheared - near)


def _channel(kind: str) -> Outcome:
    at = np.linspace(0, 1, 81)
    exact, fastest = profile(at, TAU_Y), float(profile(at, TAU_Y).max())
    table, curves = RateTable("errors, relative to the largest of v and of the stress"), []
    for h in (0.25, 0.125, 0.0625):
        run = nv.Simulation(
            channel(0.25, 1, maxh=h),
            bingham(kind, (nv.BodyForce((FORCE, 0)),)),
            dt=0.1,
            walls={"top": nv.NoSlip(), "bottom": nv.NoSlip()},
            initial=nv.Initial(density=0.01),
        )
        run.run(2.0)
        points = run.mesh(0.1 + 0 * at, at)
        v = run.fields["velocity"](points)[:, 0]
        T_12 = run.fields["cauchy_stress"](points)[:, 1]
        error = float(np.sqrt(np.mean((v - exact) ** 2))) / fastest
        stress = float(np.sqrt(np.mean((T_12 - FORCE * (0.5 - at)) ** 2))) / (0.5 * FORCE)
        table.add(h, v=error, T_12=stress)
        curves.append(Curve(f"h = {h:g} m", at, v, "."))
    curves.append(Curve("closed form", at, exact, "k-"))
    stronger = float(np.sqrt(np.mean((v - profile(at, 1.1 * TAU_Y)) ** 2))) / fastest
    return measured(
        {
            "error of v on the finest mesh": table.errors["v"][-1],
            "error of T_12 on the finest mesh": table.errors["T_12"][-1],
            "rate of v": table.last("v"),
            "distance to a yield stress larger by a tenth": stronger,
        },
        table.table("h, m"),
        Plot("Bingham's fluid between plates", "y, m", "v, m/s", curves),
    )


# --- between cylinders, the inner one of which turns ----------------------------------------------------

R_I, R_O, R_Y = 1.0, 2.0, 1.5
"""Radii of the walls and of where the shear stress TAU_Y R_Y^2/r^2 is at yield, m."""


def turning(r: np.ndarray, tau_Y: float = TAU_Y) -> np.ndarray:
    """The angular velocity, 1/s, of the shear stress TAU_Y R_Y^2/r^2."""
    torque = TAU_Y * R_Y**2
    edge = math.sqrt(torque / tau_Y)
    r = np.minimum(r, edge)
    return torque / (2 * ETA) * (1 / r**2 - 1 / edge**2) - tau_Y / ETA * np.log(edge / r)


def _couette(kind: str) -> Outcome:
    r = np.linspace(1.05, 1.95, 19)
    exact, exact_T = r * turning(r), TAU_Y * R_Y**2 / r**2
    Omega = float(turning(np.array(R_I)))
    rows, curves, errors = [], [], []
    for h in (0.25, 0.125):
        walls: Conditions = {"inner": nv.PrescribedTangential((-Omega * y, Omega * x)), "outer": nv.NoSlip()}
        mesh = annulus(R_I, R_O, h)
        linear = Omega / 3 * (4 / (x * x + y * y) - 1)
        initial = nv.Initial(density=0.01, velocity=(-linear * y, linear * x))
        run = nv.Simulation(mesh, bingham(kind), dt=0.1, walls=walls, initial=initial, solver="split")
        run.run(0.8)
        v, T = around(run, r)
        errors.append(float(np.abs(v - exact).max()) / Omega)
        of_T = float(np.abs(-T / exact_T - 1)[r < R_Y].max())
        rows.append([h, mesh.ne, errors[-1], of_T])
        curves.append(Curve(f"h = {h:g} m", r, v, "o"))
    curves.append(Curve("closed form", r, exact, "k-"))
    return measured(
        {
            "largest error of v on the finer mesh, of the wall's": errors[-1],
            "largest relative error of the shear stress where it flows": of_T,
            "error of v on the finer / on the coarser mesh": errors[-1] / errors[0],
            "largest |v| beyond 1.6 m, of the wall's": float(np.abs(v[r > 1.6]).max()) / Omega,
        },
        Table("at 19 radii", "h, m | cells | error of v | error of the stress", rows),
        Plot("Bingham's fluid between cylinders", "r, m", "v, m/s", curves),
        "With h = 0.5 and 0.25 m, as first run, v was 0.073 off and the stress 0.060: finer cells since.",
    )


for kind in KINDS:
    CASES(f"""bingham-channel-{kind}
        Bingham's fluid between plates in {NAMES[kind]} flows by its closed form.
        label: Bingham 1916
        setting: Elastoviscoplastic: G = {G:g} Pa, yields at {TAU_Y} Pa in shear, plastic viscosity {ETA} Pa
          s; a force of 1 N/m3 along a channel 1 m wide, 0.01 kg/m3, 20 steps of 0.1 s from rest; h = 0.25,
          0.125, 0.0625 m; v and T_12 at 81 points, in the mean square.
        - error of v on the finest mesh <= 0.01: v'' jumps: h^2 v''/8 = 0.005
        - error of T_12 on the finest mesh <= 0.02: T_12 of order one, m = 1
        - rate of v >= 1.3: two, less what the place of the kink makes
        - distance to a yield stress larger by a tenth >= 0.05: a wrong one is told from it
        - closure
        """)(partial(_channel, kind))
    CASES(f"""bingham-couette-{kind}
        Bingham's fluid around a turning cylinder in {NAMES[kind]} flows as the closed form says, and rests
          beyond the radius of yield.
        label: Bingham 1916, Reiner and Riwlin 1927
        setting: The same fluid between 1 m, turning at {float(turning(np.array(R_I))):.4f}/s, and 2 m; yield
          ends at 1.5 m; 0.01 kg/m3, 8 steps of 0.1 s from the velocity of a linear fluid without stress, by
          the split solver; h = 0.25 and 0.125 m.
        - largest error of v on the finer mesh, of the wall's <= 0.03: eight cells in the gap
        - largest relative error of the shear stress where it flows <= 0.05: P2 velocity, P1 stress
        - error of v on the finer / on the coarser mesh <= 0.6: converges
        - largest |v| beyond 1.6 m, of the wall's <= 0.01: rigid
        - closure
        """)(partial(_couette, kind))


# --- creep under constant stress -----------------------------------------------------------------------


@CASES(f"""norton-creep
    Under a constant shear stress Norton's rule creeps at the rate of its power law.
    label: Norton 1929
    setting: A = 0.3/(s Pa^n), n = 1, 3, 5, G = {G:g} Pa, tractions of 0.5, 1 and 2 Pa on the wall of a
      channel, 10 steps to a shear of 0.1, linearised and finite strain by B.
    - largest relative error of the rate <= 2e-3: elastic: (stress/G)^2 and less
    - largest error of the exponent <= 2e-3: the same
    - closure
    """)
def _creep() -> Outcome:
    """Shear by a traction on the wall: rate = 2 A (sqrt(2) tau)^(n-1) tau."""
    A, rows, of_rate, of_n = 0.3, [], 0.0, 0.0
    for kind in KINDS:
        for n in (1.0, 3.0, 5.0):
            rates = []
            for tau in (0.5, 1.0, 2.0):
                exact = 2 * A * (math.sqrt(2) * tau) ** (n - 1) * tau
                run = nv.Simulation(
                    channel(1, 1, maxh=1.0),
                    nv.Model(material=elastic(kind, 2 * G, G), creep=nv.Norton(A=A, n=n)),
                    dt=0.01 / exact,
                    walls={"top": nv.Traction(f=(tau, 0.0)), "bottom": nv.NoSlip()},
                    initial=nv.Initial(density=1e-6),
                )
                run.run(0.1 / exact)
                rates.append(float(run.fields["velocity"](run.mesh(0.4, 1.0))[0]))
                error = abs(rates[-1] / exact - 1)
                of_rate = max(of_rate, error)
                rows.append([kind, n, tau, rates[-1], exact, error])
            of_n = max(of_n, abs(math.log(rates[2] / rates[0]) / math.log(4) - n))
    return measured(
        {
            "largest relative error of the rate": of_rate,
            "largest error of the exponent": of_n,
        },
        Table("steady creep", "model | n | stress, Pa | rate, 1/s | exact, 1/s | error", rows),
    )

"""A Maxwell body: relaxation in a box and oscillatory shear."""

import math

import numpy as np
from ngsolve import CF, cos, sin, y
from ngsolve import pi as PI

import ngvisco as nv
from ngvisco.forms.context import time
from ngvisco.geometries import box, channel
from tests.verification.case import Cases, Curve, Outcome, Plot, measured
from tests.verification.cases.shear import stresses
from tests.verification.rates import RateTable

CASES = Cases("Exact solutions: shear and relaxation")

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
        creep=nv.Creep.from_reciprocal(1 / (2 * eta)),
    )
    initial = nv.Initial(density=rho, values={"E": E_0})
    run = nv.Simulation(box((size, size), 0.6 * size), model, dt=duration / steps, initial=initial)
    E, stresses = run.fields["E"], []
    for _ in range(steps):
        run.advance()
        stresses.append(2 * G * E(run.mesh(0.2 * size, 0.3 * size))[0])
    return stresses, run


@CASES("""maxwell-relaxation (reduced)
    A Maxwell body's uniform stress relaxes as tau_0 exp(−G t/eta): 20 MPa fall to 7.49 kPa in 250 kyr.
    label: Euler-small-viscoelastodyn+2; ASPECT viscoelastic_relaxation
    setting: Box of 100 km with slip, v = 0, G = 1e10 Pa, eta = 1e22 Pa s (R = 1/(2 eta)); 64, 128, 256 steps.
    - exact stress at 250 kyr, Pa <= 7.5e3: the reference's 7.49 kPa
    - deviation from the implicit Euler formula <= 1e-9: solver tolerance
    - rate in tau >= 0.9: implicit Euler
    - relative error at 250 kyr, extrapolated <= 0.01: two extrapolations
    """)
def _relaxation() -> Outcome:
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
    extrapolated = abs((4 * 2 * errors[2] - 6 * errors[1] + errors[0]) / 3)
    return measured(
        {
            "exact stress at 250 kyr, Pa": exact,
            "deviation from the implicit Euler formula": formula,
            "rate in tau": table.last("stress"),
            "relative error at 250 kyr, extrapolated": extrapolated,
        },
        table.table("tau / 250 kyr"),
        Plot("Stress relaxation of a Maxwell body", "years", "Pa", curves, log="y"),
    )


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
    rows = []
    for _ in range(steps):
        run.advance()
        rows.append((run.t, stresses(run)[0] / AMPLITUDE))
    t, found = np.array(rows).T
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
def _oscillation() -> Outcome:
    table, curves = RateTable("largest error, relative to eta gamma_0"), []
    for steps in (40, 80, 160):
        t, found, exact = oscillating(steps)
        table.add(8 / steps, tau_12=float(np.abs(found - exact).max()))
        curves.append(Curve(f"{steps} steps", t, found, "."))
    curves.append(Curve("exact", t, exact, "k-"))
    a, b, c = table.errors["tau_12"]
    return measured(
        {
            "rate in tau": table.last("tau_12"),
            "error, extrapolated": abs(8 * c - 6 * b + a) / 3,
        },
        table.table("tau, s"),
        Plot("Oscillatory shear of a Maxwell material", "t, s", "stress / (eta gamma_0)", curves),
    )

"""An elastic bar whose one end is free and whose other end stands on springs, without and with a dashpot.

Of small amplitude and length 1 it has u = cos(q x) sin(omega t), omega = q sqrt(M/rho), M q sin q = k cos q,
M the modulus of longitudinal waves; a stiff one is a block on a spring, omega^2 = k/rho.
"""

import math
from typing import Literal

import numpy as np
from ngsolve import CF, cos, x
from scipy.optimize import brentq, curve_fit

import ngvisco as nv
from ngvisco.geometries import structured_box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured

CASES = Cases("Exact solutions: waves")

BULK, SHEAR = 10.0, 5.0
MODULUS = BULK + 4 / 3 * SHEAR
AMPLITUDE, CELLS, STEPS = 1e-6, 8, 80
"""Of the velocity, m/s, cells along the bar, and steps in a period."""
STIFFNESSES = (0.05, 1.0, 20.0)
"""k over M."""
HEAVY, DAMPING = 1e-3, 0.2
"""k over M of the block, and its damping over the critical one."""


def _wave_number(k: float) -> float:
    return float(brentq(lambda q: MODULUS * q * math.sin(q) - k * math.cos(q), 1e-9, math.pi / 2))


def _bar(
    k: float, c: float, q: float, omega: float, scheme: Literal["midpoint", "backward-euler"] = "midpoint"
) -> tuple[nv.Simulation, np.ndarray, np.ndarray]:
    """A run over a period from the velocity cos(q x), times, and the share of that in v over the start's."""
    share = nv.Integrals({"share": f"velocity_1*cos({q!r}*x)"})
    run = nv.Simulation(
        structured_box((1, 1 / CELLS), (CELLS, 1)),
        nv.Model(material=nv.LinearElastic(K_e=BULK, G_e=SHEAR)),
        time=nv.TimeSteps(dt=2 * math.pi / omega / STEPS, scheme=scheme),
        initial=nv.Initial(velocity=(AMPLITUDE * cos(q * x), CF(0.0))),
        walls={
            "left": nv.Open(density=1.0),
            "right": nv.Open(density=1.0, stiffness=(k, 0.0), impedance=(c, 0.0)),
        },
        observers=[share],
    )
    run.run(STEPS * run.dt)
    values = share.column("share")
    return run, share.column("time"), values / values[0]


def _frequency(run: nv.Simulation, t: np.ndarray, v: np.ndarray, omega: float) -> float:
    """What is fitted, without the midpoint rule's share: tan(omega_tau tau/2) = omega tau/2."""
    (found,), _ = curve_fit(lambda t, w: np.cos(w * t), t, v, p0=(omega,))
    return 2 / run.dt * math.tan(found * run.dt / 2)


@CASES(f"""bar-on-springs
    A bar on a foundation that gives swings with the frequency of the closed form, from soft springs to hard
      ones; a heavy block on springs with a dashpot is a damped oscillator.
    label: benchmark: M q sin qL = k cos qL; the damped oscillator
    setting: Bar of 1 m, K_e = {BULK:g} Pa, G_e = {SHEAR:g} Pa, density 1, left end free, right end on springs
      of {", ".join(f"{k:g}" for k in STIFFNESSES)} M/L, block with {HEAVY:g} M/L and a dashpot of
      {DAMPING:g} of the critical one; {CELLS} cells, midpoint, {STEPS} steps in the period.
    - largest relative error of the frequency <= 1e-4: h^4 of 8 cells in a quarter wave
    - distance of the damped block from an oscillator <= 1e-2: k/M = 1e-3, steps of T/80
    - least bregman by backward Euler, over the energy >= 0.0: a square of w - w_old
    - closure
    """)
def _foundation() -> Outcome:
    rows, errors, curves = [], [], []
    for share in STIFFNESSES:
        k = share * MODULUS
        q = _wave_number(k)
        omega = q * MODULUS**0.5
        run, t, v = _bar(k, 0.0, q, omega)
        errors.append(abs(_frequency(run, t, v, omega) / omega - 1))
        energy = run.ledger.column("kinetic") + run.ledger.column("stored")
        springs = float(run.ledger.column("stored_springs_right").max())
        rows.append([share, omega, errors[-1], springs / float(energy[0]), float(energy[-1] / energy[0] - 1)])
        curves.append(Curve(f"k = {share:g} M", omega * t, v, "."))
    run, *_ = _bar(MODULUS, 0.0, q, omega, "backward-euler")
    least = float(run.ledger.column("bregman")[1:].min() / run.ledger.column("kinetic")[0])
    k = HEAVY * MODULUS
    omega = k**0.5
    run, t, v = _bar(k, 2 * DAMPING * omega, 0.0, omega)
    slow = omega * math.sqrt(1 - DAMPING**2)
    exact = np.exp(-DAMPING * omega * t) * (np.cos(slow * t) - DAMPING * omega / slow * np.sin(slow * t))
    curves += [Curve("block with a dashpot", omega * t, v, "."), Curve("oscillator", omega * t, exact, "k-")]
    return measured(
        {
            "largest relative error of the frequency": max(errors),
            "distance of the damped block from an oscillator": float(np.abs(v - exact).max()),
            "least bregman by backward Euler, over the energy": least,
        },
        Table(
            "bars on springs",
            "k L/M | omega, 1/s | error | springs' largest share of the energy | change of it",
            rows,
        ),
        Plot("A bar on springs", "omega t", "velocity over the start's", curves),
    )

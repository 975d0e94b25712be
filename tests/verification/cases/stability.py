"""Stability for every step length: four decades of tau, without and with a load."""

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
from ngsolve import Mesh

import ngvisco as nv
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured
from tests.verification.setups import KINDS, SETTING, block, closure, potential

CASES = Cases("Stability for every step length")

TAUS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
STEPS = 5


def measure(
    kind: str, gravity: float, mesh: Mesh | None = None, taus: Sequence[float] = TAUS, steps: int = STEPS
) -> Outcome:
    """Energy, with the weight's potential, after every step, for every tau."""
    rows: list[list[str | float]] = []
    curves, rises, closures, remainders, unsolved = [], [], [], [], 0
    for tau in taus:
        law = nv.HyperViscosity(mu=1e-5, p=4)
        run = block(kind, tau, mesh=mesh, gravity=gravity, creep=2.0, hyperviscosity=law)
        energies: list[float] = []
        failure = ""
        with_potential = potential(run, gravity)
        for _ in range(steps):
            try:
                row = run.advance()
            except nv.StepError as error:
                failure, unsolved = str(error), unsolved + 1
                break
            if not energies:
                start = run.ledger.rows[0]
                energies.append(start["kinetic"] + start["stored"] + with_potential)
            energies.append(row["kinetic"] + row["stored"] + potential(run, gravity))
            remainders.append(min(row["inertial"], row["bregman"]) / energies[0])
        scale = energies[0] if energies else 1.0
        rise = float(np.diff(energies).max() / scale) if len(energies) > 1 else np.nan
        rises.append(rise)
        closures.append(closure(run))
        curves.append(Curve(f"tau = {tau:g} s", range(len(energies)), [e / scale for e in energies]))
        defect = run.ledger.rows[-1]["J_defect"] if run.ledger.rows else np.nan
        rows.append([tau, len(energies) - 1, energies[-1] / scale, rise, closures[-1], defect, failure])
    return measured(
        {
            "largest relative rise of the energy in a step": max(rises),
            "steps without a solution": unsolved,
            "smallest numerical dissipation of a step, relative": min(remainders),
        },
        Table(
            "energy at the end, relative to the start",
            "tau, s | steps | energy | largest rise | closure | ‖J − det F‖ | failure",
            rows,
        ),
        Plot("Energy after each step", "step", "energy / initial energy", curves),
        *[
            "Stable is not accurate: in the finite-strain model J and det F part where tau is longer "
            "than the motion, and the stored energy of (F, J) then falls below that of a body at rest."
        ]
        * (kind == "finite"),
    )


BOUNDS = """- largest relative rise of the energy in a step <= 1e-12: rounding
    - steps without a solution <= 0: the paper: solutions exist for every tau
    - closure
    - smallest numerical dissipation of a step, relative >= -1e-13: convexity of kinetic and stored energy"""
BALANCES = {"linearised": "Euler-ED-basic-energy-balance-disc", "finite": "Euler-large-energy-balance-disc"}
"""Labels."""

for gravity, kind in product((0.0, 2.0), KINDS):
    what = "kinetic, stored and the weight's potential energy" if gravity else "kinetic plus stored energy"
    name = f"stability-{'loaded' if gravity else 'free'}-{kind}"
    CASES(f"""{name}{" (reduced)" * (name == "stability-free-linearised")}
        In {KINDS[kind]} {what} never rises in a step, whatever its
          length, {"under gravity" if gravity else "without load"}.
        label: {BALANCES[kind]}
        setting: {SETTING}, creep with G_m = 2 Pa s, hyperviscosity mu = 1e-5, p =
          4{", gravity 2 m/s2" * bool(gravity)}; cells of 0.5 m, {STEPS} steps each of tau = 1e-3 to 10 s (at
          first the eddy crosses a cell in 0.5 s).
        {BOUNDS}
        """)(partial(measure, kind, gravity))

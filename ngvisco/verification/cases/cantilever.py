"""A clamped bar in a soft light medium that stands for the empty space around it, released under gravity.

The mean deflection of a bar of length L and height a, clamped at one end, under a weight q per length is

    w = q L^4/(20 E' I) + q L^2/(3 kappa G a),

by Euler and Bernoulli with the shear of Timoshenko (E' = E/(1 - nu^2) in plane strain, I = a^3/12, kappa =
10 (1 + nu)/(12 + 11 nu)).  It swings about that state with omega = 3.516 sqrt(E' I/(rho a L^4)), less by the
medium that it moves.  A medium with a shear modulus carries a part of the weight: the bar is L^3/a^3 times
softer than its own modulus says, and the medium has to be softer by that, too, not to be felt.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.optimize import curve_fit

from ngvisco.geometries import structured_box
from ngvisco.physics.bodies import Body
from ngvisco.physics.materials import CustomMaterial, OldroydB
from ngvisco.physics.model import Gravity, Model
from ngvisco.physics.rheology import StokesViscosity
from ngvisco.physics.variables import Jacobian
from ngvisco.physics.walls import NoSlip
from ngvisco.run.bodies import Bodies
from ngvisco.run.simulation import Simulation
from ngvisco.shapes.solids import Block
from ngvisco.verification.case import Bound, Case, Curve, Outcome, Plot, Table
from ngvisco.verification.setups import closure

SIZE, CELLS = (1.25, 0.8), (10, 8)
LENGTH, HEIGHT = 1.0, 0.2
BULK, SHEAR = 2.0, 1.0
"""Of the bar, Pa."""
LIGHT, SOFT, VISCOSITY = 0.02, 0.2, 5e-5
"""Of the medium: density, kg/m^3 (the bar has 1), bulk modulus, Pa, and viscosity, Pa s."""
NU = (3 * BULK - 2 * SHEAR) / (2 * (3 * BULK + SHEAR))
PLANE = 2 * SHEAR * (1 + NU) / (1 - NU**2)
FLEXURE = PLANE * HEIGHT**3 / 12
KAPPA = 10 * (1 + NU) / (12 + 11 * NU)
WEIGHT = 0.02 * 8 * FLEXURE / LENGTH**4
"""Of the bar in the medium, N/m: its tip bends by 2 % of the length."""
GRAVITY = WEIGHT / (HEIGHT * (1 - LIGHT))
BEAM = WEIGHT * LENGTH**4 / (20 * FLEXURE) + WEIGHT * LENGTH**2 / (3 * KAPPA * SHEAR * HEIGHT)
"""m."""
OMEGA = 3.516 * math.sqrt(FLEXURE / (HEIGHT * LENGTH**4))
TAU = 0.25
STEPS = {0.0: 40, 1e-2: 40}
"""By the shear modulus of the medium over the bar's; 0 is a fluid."""


@cache
def _swing(modulus: float) -> tuple[Simulation, np.ndarray, np.ndarray, np.ndarray]:
    """The run, times, mean deflections in m, and static deflection, damping and frequency fitted to them."""
    fluid = CustomMaterial(transported=(Jacobian(),), stored_energy=lambda J: SOFT / 2 * (J + 1 / J - 2))
    medium = OldroydB(K_e=SOFT, G_e=modulus * SHEAR / 2) if modulus else fluid
    middle, table = SIZE[1] / 2, Bodies()
    bodies = [
        Body(
            name="bar",
            where=Block((-LENGTH, middle - HEIGHT / 2), (LENGTH, middle + HEIGHT / 2)),
            material=OldroydB(K_e=BULK, G_e=SHEAR / 2),
            density=1.0,
        ),
        Body(
            name="medium",
            material=medium,
            viscosity=StokesViscosity(K_v=VISCOSITY, G_v=VISCOSITY),
            density=LIGHT,
        ),
    ]
    run = Simulation(
        structured_box(SIZE, CELLS),
        Model(bodies=tuple(bodies), loads=(Gravity((0.0, -GRAVITY)),)),
        dt=TAU,
        scheme="midpoint",
        walls={"left": NoSlip()},
        velocity_scale=1.0,
        observers=[table],
    )
    run.run(TAU * STEPS[modulus])
    times, deflection = table.column("time"), table.column("bar_y")[0] - table.column("bar_y")
    fit, _ = curve_fit(_released, times, deflection, p0=(BEAM, 0.05, OMEGA))
    return run, times, deflection, fit


def _released(t: np.ndarray, static: float, damping: float, omega: float) -> np.ndarray:
    """An oscillator under a weight that acts from t = 0."""
    swing = np.cos(omega * t) + damping / omega * np.sin(omega * t)
    return np.asarray(static * (1 - np.exp(-damping * t) * swing))


def _cantilever() -> Outcome:
    found = {modulus: _swing(modulus) for modulus in STEPS}
    static = {modulus: float(fit[0]) for modulus, (*_, fit) in found.items()}
    runs = [run for run, *_ in found.values()]
    _, times, deflection, fit = found[0.0]
    fitted = float(np.abs(_released(times, *fit) - deflection).max()) / static[0.0]
    drift = max(float(np.abs(run.ledger.column("mass_drift")).max()) for run in runs)
    return Outcome(
        values={
            "static deflection over the beam's, less one": abs(static[0.0] / BEAM - 1),
            "frequency over the beam's": float(fit[2]) / OMEGA,
            "distance of the swing from an oscillator's": fitted,
            "stiffness that a medium of 1e-2 G adds": static[0.0] / static[1e-2] - 1,
            "drift of the mass": drift,
            "largest |closure|": closure(*runs),
        },
        tables=[
            Table(
                "the medium's stiffness",
                ["G of the medium over the bar's", "mean deflection, m", "over the beam's", "omega over it"],
                [
                    [modulus, static[modulus], static[modulus] / BEAM, float(found[modulus][3][2]) / OMEGA]
                    for modulus in STEPS
                ],
            )
        ],
        plots=[
            Plot(
                "A bar released under its weight",
                "t, s",
                "mean deflection over the beam's at rest",
                [
                    Curve(
                        f"medium of {m:g} G" if m else "fluid",
                        [float(v) for v in t],
                        [float(v) / BEAM for v in w],
                        "o-",
                    )
                    for m, (_, t, w, _) in found.items()
                ],
            )
        ],
    )


CASES = (
    Case(
        name="cantilever-in-soft-medium",
        theme="Bodies and their interfaces",
        statement="In a light fluid a clamped bar bends under its weight as beam theory says of empty space; "
        "an elastic medium that is 1e-2 times as stiff carries a part of the weight.",
        label="benchmark: beams after Euler and Bernoulli, and Timoshenko",
        setting=f"Bar {LENGTH:g} m x {HEIGHT:g} m, G = {SHEAR:g} Pa, nu = {NU:.3f}, clamped at the left wall "
        f"of a box of {SIZE[0]:g} m x {SIZE[1]:g} m; medium of {LIGHT:g} times its density, K_e = {SOFT:g} "
        f"Pa, {VISCOSITY:g} Pa s; tip bent by 2 % of the length; {2 * CELLS[0] * CELLS[1]} triangles, two "
        f"rows through the bar, midpoint, tau = {TAU:g} s, {STEPS[0.0]} steps.",
        bounds=(
            Bound(
                "static deflection over the beam's, less one",
                "<=",
                0.15,
                "two rows of cells, an interface of a cell's width, beam theory at L/a = 5",
            ),
            Bound("frequency over the beam's", "<=", 1.05, "the medium adds mass"),
            Bound("distance of the swing from an oscillator's", "<=", 0.1, "one mode carries 99 %"),
            Bound("stiffness that a medium of 1e-2 G adds", ">=", 0.3, "of the order (L/a)^3 1e-2"),
            Bound("drift of the mass", "<=", 1e-10, "conserved"),
            Bound("largest |closure|", "<=", 1e-10, "the tolerance of Newton's iteration"),
        ),
        explanation="The static deflection does not hold: with two rows of cells the bar is a fifth softer "
        "than the beam (1.21 measured).  The interface takes up to a cell on either side, and is a mixture.",
        run=_cantilever,
    ),
)

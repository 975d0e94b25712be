"""A shear band of frictional matter in plane strain compression, from a weak seed: its angle against theory.

``DruckerPrager`` does not dilate, and beside its friction that makes the material unstable: it flows in a
band, from the seed to the free surface.  Its angle to the direction of the largest compression lies between
45 - phi/2 (Coulomb) and 45 (Roscoe 1970, no dilatancy).  Where the band begins, Rudnicki and Rice (1975) have

    45 - arcsin(a)/2,   a = ((2/3)(1 + nu)(beta + mu) - N (1 - 2 nu))/sqrt(4 - 3 N^2),

mu = sin phi of the friction, beta = 0 of the dilatancy, nu Poisson's number, N = 0 the intermediate
principal part of the deviator over sqrt(J_2), which vanishes with plastic flow in plane strain.
"""

import math

import numpy as np
from ngsolve import exp, x, y

import ngvisco as nv
from ngvisco.geometries import box
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured

CASES = Cases("Exact solutions: flow rules")

LENGTH, HEIGHT, SEED = 2.0, 1.0, 0.1
"""Of the block and the seed's radius, m."""
BULK, SHEAR, FRICTION, G_M = 1000.0, 500.0, 30.0, 10.0
"""Moduli, Pa, angle of friction, degrees, viscosity of what exceeds the strength, Pa s; cohesion 1 Pa."""
RATE, DT, END = 1e-3, 0.1, 7.5
"""Of the shortening, 1/s; steps, s, and when no band has come, s."""
STIFF = 1e4
"""Pa s/m, of the dashpot by which the wall pushes: its velocity is that times the stress off."""
DENSITY = 0.01
ROSCOE, COULOMB = 45.0, 45.0 - FRICTION / 2
AT = np.linspace(0.25, 0.85, 25)
"""Heights at which the band is looked for, m, away from the seed and the surface."""


def rudnicki_rice(friction: float) -> float:
    """The angle of the module's docstring, degrees."""
    nu = (3 * BULK - 2 * SHEAR) / (2 * (3 * BULK + SHEAR))
    return 45 - math.degrees(math.asin((1 + nu) * math.sin(math.radians(friction)) / 3)) / 2


def compressed(maxh: float) -> nv.Simulation:
    """The upper right quarter of a block that two walls press together; its upper side is free."""
    cohesion = 1 - 0.5 * exp(-(x * x + y * y) / SEED**2)
    rule = nv.DruckerPrager(cohesion=cohesion, friction_angle=FRICTION, G_m=G_M)
    pushed = nv.Open(density=DENSITY, traction=(-STIFF * RATE * LENGTH, 0.0), impedance=(STIFF, 0.0))
    return nv.Simulation(
        box((LENGTH, HEIGHT), maxh=maxh),
        nv.Model(material=nv.LinearElastic(K_e=BULK, G_e=SHEAR), creep=rule),
        dt=DT,
        initial=nv.Initial(density=DENSITY, velocity=(-RATE * x, 0.5 * RATE * y)),
        walls={"right": pushed, "top": nv.Open(density=DENSITY)},
        solver="split",
    )


def load(run: nv.Simulation) -> float:
    """Mean compression behind the wall that pushes, Pa."""
    heights = np.linspace(0.01, 0.99, 50) * HEIGHT
    stress = run.fields["cauchy_stress"](run.mesh(0 * heights + 0.95 * LENGTH, heights))
    return -float(np.mean(stress[:, 0]))


def rates(run: nv.Simulation, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places along the block, m, and |Pi| there at heights ``at``, 1/s, (heights, places)."""
    along = np.linspace(0, LENGTH, 801)[1:-1]
    X, Y = np.meshgrid(along, at)
    Pi = run.fields["creep_rate"](run.mesh(X.ravel(), Y.ravel()))
    return along, np.linalg.norm(Pi, axis=1).reshape(X.shape)


def band(run: nv.Simulation) -> tuple[float, np.ndarray, float]:
    """Angle of the band, degrees, its place at the heights ``AT``, m, and its rate over the median there."""
    along, size = rates(run, AT)
    weight = size**4
    place = (weight * along).sum(axis=1) / weight.sum(axis=1)
    slope = np.polyfit(AT, place, 1)[0]
    contrast = float((size.max(axis=1) / np.median(size, axis=1)).min())
    return math.degrees(math.atan2(1.0, slope)), place, contrast


@CASES(f"""drucker-prager-band
    Frictional matter that does not dilate shears in a band, whose angle at the largest load is that at which
      theory has it begin.
    label: Rudnicki and Rice 1975, Roscoe 1970, Vermeer 1990
    setting: Plane strain: a quarter of a block, 2 m x 1 m, E, K = {BULK:g}, G = {SHEAR:g} Pa, cohesion 1 Pa
      but half of it at the seed of {SEED} m in the corner, phi = {FRICTION:g} degrees, G_m = {G_M:g} Pa s,
      {DENSITY} kg/m3, pressed at {RATE}/s by a wall through a stiff dashpot, planes of symmetry, a free upper
      side; steps of {DT} s until the load falls; h = 0.1, 0.07, 0.05 m; a line through the places of |Pi|^4
      at 25 heights.
    - how far it is beyond Coulomb's and Roscoe's angles, degrees <= 3.0: theory
    - distance to Rudnicki and Rice's angle, degrees <= 3.0: without friction: 6.2
    - change of the angle on the finest mesh, degrees <= 3.0: converges
    - rate in the band over the median >= 4.0: it is a band
    - least power of creep, W/m3 >= 0.0: M : Pi
    - closure
    """)
def _band() -> Outcome:
    rows, runs, across, angles = [], [], [], []
    for h in (0.1, 0.07, 0.05):
        run = compressed(h)
        runs.append(run)
        largest = 0.0
        while run.t < END and (now := (run.advance(), load(run))[1]) >= largest:
            largest = now
        angle, place, contrast = band(run)
        angles.append(angle)
        rows.append([h, run.mesh.ne, run.t, largest, angle, contrast])
        along, size = rates(run, np.array([0.5]))
        across.append(Curve(f"h = {h:g} m", along[::4], size[0, ::4] / RATE, "-"))
    start = float(np.mean(place) - np.mean(AT) / math.tan(math.radians(angle)))
    theory = {"Roscoe": ROSCOE, "Rudnicki and Rice": rudnicki_rice(FRICTION), "Coulomb": COULOMB}
    lines = [Curve("largest |Pi|", place, AT, "o")]
    for name, value in theory.items():
        lines.append(Curve(f"{name}, {value:.1f}", start + AT / math.tan(math.radians(value)), AT, "-"))
    return measured(
        {
            "how far it is beyond Coulomb's and Roscoe's angles, degrees": max(
                COULOMB - angle, angle - ROSCOE, 0.0
            ),
            "distance to Rudnicki and Rice's angle, degrees": abs(angle - theory["Rudnicki and Rice"]),
            "change of the angle on the finest mesh, degrees": abs(angle - angles[-2]),
            "rate in the band over the median": contrast,
            "least power of creep, W/m3": min(
                float(run.ledger.column("creep_power_min").min()) for run in runs
            ),
        },
        Table(
            "at the largest load",
            "h, m | cells | t, s | load, Pa | angle, degrees | rate over the median",
            rows,
        ),
        Plot("the band on the finest mesh", "x, m", "y, m", lines),
        Plot("across it at y = 0.5 m", "x, m", "|Pi| over the rate of shortening", across),
        "The bound between Coulomb and Roscoe was stated before any run, that of Rudnicki and Rice "
        "after one with h = 0.07 m had shown that the band turns as it ages: on that mesh from 40.3 "
        "degrees at the largest load to 46 degrees at a shortening of 0.01, where further bands appear.",
    )

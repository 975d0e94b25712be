"""Riemann problems of an elastic solid: star states of impact and expansion against exact ones."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, Integrate, x
from scipy.integrate import quad
from scipy.optimize import brentq

import ngvisco as nv
from ngvisco.geometries import structured_box
from ngvisco.physics.tensors import log, square
from ngvisco.physics.variables import Cofactor, Distortion, Jacobian
from tests.verification.case import Cases, Curve, Outcome, Plot, Table, measured

CASES = Cases("Exact solutions: waves")

A, B, C = 1.0, 0.5, 4.0
D = A + 2 * B
"""Pa: W = A/2 (|F|^2 - 3) + B/2 (|Cof F|^2 - 3) + C/2 (J - 1)^2 - D ln J, without stress at F = I."""

SOUND = math.sqrt(A + 2 * B + C + D)
"""Speed of longitudinal waves at rest for a density of 1 kg/m3, m/s."""

CELLS, END = 200, 0.15
"""Cells of the strip, and the end in passages of a wave through it."""

VISCOSITY, COURANT = {"backward-euler": 1.0, "midpoint": 2.0}, 0.5
"""K_v + 4/3 G_v in units of rho U h, and c dt/h: what ngvisco/timestepping/NOTES.md advises.  The midpoint
rule damps nothing: in the body at rest between two waves v . n turns round on facets by what rounding leaves,
with jumps of F across them: such steps take up to 44 iterations, by upwinding that is made wide and narrowed
again."""

HALF_WIDTH = 0.03
"""Of the piece of a star region over which is averaged, m: at the end it is 0.25 m wide at least."""


def energy(F: CoefficientFunction, H: CoefficientFunction, J: CoefficientFunction) -> CoefficientFunction:
    """W/J, Pa: jointly convex."""
    W = A / 2 * (square(F) - 3) + B / 2 * (square(H) - 3) + C / 2 * (J - 1) * (J - 1) - D * log(J)
    return W / J


def stress(stretch: float) -> float:
    """dW/d(stretch) of F = diag(stretch, 1, 1), Pa: the Piola stress, and in uniaxial strain Cauchy's."""
    return A * stretch + 2 * B * stretch + C * (stretch - 1) - D / stretch


def _slope(stretch: float) -> float:
    return A + 2 * B + C + D / stretch**2


def star_of_impact(U: float) -> float:
    """The stretch between two bodies that meet with U each, rho = 1: one shock into each of them.

    [P] = -S [v] and [v] = -S [stretch] give U^2 = [P] [stretch]; as P'' < 0 for stretches below 1 too, shocks
    compress and expansions are fans.
    """
    return float(brentq(lambda s: U * U - (stress(s) - stress(1.0)) * (s - 1), 0.1, 1 - 1e-9))


def star_of_expansion(U: float) -> float:
    """The stretch between two pieces that part with U each: a fan into each, U = int c dstretch."""
    return float(brentq(lambda s: quad(lambda t: math.sqrt(_slope(t)), 1, s)[0] - U, 1 + 1e-9, 3.0))


@dataclass(frozen=True)
class Star:
    """A star region: its middle, m, its exact stretch, and relative errors of what is there."""

    middle: float
    stretch: float
    errors: dict[str, float]
    drift: float
    """rho J/rho_0 - 1."""


def strip(
    mach: float, cells: int, scheme: str = "backward-euler", courant: float = COURANT, **options: Any
) -> nv.Simulation:
    """A periodic strip of two rows whose left half runs into its right half, which parts from it behind.

    ``courant`` is c dt/h, ``options`` are the simulation's.
    """
    h, U = 1 / cells, mach * SOUND
    nu = VISCOSITY[scheme] * U * h
    material = nv.CustomMaterial(transported=(Distortion(), Cofactor(), Jacobian()), stored_energy=energy)
    model = nv.Model(material=material, viscosity=nv.StokesViscosity(K_v=nu / 3, G_v=nu / 2))
    mesh = structured_box((1, 2 * h), (cells, 2), periodic="xy")
    velocity = CF((IfPos(x - 0.5, -U, U), 0.0))
    initial = nv.Initial(density=1.0, velocity=velocity)
    return nv.Simulation(mesh, model, dt=courant * h / SOUND, scheme=scheme, initial=initial, **options)


def stars(run: nv.Simulation, mach: float) -> list[Star]:
    """The star regions of impact, in the middle, and of expansion, at the ends."""
    U, fields, found = mach * SOUND, run.fields, []
    for middle, stretch in ((0.5, star_of_impact(U)), (0.0, star_of_expansion(U))):
        near = IfPos(HALF_WIDTH - x, 1.0, IfPos(x - 1 + HALF_WIDTH, 1.0, 0.0))
        if middle:
            near = IfPos(HALF_WIDTH * HALF_WIDTH - (x - middle) * (x - middle), 1.0, 0.0)
        size = Integrate(near, run.mesh, order=8)

        def mean(value: CoefficientFunction, near: CoefficientFunction = near, size: float = size) -> float:
            return float(Integrate(value * near, run.mesh, order=8)) / size

        errors = {
            "density": abs(mean(fields["density"]) * stretch - 1),
            "J": abs(mean(fields["J"]) / stretch - 1),
            "F_11": abs(mean(fields["F"][0, 0]) / stretch - 1),
            "stress": abs(mean(fields["cauchy_stress"][0, 0]) / stress(stretch) - 1),
            "v/U": abs(mean(fields["velocity"][0])) / U,
        }
        drift = mean(fields["density"] * fields["J"]) - 1
        found.append(Star(middle, stretch, errors, drift))
    return found


def solved(mach: float, cells: int, scheme: str = "backward-euler") -> nv.Simulation:
    """The strip at its end."""
    run = strip(mach, cells, scheme)
    steps = round(END * cells / COURANT)
    run.run(steps * run.dt)
    return run


@CASES("""riemann-elastic
    Star states of an impact and of an expansion at 10 and 20 % of the sound speed agree with the shock
      relations and with the integral over the fan, with default options.
    label: ED-Euler-large2
    setting: A periodic strip of 1 m, 200 x 2 rows of triangles; W =
      A/2 |F|^2 + B/2 |Cof F|^2 + C/2 (J - 1)^2 -
      D ln J by F, Cof F and J, a user's energy; K_v + 4/3 G_v = rho U h, of midpoint twice that; c dt/h =
      0.5.
    - largest error of a star state <= 0.01: asked for
    - |rho J/rho_0 - 1| by backward Euler <= 0.01: of order dt
    - |rho J/rho_0 - 1| by midpoint <= 5e-4: of order dt^2
    - most iterations <= 60.0: one attempt for each step
    - rejected steps of backward Euler <= 0.0: nor halved
    - rejected steps of the midpoint rule <= 0.0: nor where the flow turns round at rest
    - closure
    """)
def _measure() -> Outcome:
    rows: list[list[str | float]] = []
    curves, worst, drifts = [], 0.0, {"backward-euler": 0.0, "midpoint": 0.0}
    rejections = {"backward-euler": 0.0, "midpoint": 0.0}
    iterations = 0.0
    for mach, scheme in ((0.1, "backward-euler"), (0.2, "backward-euler"), (0.2, "midpoint")):
        run = solved(mach, CELLS, scheme)
        column = run.ledger.column
        iterations = max(iterations, float(column("newton_iterations").max()))
        rejections[scheme] += float(column("rejections").sum())
        for star in stars(run, mach):
            name = "impact" if star.middle else "expansion"
            rows.append([name, mach, scheme, star.stretch, *star.errors.values(), star.drift])
            worst = max(worst, *star.errors.values())
            drifts[scheme] = max(drifts[scheme], abs(star.drift))
        places = np.linspace(0.0025, 0.9975, 200)
        density = run.fields["density"]
        values = [density(run.mesh(p, 0.3 / CELLS)) for p in places]
        curves.append(Curve(f"{mach:g} c, {scheme}", places, values, "-"))
    columns = ["", "U/c", "scheme", "exact stretch", *star.errors, "rho J/rho_0 - 1"]
    return measured(
        {
            "largest error of a star state": worst,
            "|rho J/rho_0 - 1| by backward Euler": drifts["backward-euler"],
            "|rho J/rho_0 - 1| by midpoint": drifts["midpoint"],
            "most iterations": iterations,
            "rejected steps of backward Euler": rejections["backward-euler"],
            "rejected steps of the midpoint rule": rejections["midpoint"],
        },
        Table("star states: relative errors", columns, rows),
        Plot("Density at the end", "x, m", "kg/m3", curves),
        "The drift of rho J is an error of time: both are carried by one velocity, by other rates.",
    )
